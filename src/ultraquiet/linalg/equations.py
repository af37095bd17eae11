"""Riccati and Lyapunov equations, each solved by a ladder of methods and checked outside the solver."""

from ultraquiet.linalg.lyapunov import lyapunov, lyapunov_both, stein, stein_factor
from ultraquiet.linalg.riccati import Riccati
from ultraquiet.linalg.riccati_continuous import (
    continuous_regulator,
    continuous_residual,
    continuous_riccati,
    newton_direction,
)
from ultraquiet.linalg.riccati_discrete import discrete_gain, discrete_least_squares, discrete_riccati

__all__ = [
    "Riccati",
    "continuous_regulator",
    "continuous_residual",
    "continuous_riccati",
    "discrete_gain",
    "discrete_least_squares",
    "discrete_riccati",
    "lyapunov",
    "lyapunov_both",
    "newton_direction",
    "stein",
    "stein_factor",
]
