"""States scaled by powers of two, so that orthogonal transformations of them lose nothing, and which of them count."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgebal  # pyright: ignore[reportAttributeAccessIssue]

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg.ordered import Array, real_schur

SWEEPS = 20  # a handful settles it
TANGLED = 1.5  # norm of A over its largest eigenvalue, beyond which terms of A cancel that rounding makes part of
UNEVEN = 2.0**8  # row sums against column sums: states that lead to one another may each cost as many bits


def evened(
    A: FloatArray, B: FloatArray, C: FloatArray, uneven: float = 1.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B, C with states scaled by powers of two until rows of [A B] and columns of [A; C] match.

    Args:
        A: `(n, n)`.
        B: `(n, nu)`.
        C: `(ny, n)`.
        uneven: how far rows and columns may differ, as a ratio of their sums, for the system to be left as it is.
    """
    off = np.abs(A - np.diag(np.diag(A)))
    b, c = np.abs(B).sum(axis=1), np.abs(C).sum(axis=0)
    rows, columns = off.sum(axis=1) + b, off.sum(axis=0) + c
    both = (rows > 0) & (columns > 0)
    ratio = rows[both] / columns[both]
    if not ratio.size or max(float(ratio.max()), 1 / float(ratio.min())) < uneven:
        return A, B, C
    d = np.ones(A.shape[0])
    for _ in range(SWEEPS):
        before = d.copy()
        for k in range(d.size):
            row, column = (off[k] @ d + b[k]) / d[k], (off[:, k] @ (1 / d) + c[k]) * d[k]
            if row > 0 and column > 0:
                d[k] *= np.exp2(np.round(0.5 * np.log2(row / column)))
        if np.array_equal(before, d):
            break
    return A * d / d[:, None], B / d[:, None], C * d


def to_unit_size(size: Array) -> Array:
    """Return powers of two, which cost no digit, that bring sizes near to one; one where there is none."""
    return np.exp2(-np.round(np.log2(np.where(size > 0, size, 1.0))))


def even_scale(A: FloatArray, B: FloatArray, C: FloatArray) -> FloatArray:
    """Return d, powers of two, such that the states x / d have rows of [A B] as large as columns of [A; C].

    LAPACK's balancing of [A, b; c, 0], where b and c are the sizes of the rows of B and the columns of C: one more
    state closes the loop from outputs to inputs, so that no unit is free where the states are seen and reached.
    """
    n = A.shape[0]
    bordered = np.zeros((n + 1, n + 1))
    bordered[:n, :n] = A
    bordered[:n, n], bordered[n, :n] = np.linalg.norm(B, axis=1), np.linalg.norm(C, axis=0)
    d = np.asarray(dgebal(bordered, scale=1, permute=0)[3], dtype=np.float64)
    return d[:n] / d[n]


def even_states(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array, Array]:
    """Return A, B and C in the states x / d of `even_scale`, and d."""
    d = even_scale(A, B, C)
    return A * d / d[:, None], B / d[:, None], C * d, d


def connected(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B and C without the states through which no input reaches any output, by their zeros alone.

    They are no part of the response, whatever their size: what is computed with them is round-off in it.
    """
    linked = A != 0
    reached, seen = np.any(B != 0, axis=1), np.any(C != 0, axis=0)
    kept = _followed(linked, reached) & _followed(linked.T, seen)
    return (A, B, C) if kept.all() else (A[np.ix_(kept, kept)], B[kept], C[:, kept])


def _followed(linked: NDArray[np.bool_], found: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return what can be reached from what is found, where `linked[i, j]` leads from j to i."""
    while np.any(more := linked[:, found].any(axis=1) & ~found):
        found = found | more
    return found


def untangled(A: FloatArray, B: FloatArray, C: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B, C in even coordinates in which A is hardly larger than its eigenvalues; as they are where it is not.

    What is formed of a controller whose large terms cancel, as a closed loop, is round-off of those terms. A real Schur
    form has the eigenvalues on its diagonal and, its states scaled by powers of two, little beside them.
    """
    if not A.size:
        return A, B, C
    a, b, c, _ = even_states(A, B, C)
    size = np.linalg.norm(a) / (TANGLED * np.sqrt(len(a)))
    # the mean square of the eigenvalues is no more than the square of the largest, and quickly there
    if size**2 <= abs(float(np.sum(a * a.T))) / len(a) or size <= np.abs(np.linalg.eigvals(a)).max():
        return A, B, C
    T, Q = real_schur(a)
    return even_states(T, Q.T @ b, c @ Q)[:3]
