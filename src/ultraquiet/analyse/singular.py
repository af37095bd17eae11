"""Gains by direction."""

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.state_space import StateSpace


def singular_values(G: StateSpace, f_hz: ArrayLike) -> FloatArray:
    """Return the singular values of a system over frequency, largest first.

    Args:
        G: system.
        f_hz: frequencies, Hz.

    Returns:
        `(min(ny, nu), nf)`: the gains of the best to the worst direction. A wide band means that a few directions are
        hard to measure or to move. At an undamped pole, as at 0 Hz of an integrator, they are infinite.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)
    >>> float(singular_values(G, [0.0])[0, 0])
    2.0
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return principal_gains(G.frequency_response(f_hz))
