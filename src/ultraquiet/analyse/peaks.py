"""Peaks over frequency, refined between the points of a grid."""

from collections.abc import Callable

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.modal_response import residues
from ultraquiet.linalg.response import points
from ultraquiet.values.state_space import StateSpace

NEAR = 0.9  # share of the highest point that a neighbour needs to be looked at more closely
MOST = 8  # peaks looked at
INNER = 3  # points between a peak and each neighbour: a round narrows it to a quarter
ROUNDS = 9  # 4^-9 of the grid's step: a kink's place to 4e-6 of it


def response_at(system: StateSpace) -> Callable[[FloatArray], ComplexArray]:
    """Return what gives the response `(ny, nu, nf)` at frequencies in Hz, quickly and as often as wanted.

    A continuous system may be asked at infinity.
    """
    split = residues(system.A, system.B, system.C, system.D)

    def at(f: FloatArray) -> ComplexArray:
        finite = np.isfinite(f)
        values = split.at(points(np.where(finite, f, 0.0), system.rate_hz))
        values[:, :, ~finite] = system.D[:, :, None]
        return values

    return at


def ends(rate_hz: float | None) -> FloatArray:
    """Return the ends of the axis in Hz, which a logarithmic grid never reaches: zero, and infinity or Nyquist."""
    return np.array([0.0, np.inf if rate_hz is None else rate_hz / 2])


def refined(
    values_at: Callable[[FloatArray], FloatArray], f: FloatArray, values: FloatArray, beside: FloatArray | None = None
) -> tuple[float, float]:
    """Return the largest value and its frequency, with the grid narrowed around every peak that may be the largest.

    Args:
        values_at: gives values `(n,)` at frequencies `(n,)`.
        f: grid, Hz, ascending.
        values: on the grid.
        beside: single frequencies that count too, the ends of the axis for instance.
    """
    k = int(np.argmax(values))
    best, at = float(values[k]), float(f[k])
    if beside is not None:
        alone = values_at(beside)
        if alone.max() > best:
            best, at = float(alone.max()), float(beside[np.argmax(alone)])
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (values >= NEAR * best))
    if not tops.size:
        return best, at  # an end of the axis stands above every line of the grid
    tops = tops[np.argsort(-values[tops])][:MOST]
    middle, low, high = f[tops], f[np.maximum(tops - 1, 0)], f[np.minimum(tops + 1, f.size - 1)]
    share = np.linspace(0, 1, INNER + 1, endpoint=False)
    for _ in range(ROUNDS):
        below = low[:, None] + share * (middle - low)[:, None]
        above = high[:, None] + share * (middle - high)[:, None]
        points = np.concatenate([below, middle[:, None], above[:, ::-1]], axis=1)
        levels = values_at(points.reshape(-1)).reshape(points.shape)
        k = np.argmax(levels, axis=1)
        rows = np.arange(k.size)
        middle, low = points[rows, k], points[rows, np.maximum(k - 1, 0)]
        high = points[rows, np.minimum(k + 1, points.shape[1] - 1)]
        if levels.max() > best:
            best, at = float(levels.max()), float(points.reshape(-1)[np.argmax(levels)])
    return best, at
