"""Searches from point to point by Levenberg and Marquardt's steps.

Whether a point is that of several experiments whose polynomials are tied or of a record on disk, it knows its normal
matrix, what a step from it leads to and what that gains. One record in memory is searched by `kernels.point`, compiled.
"""

from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.damping_policy import (
    CONVERGED,
    FIRST_DAMPING,
    INNER_TRIES,
    RUNNING,
    STUCK,
    after_gain,
    after_loss,
    at_minimum,
)


class Point(Protocol):
    """A point of a search; units are those of the criterion, where the innovation's variance makes `unit`."""

    @property
    def criterion(self) -> float:
        """What is minimised."""
        ...

    @property
    def unit(self) -> float:
        """What the square of one innovation adds."""
        ...

    def normal(self) -> FloatArray:
        """Return [J e]'[J e] of the unknowns, past and constant eliminated."""
        ...

    def moved(self, step: FloatArray) -> Self | None:
        """Return the point a step leads to; None when one of its models is not admissible."""
        ...

    def gained(self, other: Self) -> float:
        """Return how much less the criterion is at the other point."""
        ...


P = TypeVar("P", bound=Point)


class Ended(Generic[P]):
    """Where a search ended: the point, its normal matrix, the iterations and the state reached.

    CONVERGED: the next step would move the sum of squares by less than `tolerance` innovations' variances (that is, the
    estimate by less than sqrt(tolerance) of its own standard deviation), or STALLED_STEPS steps in a row gained less;
    RUNNING: iterations used up; STUCK: no admissible step gains anything although the gradient promises it.
    """

    def __init__(self, point: P, normal: FloatArray, iterations: int, state: int) -> None:
        self.point, self.normal, self.iterations, self.state = point, normal, iterations, state


def minimise(here: P, steps: int, tolerance: float, damping: float = FIRST_DAMPING) -> Ended[P]:
    """Search from a point until it ends or `steps` are used up."""
    from ultraquiet.identify.prediction_error.kernels.normal_equations import damped_step

    state, small, iterations = RUNNING, 0, 0
    while True:
        S = here.normal()
        if not np.isfinite(here.criterion):
            return Ended(here, S, iterations, STUCK)
        if at_minimum(damped_step(S, 0.0)[1], small, tolerance * here.unit):
            state = CONVERGED
        if state != RUNNING or iterations >= steps:
            return Ended(here, S, iterations, state)
        iterations += 1
        for _ in range(INNER_TRIES):
            step, promised = damped_step(S, damping)
            there = here.moved(step)
            gain = here.gained(there) if there is not None else -np.inf
            if there is not None and gain > 0.0:
                damping = after_gain(damping, gain, promised)
                small = small + 1 if gain <= tolerance * here.unit else 0
                here = there
                break
            damping = after_loss(damping)
        else:
            return Ended(here, S, iterations, STUCK)
