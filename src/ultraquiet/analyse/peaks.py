"""Peaks over frequency, refined between the points of a grid."""

from collections.abc import Callable

import numpy as np

from ultraquiet._base.constraints import FloatArray

NEAR = 0.9  # share of the highest point that a neighbour needs to be looked at more closely
MOST = 8  # peaks looked at
INNER = 3  # points between a peak and each neighbour: a round narrows it to a quarter
ROUNDS = 9  # 4^-9 of the grid's step: a kink's place to 4e-6 of it


def refined(values_at: Callable[[FloatArray], FloatArray], f: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Return the largest value and its frequency, with the grid narrowed around every peak that may be the largest.

    Args:
        values_at: gives values `(n,)` at frequencies `(n,)`.
        f: grid, Hz, ascending.
        values: on the grid.
    """
    k = int(np.argmax(values))
    best, at = float(values[k]), float(f[k])
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (values >= NEAR * best))
    tops = tops[np.argsort(-values[tops])][:MOST]
    middle, low, high = f[tops], f[np.maximum(tops - 1, 0)], f[np.minimum(tops + 1, f.size - 1)]
    share = np.linspace(0, 1, INNER + 1, endpoint=False)
    for _ in range(ROUNDS):
        points = np.sort(
            np.concatenate([low[:, None] + share * (high - low)[:, None], middle[:, None]], axis=1), axis=1
        )
        found = values_at(points.reshape(-1)).reshape(points.shape)
        k = np.argmax(found, axis=1)
        rows = np.arange(k.size)
        middle, low = points[rows, k], points[rows, np.maximum(k - 1, 0)]
        high = points[rows, np.minimum(k + 1, points.shape[1] - 1)]
        if found.max() > best:
            best, at = float(found.max()), float(points.reshape(-1)[np.argmax(found)])
    return best, at
