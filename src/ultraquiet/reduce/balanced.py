"""Balanced reduction without regard to the loop."""

from dataclasses import asdict, dataclass

import numpy as np

from ultraquiet._base.constraints import between, one_of, whole
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.linalg import balance
from ultraquiet.reduce._abstract import METHODS, ReductionResult, Weights, counted, joined, project, renamed, split
from ultraquiet.reduce.certificate import certified, fits, judging_plant, kept_promise
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace


@register("reduce", "balanced")
@dataclass(frozen=True)
class Balanced:
    """Keep the states that pass most energy from input to output; an unstable part is kept whole.

    ||G - Gr|| <= 2 (s_r+1 + ... + s_n), s the Hankel values of the stable part.

    Args:
        states: states to keep, the unstable ones included; the fewest that leave out a hundredth when absent.
        method: `truncation` (exact at infinite frequency when continuous) or `perturbation` (exact at 0 Hz).
        slowest_hz: what decays slower than exp(-2 pi slowest_hz t) is kept as it is, like the unstable part.

    >>> G = StateSpace([[0.9, 0.0], [0.0, 0.1]], [[1.0], [0.01]], [[1.0, 0.01]], [[0.0]], rate_hz=1.0)
    >>> result = Balanced(states=1).reduce(G)
    >>> result.controller.states, result.details["bound"] < 1e-3
    (1, True)

    Moore 1981, doi:10.1109/TAC.1981.1102568; the bound: Glover 1984, doi:10.1080/00207178408933239.
    """

    states: int | None = None
    method: str = "truncation"
    slowest_hz: float = 0.0

    def __post_init__(self) -> None:
        if self.states is not None:
            whole("Balanced", "states", self.states, 0)
        one_of("Balanced", "method", self.method, METHODS)
        between("Balanced", "slowest_hz", self.slowest_hz, 0.0, np.finfo(float).max, "Hz")

    @takes_systems
    @single_threaded
    def reduce(
        self, controller: StateSpace, plant: StateSpace | None = None, weights: Weights = None
    ) -> ReductionResult:
        """Return the reduced system; the loop does not steer it, which is this method's weakness.

        With a plant the loop is looked at afterwards, and a lost one is called `unstable`. `details["bound"]` is the
        a-priori bound on the H-infinity norm of the error.
        """
        if plant is not None:
            fits("Balanced", controller, plant)
        discrete = controller.rate_hz is not None
        stable, kept, _ = split(controller, self.slowest_hz)
        P, Q = balance.gramians(*stable[:3], discrete)
        keep = counted(self.states, kept[0].shape[0], stable[0].shape[0], lambda: balance.balancing(P, Q, 0)[2])
        reduced, hankel = project(stable, P, Q, keep, discrete, self.method)
        bound = 2 * float(np.sum(hankel[keep:]))
        provenance = Provenance("Balanced", asdict(self), parents=(controller.hash,), versions=versions())
        small = renamed(joined(reduced, kept), controller, provenance)
        P_loop = None if plant is None else judging_plant(plant, weights)
        result = certified(controller, small, hankel, P=P_loop, details={"bound": bound})
        return kept_promise(result, controller, plant)
