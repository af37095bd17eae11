"""Lyapunov equations of a real Schur form, by halves: what is left to do in them are products of matrices.

LAPACK solves such equations row by row; halved again and again (Jonsson and Kagstrom 2002, doi:10.1145/592843.592845)
nearly all of the work is in products, and of a symmetric solution only one of the two equal blocks is sought.
"""

import numpy as np
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dtrsyl  # pyright: ignore[reportAttributeAccessIssue]

from ultraquiet.linalg.ordered import Array

LEAST = 48  # rows and columns of a block that LAPACK solves


def both_lyapunov(T: Array, F: Array, G: Array) -> tuple[Array, Array]:
    """Return X and Y of T X + X T' = F and T' Y + Y T = G for a real Schur form T and symmetric F and G.

    Raises:
        LinAlgError: T and -T share an eigenvalue, but for round-off.
    """
    X, Y = F.copy(), G.copy()
    _forward(T, X)
    _backward(T, Y)
    return X, Y


def is_schur(A: Array) -> bool:
    """Return whether a matrix is block triangular already, with blocks of one or two rows."""
    low = np.diag(A, -1) != 0
    return not (np.any(low[1:] & low[:-1]) or np.any(np.tril(A, -2)))


def _forward(T: Array, X: Array) -> None:
    """Put the solution of T X + X T' = F in the place of F."""
    n = len(T)
    if n <= LEAST:
        X[:] = _small(T, T, X, "N", "T")
        return
    k = _half(T, n)
    one, two = slice(k), slice(k, n)
    _forward(T[two, two], X[two, two])
    X[one, two] -= T[one, two] @ X[two, two]
    _sylvester(T[one, one], T[two, two], X[one, two])
    step = T[one, two] @ X[one, two].T
    X[one, one] -= step + step.T
    _forward(T[one, one], X[one, one])
    X[two, one] = X[one, two].T


def _backward(T: Array, X: Array) -> None:
    """Put the solution of T' X + X T = F in the place of F."""
    n = len(T)
    if n <= LEAST:
        X[:] = _small(T, T, X, "T", "N")
        return
    k = _half(T, n)
    one, two = slice(k), slice(k, n)
    _backward(T[one, one], X[one, one])
    X[one, two] -= X[one, one] @ T[one, two]
    _transposed(T[one, one], T[two, two], X[one, two])
    step = T[one, two].T @ X[one, two]
    X[two, two] -= step + step.T
    _backward(T[two, two], X[two, two])
    X[two, one] = X[one, two].T


def _sylvester(A: Array, B: Array, X: Array) -> None:
    """Put the solution of A X + X B' = F in the place of F."""
    m, n = X.shape
    if max(m, n) <= LEAST:
        X[:] = _small(A, B, X, "N", "T")
    elif m >= n:
        k = _half(A, m)
        _sylvester(A[k:, k:], B, X[k:])
        X[:k] -= A[:k, k:] @ X[k:]
        _sylvester(A[:k, :k], B, X[:k])
    else:
        k = _half(B, n)
        _sylvester(A, B[k:, k:], X[:, k:])
        X[:, :k] -= X[:, k:] @ B[:k, k:].T
        _sylvester(A, B[:k, :k], X[:, :k])


def _transposed(A: Array, B: Array, X: Array) -> None:
    """Put the solution of A' X + X B = F in the place of F."""
    m, n = X.shape
    if max(m, n) <= LEAST:
        X[:] = _small(A, B, X, "T", "N")
    elif m >= n:
        k = _half(A, m)
        _transposed(A[:k, :k], B, X[:k])
        X[k:] -= A[:k, k:].T @ X[:k]
        _transposed(A[k:, k:], B, X[k:])
    else:
        k = _half(B, n)
        _transposed(A, B[:k, :k], X[:, :k])
        X[:, k:] -= X[:, :k] @ B[:k, k:]
        _transposed(A, B[k:, k:], X[:, k:])


def _small(A: Array, B: Array, F: Array, on_a: str, on_b: str) -> Array:
    X, scale, info = dtrsyl(A, B, F, trana=on_a, tranb=on_b)
    if info != 0 or scale == 0:
        raise LinAlgError("the blocks share an eigenvalue")
    return np.asarray(X / scale)


def _half(T: Array, n: int) -> int:
    """Return where to cut a Schur form into halves: not through a pair of complex eigenvalues."""
    k = n // 2
    return k + 1 if T[k, k - 1] != 0 else k
