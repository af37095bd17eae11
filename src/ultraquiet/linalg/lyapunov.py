"""Lyapunov and Stein equations, the linear ones that every norm, Gramian and Newton step rests on."""

import warnings

import numpy as np
from scipy.linalg import LinAlgError, matrix_balance, solve_continuous_lyapunov

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.ordered import Array

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


def _balanced(A: Array, Q: Array, who: str) -> tuple[Array, Array, Array]:
    """Return A and Q in the states x / d, d powers of two that make rows and columns of A alike."""
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(Q))):
        raise NumericalError(f"{who} equation ({A.shape[0]} states): its matrices overflow; scale the problem.")
    with np.errstate(invalid="ignore"):  # SciPy also turns the scale factors into integers, which large ones overflow
        balanced, (d, _) = matrix_balance(A, permute=False, separate=True)
    return balanced, Q / np.outer(d, d), d


def symmetric(X: Array) -> Array:
    """Return the symmetric part."""
    return (X + X.T) / 2
