"""Laws that pair every channel with one of its own: a square plant, and the one function that stands for all."""

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace

WOULD_DO = "pick or blend as many of both, or take a method for any shape: 'mixed-sensitivity', 'lqg'."
NEGLIGIBLE = 1e-6  # Hankel values below this share of the largest leave the function


def require_square(who: str, plant: StateSpace) -> None:
    """Refuse a plant without as many outputs as inputs.

    Raises:
        InputError: with what would do.
    """
    ny, nu = plant.D.shape
    if ny != nu:
        raise InputError(f"{who}: the plant must be square, got {ny} outputs and {nu} inputs; {WOULD_DO}")


def mean_channel(plant: StateSpace) -> StateSpace:
    """Return trace(G) / n, the mean of the plant's eigenvalues, as a scalar function.

    One scalar law on every channel meets each eigenvalue of G. Their mean has the modes of all directions, each as far
    as it counts; one direction alone, all channels moving together, has its own sharp modes only, and a law that
    inverts these amplifies where the other directions have theirs. Parts at Hankel values of no account are removed.

    An unstable plant keeps all its states and gives v' G v with v = (1, ..., 1) / sqrt(n), for a sum of its channels
    would hold each unstable mode several times.

    Raises:
        InputError: the plant has not as many outputs as inputs.
    """
    require_square("mean_channel", plant)
    n = plant.D.shape[0]
    if not plant.is_stable():
        v = np.ones((n, 1)) / np.sqrt(n)
        return StateSpace(plant.A, plant.B @ v, v.T @ plant.C, v.T @ plant.D @ v, rate_hz=plant.rate_hz)
    discrete, parts = plant.rate_hz is not None, None
    for i in range(n):
        one = (plant.A, plant.B[:, [i]], plant.C[[i]] / n, plant.D[[i]][:, [i]] / n)
        each = balance.without_faint(one, NEGLIGIBLE, discrete=discrete)
        parts = each if parts is None else _sum(parts, each)
    assert parts is not None
    M = parts if n == 1 else balance.without_faint(parts, NEGLIGIBLE, discrete=discrete)
    return StateSpace(*M, rate_hz=plant.rate_hz)


def _sum(first: Matrices, second: Matrices) -> Matrices:
    (A, B, C, D), (a, b, c, d) = first, second
    n, m = len(A), len(a)
    both = np.block([[A, np.zeros((n, m))], [np.zeros((m, n)), a]])
    return both, np.vstack([B, b]), np.hstack([C, c]), D + d


def designed_for(plant: StateSpace) -> StateSpace:
    """Return the mean channel of a plant, without modes of an unstable one that it neither sees nor moves.

    Modes of differences between its channels are none of the shared function's; the same law on every channel meets
    them there as it meets those that are shared.

    Raises:
        InputError: the plant has not as many outputs as inputs.
    """
    part = mean_channel(plant)
    if plant.is_stable() or plant.D.shape == (1, 1):
        return part
    M = balance.without_hidden((part.A, part.B, part.C, part.D), NEGLIGIBLE, discrete=plant.rate_hz is not None)
    return StateSpace(*M, rate_hz=plant.rate_hz)
