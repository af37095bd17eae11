"""Lyapunov and Stein equations, the linear ones that every norm, Gramian and Newton step rests on."""

import warnings

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.ordered import Array

DOUBLINGS = 60  # 2^60 steps of the underlying recursion
ROUND_OFF = 1e-16


def lyapunov(A: Array, Q: Array) -> Array:
    """Solve A X + X A' + Q = 0 for symmetric Q."""
    if A.shape[0] == 0:
        return np.zeros((0, 0))
    with warnings.catch_warnings():
        # SciPy warns where A and -A nearly share an eigenvalue; callers look at the residual instead
        warnings.simplefilter("ignore", RuntimeWarning)
        return symmetric(solve_continuous_lyapunov(A, -Q))


@np.errstate(over="ignore", invalid="ignore")
def stein(A: Array, Q: Array) -> Array:
    """Solve X = A X A' + Q for stable A by doubling (squared Smith); 2^k terms of the series after k steps.

    Raises:
        NumericalError: A has an eigenvalue on or outside the unit circle.
    """
    X, E = Q.copy(), A.copy()
    for _ in range(DOUBLINGS):
        step = E @ X @ E.T
        X = X + step
        size = np.linalg.norm(X)
        if not np.isfinite(size):
            break
        if np.linalg.norm(step) <= ROUND_OFF * size:
            return symmetric(X)
        E = E @ E
    raise NumericalError("Stein equation: A has an eigenvalue on or outside the unit circle, so the sum has no limit.")


def symmetric(X: Array) -> Array:
    """Return the symmetric part."""
    return (X + X.T) / 2
