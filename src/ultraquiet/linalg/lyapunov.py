"""Lyapunov and Stein equations, the linear ones that every norm, Gramian and Newton step rests on."""

import warnings

import numpy as np
from scipy.linalg import LinAlgError, bandwidth, solve_continuous_lyapunov, solve_triangular
from scipy.linalg.lapack import dgebal, dtrsyl  # pyright: ignore[reportAttributeAccessIssue]

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.ordered import Array, complex_schur, real_schur

DOUBLINGS = 60  # 2^60 steps of the underlying recursion
ROUND_OFF = 1e-16
CONTRACTED = 0.5  # norm of a power of A from which on its further powers can but take away
LEAST = 45  # rows and columns of a triangular block that LAPACK solves: halves of fewer cost more than they spare
OPPOSED = 8 * float(np.finfo(float).eps)  # of the sizes of two eigenvalues: a smaller sum is none
SOLVED = 1e-8  # of the sizes of the terms; what is left above it means that there was nothing to find


@np.errstate(over="ignore", invalid="ignore")
def lyapunov(A: Array, Q: Array) -> Array:
    """Solve A X + X A' + Q = 0 for symmetric Q, in balanced coordinates, and look at what is left of it.

    Raises:
        NumericalError: A and -A' share an eigenvalue, or so nearly that no digit of X holds.
    """
    if A.shape[0] == 0:
        return np.zeros((0, 0))
    A, Q, d = _balanced(A, Q, "Lyapunov")
    with warnings.catch_warnings(record=True) as said:
        # SciPy warns where the sum of two eigenvalues is small beside A, which poles far apart in speed may well be
        warnings.simplefilter("always", RuntimeWarning)
        try:
            X = symmetric(solve_continuous_lyapunov(A, -Q))
        except LinAlgError:
            X = np.full(Q.shape, np.nan)
    if said:  # LAPACK moved a pair of eigenvalues apart and solved something else
        X = np.full(Q.shape, np.nan) if _opposed(np.linalg.eigvals(A)) else _unmoved(A, Q)
    left = np.linalg.norm(A @ X + X @ A.T + Q)
    size = np.linalg.norm(A) * np.linalg.norm(X) + np.linalg.norm(Q)
    if not (np.isfinite(size) and left <= SOLVED * size):
        raise NumericalError(
            f"Lyapunov equation ({A.shape[0]} states): A and -A share an eigenvalue, so it has no single solution."
        )
    return X * np.outer(d, d)


def _opposed(values: Array) -> bool:
    """Return whether the sum of two eigenvalues is zero but for round-off of the two."""
    size = np.abs(values)
    return bool(np.any(np.abs(values[:, None] + values[None, :]) <= OPPOSED * (size[:, None] + size[None, :])))


def _unmoved(A: Array, Q: Array) -> Array:
    """Return X, column by column of a complex Schur form, whatever the sums of eigenvalues are beside the size of A."""
    T, U = complex_schur(A)
    F, n = U.conj().T @ Q @ U, len(T)
    X = np.zeros((n, n), dtype=np.complex128)
    for k in range(n - 1, -1, -1):
        right = -F[:, k] - X[:, k + 1 :] @ T[k, k + 1 :].conj()
        X[:, k] = solve_triangular(T + T[k, k].conj() * np.eye(n), right, check_finite=False)
    return symmetric((U @ X @ U.conj().T).real)


@np.errstate(over="ignore", invalid="ignore")
def lyapunov_both(A: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """Solve A X + X A' + Q = 0 and A' Y + Y A + R = 0 for symmetric Q and R from one Schur form, as `lyapunov` does.

    Raises:
        NumericalError: A and -A' share an eigenvalue, or so nearly that no digit of X or Y holds.
    """
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, 0))
    if not all(np.isfinite(M).all() for M in (A, Q, R)):
        raise _overflowing(A, "Lyapunov")
    A, d = _evened(A)
    D = np.outer(d, d) if np.any(d != 1) else 1.0
    Q, R = Q / D, R * D
    try:
        T, U = (A, None) if _is_schur(A) else real_schur(A)
        X, Y = _by_halves(T, *(-M if U is None else -(U.T @ M @ U) for M in (Q, R)))
    except LinAlgError:
        return lyapunov(A, Q) * D, lyapunov(A.T, R) / D
    X, Y = (symmetric(M if U is None else U @ M @ U.T) for M in (X, Y))
    for a, x, q in ((A, X, Q), (A.T, Y, R)):
        half, size = a @ x, np.linalg.norm(a) * np.linalg.norm(x) + np.linalg.norm(q)
        if not (np.isfinite(size) and np.linalg.norm(half + half.T + q) <= SOLVED * size):
            raise NumericalError(
                f"Lyapunov equation ({n} states): A and -A share an eigenvalue, so it has no single solution."
            )
    return X * D, Y / D


@np.errstate(over="ignore", invalid="ignore")
def stein(A: Array, Q: Array) -> Array:
    """Solve X = A X A' + Q for stable A by doubling (squared Smith); 2^k terms of the series after k steps.

    Where the powers of A grow so far before they fall that rounding keeps them up, by the bilinear map.

    Raises:
        NumericalError: A has an eigenvalue on or outside the unit circle.
    """
    if A.shape[0] == 0:
        return np.zeros((0, 0))
    A, Q, d = _balanced(A, Q, "Stein")
    E, X = A, Q
    for _ in range(DOUBLINGS):
        step = E @ X @ E.T
        X = X + step
        size = float(np.linalg.norm(X))
        if not np.isfinite(size):
            break
        if np.linalg.norm(step) <= ROUND_OFF * size * len(A) and _is_last(E, step, X):
            return symmetric(X) * np.outer(d, d)
        E = E @ E
    return _mapped(A, Q) * np.outer(d, d)


@np.errstate(over="ignore", invalid="ignore")
def stein_factor(A: Array, B: Array) -> Array:
    """Return R `(n, n)` with R R' = A R R' A' + B B' for stable A, by doubling of the factor itself.

    Its singular values hold all digits, counted from the largest, where the root of a solved equation holds half: such
    a root is returned where doubling does not come to an end, see `stein`.

    Raises:
        NumericalError: A has an eigenvalue on or outside the unit circle.
    """
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0))
    _finite(A, B, "Stein")
    A, d = _evened(A)
    B = B / d[:, None]
    E, R = A, B
    for _ in range(DOUBLINGS):
        step = E @ R
        left, size = np.linalg.norm(step), np.hypot(np.linalg.norm(R), np.linalg.norm(step))
        if not np.isfinite(size):
            break
        R = np.asarray(np.linalg.qr(np.hstack([R, step]).T, mode="r")).T
        if left <= ROUND_OFF * size and _is_last_of_factor(E, step, R):
            return np.hstack([R, np.zeros((n, n - R.shape[1]))]) * d[:, None]
        E = E @ E
    values, V = np.linalg.eigh(_mapped(A, B @ B.T))
    return V * np.sqrt(np.maximum(values, 0.0)) * d[:, None]


def _mapped(A: Array, Q: Array) -> Array:
    """Return X = A X A' + Q by the bilinear map to a Lyapunov equation, looked at afterwards.

    With M = (A + I)^-1 it is F X + X F' + 2 M Q M' = 0, F = M (A - I).

    Raises:
        NumericalError: A has an eigenvalue on or outside the unit circle, or nothing was found.
    """
    one = np.eye(len(A))
    try:
        if not np.abs(np.linalg.eigvals(A)).max() < 1:
            raise LinAlgError
        M = np.linalg.inv(A + one)
        X = lyapunov(M @ (A - one), 2 * M @ Q @ M.T)
    except (LinAlgError, NumericalError):
        raise NumericalError(
            "Stein equation: A has an eigenvalue on or outside the unit circle, so the sum has no limit."
        ) from None
    size = (np.linalg.norm(A) ** 2 + 1) * np.linalg.norm(X) + np.linalg.norm(Q)
    if not (np.isfinite(size) and np.linalg.norm(A @ X @ A.T - X + Q) <= SOLVED * size):
        raise NumericalError(
            f"Stein equation ({len(A)} states): the powers of A grow too far before they fall to be summed."
        )
    return X


def _is_last(E: Array, step: Array, X: Array) -> bool:
    """Return whether nothing is left of a series X after a step by E, the power of A that its terms are apart.

    Each entry is held against its own states: what counts for much further on may be small beside the others.
    """
    size = np.sqrt(np.abs(np.diag(X)))
    return bool(np.all(np.abs(step) <= ROUND_OFF * np.outer(size, size))) and _contracts(E, size)


def _is_last_of_factor(E: Array, step: Array, R: Array) -> bool:
    """Return the same of a factor R of the series and of the step."""
    size = np.linalg.norm(R, axis=1)
    return bool(np.all(np.linalg.norm(step, axis=1) <= ROUND_OFF * size)) and _contracts(E, size)


def _contracts(E: Array, size: Array) -> bool:
    """Return whether E contracts states taken over their sizes; one of size zero must be reached from nowhere.

    What follows a step is sum_i E^i step E'^i, i > 0: of a faint one next to nothing as soon as E contracts. Until then
    a chain of states may make as much of it as of any step before.
    """
    carried, there = E * size, size > 0
    if np.any(carried[~there]):
        return False
    return bool(np.linalg.norm(carried[there] / size[there, None]) <= CONTRACTED)


def _balanced(A: Array, Q: Array, who: str) -> tuple[Array, Array, Array]:
    """Return A and Q in the states x / d, and d."""
    _finite(A, Q, who)
    balanced, d = _evened(A)
    return balanced, Q / np.outer(d, d), d


def _finite(A: Array, other: Array, who: str) -> None:
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(other))):
        raise _overflowing(A, who)


def _overflowing(A: Array, who: str) -> NumericalError:
    return NumericalError(f"{who} equation ({A.shape[0]} states): its matrices overflow; scale the problem.")


def _evened(A: Array) -> tuple[Array, Array]:
    """Return A in the states x / d, and d, powers of two that make rows and columns of A alike."""
    balanced, _, _, d, _ = dgebal(A, scale=1, permute=0)
    return balanced, d


def symmetric(X: Array) -> Array:
    """Return the symmetric part."""
    return (X + X.T) / 2


def _by_halves(T: Array, F: Array, G: Array) -> tuple[Array, Array]:
    """Return X and Y of T X + X T' = F and T' Y + Y T = G for a real Schur form T and symmetric F and G.

    LAPACK solves such equations row by row; halved again and again (Jonsson and Kagstrom 2002,
    doi:10.1145/592843.592845) nearly all of the work is in products of matrices, and of a symmetric solution only one
    of two equal blocks is sought.

    Raises:
        LinAlgError: T and -T share an eigenvalue, but for round-off.
    """
    X, Y = F.copy(), G.copy()
    _forward(T, X)
    _backward(T, Y)
    return X, Y


def _is_schur(A: Array) -> bool:
    """Return whether a matrix is block triangular already, with blocks of one or two rows."""
    if bandwidth(A)[0] > 1:
        return False
    low = np.diag(A, -1) != 0
    return not np.any(low[1:] & low[:-1])


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
