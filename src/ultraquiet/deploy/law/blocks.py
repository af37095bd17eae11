"""Block-diagonal real forms of a matrix whose change of coordinates stays well conditioned."""

from typing import Any

import numpy as np
from scipy.linalg import get_lapack_funcs, schur

from ultraquiet._base.constraints import FloatArray

# Eigenvectors of coinciding poles: chains have condition numbers from 1/sqrt(eps) = 7e7 on, poles that merely coincide
# some ten.
COINCIDING_BOUND = 1e4


def block_diagonal(A: FloatArray, bound: float) -> tuple[list[FloatArray], FloatArray]:
    """Return blocks and V with A V = V diag(blocks), every block as small as `bound` allows.

    Starts from the real Schur form; the leading block is split off by X of T11 X - X T22 = -T12 while ||X||_F <= bound,
    otherwise it takes in the nearest remaining eigenvalue and tries again. ||X|| measures how far the split is from an
    orthogonal one, so `bound` = 0 leaves the Schur form itself and infinity separates all that differs.

    Blocks of poles that coincide without a chain, as in laws of alike channels, are diagonalised afterwards where their
    eigenvectors allow it.

    Reference: Bavely & Stewart, SIAM J. Numer. Anal. 16 (1979), doi:10.1137/0716028.
    """
    T, V = (np.asarray(m, dtype=np.float64) for m in schur(A, output="real"))
    blocks: list[FloatArray] = []
    start, n = 0, A.shape[0]
    while start < n:
        size = _first_size(T, start)
        while start + size < n:
            X = _split(T, start, size)
            if X is not None and np.linalg.norm(X) <= bound:
                V[:, start + size :] += V[:, start : start + size] @ X
                break
            T, V, size = _take_nearest(T, V, start, size)
        own = slice(start, start + size)
        small, turn = _diagonalised(T[own, own].copy(), min(bound, COINCIDING_BOUND))
        blocks.extend(small)
        V[:, own] = V[:, own] @ turn
        start += size
    return blocks, V


def _diagonalised(block: FloatArray, bound: float) -> tuple[list[FloatArray], FloatArray]:
    """Return blocks of one and two and the change of coordinates, or the block itself where that costs too much."""
    n = len(block)
    if n <= 2:
        return [block], np.eye(n)
    values, vectors = np.linalg.eig(block)
    columns, small = [], []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag > 0:
            columns += [np.sqrt(2) * vector.real, np.sqrt(2) * vector.imag]
            small.append(np.array([[value.real, value.imag], [-value.imag, value.real]]))
        elif value.imag == 0:
            columns.append(vector.real)
            small.append(np.array([[value.real]]))
    turn = np.stack(columns, axis=1)
    return (small, turn) if np.linalg.cond(turn) <= bound else ([block], np.eye(n))


def _first_size(T: FloatArray, at: int) -> int:
    """Return 2 where a complex pair begins at row `at` of a real Schur form, else 1."""
    return 2 if at + 1 < T.shape[0] and T[at + 1, at] != 0 else 1


def _split(T: FloatArray, start: int, size: int) -> FloatArray | None:
    middle = start + size
    solve: Any = get_lapack_funcs("trsyl", (T,))
    X, scale, info = solve(T[start:middle, start:middle], T[middle:, middle:], -T[start:middle, middle:], isgn=-1)
    # scale below one and info = 1 are LAPACK's signs of a separation too small to divide by.
    return X if info == 0 and scale == 1.0 and np.all(np.isfinite(X)) else None


def _take_nearest(T: FloatArray, V: FloatArray, start: int, size: int) -> tuple[FloatArray, FloatArray, int]:
    """Move the eigenvalue nearest to the block's mean up to its end and let the block have it."""
    middle, n = start + size, T.shape[0]
    centre = np.trace(T[start:middle, start:middle]) / size
    spread = np.sort(np.abs(np.linalg.eigvals(T[start:middle, start:middle]).imag))[size // 2]
    best, nearest, at = np.inf, middle, middle
    while at < n:
        width = _first_size(T, at)
        value = _eigenvalue(T, at, width)
        distance = abs(value - complex(centre, spread))
        if distance < best:
            best, nearest = distance, at
        at += width
    # LAPACK counts from one.
    exchange: Any = get_lapack_funcs("trexc", (T,))
    T, V, info = exchange(T, V, nearest + 1, middle + 1)
    if info != 0:  # two blocks too close to swap: take in everything up to the one wanted instead
        return T, V, nearest - start + _first_size(T, nearest)
    return T, V, size + _first_size(T, middle)


def _eigenvalue(T: FloatArray, at: int, width: int) -> complex:
    if width == 1:
        return complex(T[at, at], 0.0)
    half = 0.5 * (T[at, at] + T[at + 1, at + 1])
    product = T[at, at + 1] * T[at + 1, at] + 0.25 * (T[at, at] - T[at + 1, at + 1]) ** 2
    return complex(half, np.sqrt(abs(product)))
