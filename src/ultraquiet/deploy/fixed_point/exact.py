"""Least squares in fractions: no rounding, so the same words on every machine and with every BLAS."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ultraquiet.deploy.fixed_point.law import Whole


def least_squares(rows: Whole, targets: Sequence[int], powers: Sequence[int]) -> list[Fraction]:
    """Return the least x `(n,)` among those that come nearest: min sum_i (2^p_i (r_i x - t_i))^2, exactly.

    With R the rows times their 2^p and t the targets likewise, x = R' z and (R R')(R R') z = (R R') t, which always has
    a solution; R' z is the same for all of them.

    Args:
        rows: whole numbers r, `(m, n)`.
        targets: whole numbers t, `(m,)`.
        powers: p >= 0, `(m,)`.

    >>> least_squares(np.array([[3, 0, 4], [0, 1, 0]]), [5, 2], [0, 3])
    [Fraction(3, 5), Fraction(2, 1), Fraction(4, 5)]
    """
    # Python's own integers: products of products leave 64 bits.
    weighted = np.array([[int(r) << int(p) for r in row] for row, p in zip(rows, powers, strict=True)], object)
    wanted = np.array([int(t) << int(p) for t, p in zip(targets, powers, strict=True)], object)
    gram = weighted @ weighted.T
    return [Fraction(x) for x in weighted.T @ np.array(_solved(gram @ gram, gram @ wanted), object)]


def _solved(matrix: Any, right: Any) -> list[Fraction]:
    """Return a solution of a square system that has one, unknowns that it leaves open zero: Gauss and Jordan."""
    rows = [[Fraction(a) for a in (*row, b)] for row, b in zip(matrix, right, strict=True)]
    pivots: list[int] = []
    for column in range(len(rows)):
        done = len(pivots)
        at = next((i for i in range(done, len(rows)) if rows[i][column]), None)
        if at is None:
            continue
        rows[done], rows[at] = rows[at], rows[done]
        own = rows[done] = [a / rows[done][column] for a in rows[done]]
        for i, row in enumerate(rows):
            if i != done and row[column]:
                rows[i] = [a - row[column] * b for a, b in zip(row, own, strict=True)]
        pivots.append(column)
    found = [Fraction(0)] * len(rows)
    for row, column in zip(rows, pivots, strict=False):
        found[column] = row[-1]
    return found
