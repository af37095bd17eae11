"""The two-Riccati solution of the H2 problem, continuous or discrete: arrays in, arrays out."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.equations import Riccati, continuous_riccati, discrete_least_squares
from ultraquiet.linalg.even import to_unit_size
from ultraquiet.linalg.ordered import Array, Matrices
from ultraquiet.values.state_space import StateSpace

ROUND_OFF = 1e-14  # singular values of D12 and D21 below this share of the largest are none
CANCELLED = 1e-12  # of the terms of a squared cost: what is left below it is their round-off
RANK = 1e-12  # of D12'D12 and D21 D21' (continuous), relative


class H2Problem(NamedTuple):
    """x' = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u, y = C2 x + D21 w + D22 u."""

    A: Array
    B1: Array
    B2: Array
    C1: Array
    C2: Array
    D11: Array
    D12: Array
    D21: Array
    D22: Array

    @classmethod
    def of(cls, P: StateSpace, ny: int, nu: int) -> "H2Problem":
        """Take a generalised plant apart."""
        p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
        D = P.D
        return cls(P.A, P.B[:, :m], P.B[:, m:], P.C[:p], P.C[p:], D[:p, :m], D[:p, m:], D[p:, :m], D[p:, m:])


class Units(NamedTuple):
    """Controls and measurements in which D12 and D21 have orthonormal columns and rows: u = into ~u, ~y = out y."""

    into: Array
    out: Array


class Solution(NamedTuple):
    """Gains of the optimal law u = -F x - N e, x' = A x + B2 u + L e, e = y - C2 x - D22 u, in units of their own."""

    problem: H2Problem
    regulator: Riccati
    observer: Riccati
    F: Array
    L: Array
    N: Array
    discrete: bool
    units: Units

    @property
    def feedback(self) -> Array:
        """F in the units of the plant's controls."""
        return self.units.into @ self.F

    @property
    def injection(self) -> Array:
        """L in the units of the plant's measurements."""
        return self.L @ self.units.out

    @property
    def residuals(self) -> dict[str, float]:
        """Relative residuals of the two equations."""
        return {"regulator": self.regulator.residual, "observer": self.observer.residual}

    def controller(self, current: bool = True) -> Matrices:
        """Return the controller u = K y; without the current innovation (N = 0) it answers one sample later."""
        p = self.problem
        N = self.N if current else np.zeros_like(self.N)
        n = p.A.shape[0]
        # u (I - N D22) = -(F - N C2) x - N y
        u = np.linalg.solve(np.eye(N.shape[0]) - N @ p.D22, np.hstack([-(self.F - N @ p.C2), -N]))
        drive = p.B2 - self.L @ p.D22
        into, out = self.units
        B, C, D = (self.L + drive @ u[:, n:]) @ out, into @ u[:, :n], into @ u[:, n:] @ out
        return p.A - self.L @ p.C2 + drive @ u[:, :n], B, C, D

    def cost(self) -> float:
        """Return the H2 norm that the equations promise, by the optimal cost and the price of not knowing the state."""
        return float(np.sqrt(max(sum(self._terms()), 0.0)))

    def agrees(self, achieved: float, share: float) -> bool:
        """Return whether an achieved norm is the promised one, to a share of it and to the round-off of its terms."""
        terms = self._terms()
        off = abs(sum(terms) - achieved**2)
        return bool(off <= 2 * share * achieved**2 + CANCELLED * sum(abs(term) for term in terms))

    def _terms(self) -> tuple[float, ...]:
        """Return the terms of the squared cost, which cancel where the optimum is zero."""
        p, X, Y = self.problem, self.regulator.X, self.observer.X
        full = float(np.trace(p.B1.T @ X @ p.B1))
        if not self.discrete:
            return full, float(np.trace(self.F @ Y @ self.F.T @ (p.D12.T @ p.D12)))
        R, S = _weights(self)
        full += float(np.sum(p.D11**2))
        # what the best u would be, were x and w known, minus what the innovations tell of it
        wish = np.hstack([self.F, np.linalg.solve(R, p.B2.T @ X @ p.B1 + p.D12.T @ p.D11)])
        m = p.B1.shape[1]
        known = np.block([[Y, np.zeros((Y.shape[0], m))], [np.zeros((m, Y.shape[0])), np.eye(m)]])
        seen = np.vstack([Y @ p.C2.T, p.D21.T])
        left = known - seen @ np.linalg.solve(S, seen.T)
        gain = wish[:, Y.shape[0] :]
        return full, -float(np.trace(gain.T @ R @ gain)), float(np.trace(R @ wish @ left @ wish.T))


def solve(p: H2Problem, discrete: bool) -> Solution:
    """Solve both equations.

    Raises:
        NumericalError: an equation has no stabilising solution, or no single gain; in continuous time also when D12 or
            D21 lacks rank or D11 is not zero.
    """
    try:
        return _solved(p, discrete)
    except np.linalg.LinAlgError:
        raise NumericalError(
            "H2 synthesis: no single gain is the best: a control costs nothing and moves nothing, or a measurement "
            "tells nothing; give each a weight of its own."
        ) from None


def _solved(p: H2Problem, discrete: bool) -> Solution:
    p, units = _alike(p, discrete)
    if not discrete:
        _ranks(p, p.D12.T @ p.D12, p.D21 @ p.D21.T)
    p, units = _normalised(p, units)
    Rx, Ry = p.D12.T @ p.D12, p.D21 @ p.D21.T
    Sx, Sy = p.C1.T @ p.D12, p.B1 @ p.D21.T
    if discrete:
        X = discrete_least_squares(p.A, p.B2, p.C1, p.D12)
        Y = discrete_least_squares(p.A.T, p.C2.T, p.B1.T, p.D21.T)
        R, S = Rx + p.B2.T @ X.X @ p.B2, Ry + p.C2 @ Y.X @ p.C2.T
        F = np.linalg.solve(R, p.B2.T @ X.X @ p.A + Sx.T)
        L = np.linalg.solve(S, p.C2 @ Y.X @ p.A.T + Sy.T).T
        # of x and of w, the part that this sample's innovation tells
        feedthrough = np.linalg.solve(R, p.B2.T @ X.X @ p.B1 + p.D12.T @ p.D11) @ p.D21.T
        N = np.linalg.solve(S, (F @ Y.X @ p.C2.T + feedthrough).T).T
        return Solution(p, X, Y, F, L, N, True, units)
    X = _continuous(p.A, p.B2, p.C1.T @ p.C1, Rx, Sx)
    Y = _continuous(p.A.T, p.C2.T, p.B1 @ p.B1.T, Ry, Sy)
    F = np.linalg.solve(Rx, p.B2.T @ X.X + Sx.T)
    L = np.linalg.solve(Ry, p.C2 @ Y.X + Sy.T).T
    return Solution(p, X, Y, F, L, np.zeros((F.shape[0], p.C2.shape[0])), False, units)


def _alike(p: H2Problem, discrete: bool) -> tuple[H2Problem, Units]:
    """Choose units of controls and measurements, powers of two, in which all are about as large.

    In continuous time by their weights in D12 and D21; in discrete time, where those may be zero, by what the controls
    do to the state and the state to the measurements as well. What has no size keeps its unit.
    """
    sizes = (np.linalg.norm(p.D12, axis=0), np.linalg.norm(p.D21, axis=1))
    if discrete:
        sizes = np.hypot(sizes[0], np.linalg.norm(p.B2, axis=0)), np.hypot(sizes[1], np.linalg.norm(p.C2, axis=1))
    u, y = map(to_unit_size, sizes)
    p = p._replace(B2=p.B2 * u, D12=p.D12 * u, C2=p.C2 * y[:, None], D21=p.D21 * y[:, None])
    return p._replace(D22=p.D22 * u * y[:, None]), Units(np.diag(u), np.diag(y))


def _normalised(p: H2Problem, units: Units) -> tuple[H2Problem, Units]:
    """Choose units of controls and measurements such that D12'D12 and D21 D21' are unit matrices.

    Squaring D12 first would lose what is small in it. A D12 or D21 without full rank is left as it is.
    """
    into, D12 = _unit(p.D12)
    out, D21 = _unit(p.D21.T)
    out = out.T
    p = p._replace(B2=p.B2 @ into, D12=D12, C2=out @ p.C2, D21=D21.T, D22=out @ p.D22 @ into)
    return p, Units(units.into @ into, out @ units.out)


def _unit(D: Array) -> tuple[Array, Array]:
    """Return T and D T with orthonormal columns; the unit matrix and D itself when D lacks rank."""
    U, s, Vt = np.linalg.svd(D, full_matrices=False)
    if D.shape[0] < D.shape[1] or not s[-1] > ROUND_OFF * s[0]:
        return np.eye(D.shape[1]), D
    return Vt.T / s, U


def _continuous(A: Array, B: Array, Q: Array, R: Array, S: Array) -> Riccati:
    RS, RB = np.linalg.solve(R, S.T), np.linalg.solve(R, B.T)
    G, cost = B @ RB, Q - S @ RS
    return continuous_riccati(A - B @ RS, (G + G.T) / 2, (cost + cost.T) / 2)


def _ranks(p: H2Problem, Rx: Array, Ry: Array) -> None:
    if np.any(p.D11):
        raise NumericalError("H2 synthesis: D11 is not zero, so the norm of a continuous loop is infinite; filter w.")
    for name, R, what in (("D12", Rx, "control"), ("D21", Ry, "measurement")):
        if np.linalg.cond(R) > 1 / RANK:
            raise NumericalError(f"H2 synthesis: {name} lacks rank; every {what} needs a weight of its own.")


def _weights(s: Solution) -> tuple[Array, Array]:
    p = s.problem
    R = p.D12.T @ p.D12 + p.B2.T @ s.regulator.X @ p.B2
    return R, p.D21 @ p.D21.T + p.C2 @ s.observer.X @ p.C2.T
