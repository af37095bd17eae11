"""Lyapunov and Stein equations, the linear ones that every norm, Gramian and Newton step rests on."""

import warnings

import numpy as np
from scipy.linalg import LinAlgError, matrix_balance, solve_continuous_lyapunov

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.ordered import Array, real_schur
from ultraquiet.linalg.triangular import both_lyapunov, is_schur

DOUBLINGS = 60  # 2^60 steps of the underlying recursion
ROUND_OFF = 1e-16
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
    with warnings.catch_warnings():
        # SciPy warns where A and -A nearly share an eigenvalue; what counts is the residual
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            X = symmetric(solve_continuous_lyapunov(A, -Q))
        except LinAlgError:
            X = np.full(Q.shape, np.nan)
    left = np.linalg.norm(A @ X + X @ A.T + Q)
    size = np.linalg.norm(A) * np.linalg.norm(X) + np.linalg.norm(Q)
    if not (np.isfinite(size) and left <= SOLVED * size):
        raise NumericalError(
            f"Lyapunov equation ({A.shape[0]} states): A and -A share an eigenvalue, so it has no single solution."
        )
    return X * np.outer(d, d)


@np.errstate(over="ignore", invalid="ignore")
def lyapunov_both(A: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """Solve A X + X A' + Q = 0 and A' Y + Y A + R = 0 for symmetric Q and R from one Schur form, as `lyapunov` does.

    Raises:
        NumericalError: A and -A' share an eigenvalue, or so nearly that no digit of X or Y holds.
    """
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, 0))
    _finite(A, Q, "Lyapunov")
    _finite(A, R, "Lyapunov")
    A, d = _evened(A)
    D = np.outer(d, d)
    Q, R = Q / D, R * D
    try:
        T, U = (A, None) if is_schur(A) else real_schur(A)
        X, Y = both_lyapunov(T, *(-M if U is None else -(U.T @ M @ U) for M in (Q, R)))
    except LinAlgError:
        return lyapunov(A, Q) * D, lyapunov(A.T, R) / D
    X, Y = (symmetric(M if U is None else U @ M @ U.T) for M in (X, Y))
    for a, x, q in ((A, X, Q), (A.T, Y, R)):
        size = np.linalg.norm(a) * np.linalg.norm(x) + np.linalg.norm(q)
        half = a @ x
        if not (np.isfinite(size) and np.linalg.norm(half + half.T + q) <= SOLVED * size):
            raise NumericalError(
                f"Lyapunov equation ({n} states): A and -A share an eigenvalue, so it has no single solution."
            )
    return X * D, Y / D


@np.errstate(over="ignore", invalid="ignore")
def stein(A: Array, Q: Array) -> Array:
    """Solve X = A X A' + Q for stable A by doubling (squared Smith); 2^k terms of the series after k steps.

    Raises:
        NumericalError: A has an eigenvalue on or outside the unit circle.
    """
    if A.shape[0] == 0:
        return np.zeros((0, 0))
    E, X, d = _balanced(A, Q, "Stein")
    for _ in range(DOUBLINGS):
        step = E @ X @ E.T
        X = X + step
        size = np.linalg.norm(X)
        if not np.isfinite(size):
            break
        if np.linalg.norm(step) <= ROUND_OFF * size:
            return symmetric(X) * np.outer(d, d)
        E = E @ E
    raise NumericalError("Stein equation: A has an eigenvalue on or outside the unit circle, so the sum has no limit.")


@np.errstate(over="ignore", invalid="ignore")
def stein_factor(A: Array, B: Array) -> Array:
    """Return R `(n, n)` with R R' = A R R' A' + B B' for stable A, by doubling of the factor itself.

    Its singular values hold all digits, counted from the largest, where the root of a solved equation holds half.

    Raises:
        NumericalError: A has an eigenvalue on or outside the unit circle.
    """
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0))
    _finite(A, B, "Stein")
    E, d = _evened(A)
    R = B / d[:, None]
    for _ in range(DOUBLINGS):
        step = E @ R
        size = np.hypot(np.linalg.norm(R), np.linalg.norm(step))
        if not np.isfinite(size):
            break
        R = np.asarray(np.linalg.qr(np.hstack([R, step]).T, mode="r")).T
        if np.linalg.norm(step) <= ROUND_OFF * size:
            return np.hstack([R, np.zeros((n, n - R.shape[1]))]) * d[:, None]
        E = E @ E
    raise NumericalError("Stein equation: A has an eigenvalue on or outside the unit circle, so the sum has no limit.")


def _balanced(A: Array, Q: Array, who: str) -> tuple[Array, Array, Array]:
    """Return A and Q in the states x / d, and d."""
    _finite(A, Q, who)
    balanced, d = _evened(A)
    return balanced, Q / np.outer(d, d), d


def _finite(A: Array, other: Array, who: str) -> None:
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(other))):
        raise NumericalError(f"{who} equation ({A.shape[0]} states): its matrices overflow; scale the problem.")


def _evened(A: Array) -> tuple[Array, Array]:
    """Return A in the states x / d, and d, powers of two that make rows and columns of A alike."""
    with np.errstate(invalid="ignore"):  # SciPy also turns the scale factors into integers, which large ones overflow
        balanced, (d, _) = matrix_balance(A, permute=False, separate=True)
    return balanced, d


def symmetric(X: Array) -> Array:
    """Return the symmetric part."""
    return (X + X.T) / 2
