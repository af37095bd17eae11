"""A loop seen on a grid of frequencies: what a small controller costs, in milliseconds, and how that cost changes."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg import response
from ultraquiet.linalg.ordered import Array
from ultraquiet.values.state_space import StateSpace

POINTS_LOG, POINTS_EVEN = 250, 200
LOWEST = 1e-4  # radians per sample, or this share of the slowest pole in continuous time
HIGHEST = 1e2  # times the fastest pole, continuous time
ON = 1e-8  # radians per sample, or this share of the slowest pole: nearer to a pole of plant or law nothing is seen
SHARP, RESONANCES = 0.02, 150  # loop poles nearer the border of stability than this, relatively, get a point each


class Grid(NamedTuple):
    """Responses of a generalised plant and its controller, frequency first, and the shares of an integral."""

    points: Array
    share: FloatArray
    P11: Array
    P12: Array
    P21: Array
    P22: Array
    K: Array

    def sensitivity(self, K: Array) -> Array:
        """Return (I - P22 K)^-1 P21."""
        return np.linalg.solve(np.eye(K.shape[2]) - self.P22 @ K, self.P21)

    def influence(self, K: Array) -> Array:
        """Return P12 (I - K P22)^-1, the way from a change of K to the loop."""
        back = np.eye(K.shape[1]) - K @ self.P22
        return np.swapaxes(np.linalg.solve(np.swapaxes(back, 1, 2), np.swapaxes(self.P12, 1, 2)), 1, 2)

    def loop(self, K: Array) -> Array:
        """Return F(P, K)."""
        return self.P11 + self.P12 @ K @ self.sensitivity(K)

    def turns(self, K: Array) -> float:
        """Return how often det(I - P22 K) turns round zero: it changes when a pole of the loop becomes unstable."""
        d = np.linalg.det(np.eye(K.shape[2]) - self.P22 @ K)
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(np.sum(np.angle(d[1:] / d[:-1])) / np.pi)

    def norm(self, K: Array, kind: str) -> float:
        """Return the norm of the loop as far as the grid shows it."""
        F = self.loop(K)
        if kind == "mean-square":
            return float(np.sqrt(np.sum(self.share * np.sum(np.abs(F) ** 2, axis=(1, 2)))))
        return float(np.linalg.norm(F, 2, axis=(1, 2)).max())


def grid_of(P: StateSpace, K: StateSpace, poles: Array) -> Grid:
    """Return the responses on a grid that knows the loop's resonances, its poles, and leaves out those of P and K."""
    discrete = P.rate_hz is not None
    if discrete:
        moduli = np.abs(poles)
        size, angle = np.abs(moduli - 1), np.abs(np.angle(poles))
        w = np.concatenate([np.geomspace(LOWEST, np.pi, POINTS_LOG), np.linspace(0, np.pi, POINTS_EVEN)])
    else:
        moduli = np.abs(poles)[np.abs(poles) > 0] if np.any(poles) else np.ones(1)
        size, angle = np.abs(poles.real) / np.maximum(np.abs(poles), 1e-300), np.abs(poles.imag)
        w = np.append(np.geomspace(LOWEST * moduli.min(), HIGHEST * moduli.max(), POINTS_LOG + POINTS_EVEN), 0.0)
    sharp = angle[size < SHARP]
    w = np.unique(np.concatenate([w, sharp[:: 1 + sharp.size // RESONANCES]]))
    points = np.exp(1j * w) if discrete else 1j * w
    # an integrator has no response at rest
    away = ON if discrete else ON * float(moduli.min())
    alone = np.concatenate([P.poles(), K.poles()])
    seen_at = np.abs(points[:, None] - alone).min(axis=1, initial=np.inf) > away
    w, points = w[seen_at], points[seen_at]
    R, seen = (np.moveaxis(response.frequency_response(s.A, s.B, s.C, s.D, points), 2, 0) for s in (P, K))
    nu, ny = K.D.shape
    p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
    return Grid(points, np.gradient(w) / np.pi, R[:, :p, :m], R[:, :p, m:], R[:, p:, :m], R[:, p:, m:], seen)
