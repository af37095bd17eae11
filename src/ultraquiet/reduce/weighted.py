"""Balanced reduction with frequency weights before and behind the system."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from ultraquiet._base.constraints import between, one_of, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.reduce._abstract import METHODS, ReductionResult, Weights, counted, joined, project, renamed, split
from ultraquiet.reduce.certificate import certified, fits, judging_plant, kept_promise
from ultraquiet.reduce.weighting import input_gramian, output_gramian, static
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import feedback, sensitivity, series
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

LOOPS = ("performance", "stability")


@register("reduce", "frequency-weighted")
@dataclass(frozen=True)
class FrequencyWeighted:
    """Keep the states that matter between two frequency weights: min || V (K - Kr) W ||, nearly.

    The weights are `weights["output"]` V and `weights["input"]` W, either may be absent. With a plant and no such
    weights they are those of the loop: V = (I - G K)^-1 G and W = (I - G K)^-1 (`performance`), or W = (I - G K)^-1 G
    alone (`stability`). An unstable part is kept whole.

    Args:
        states: states to keep, the unstable ones included; the fewest that leave out a hundredth when absent.
        method: `truncation`, or `perturbation` (exact at 0 Hz).
        loop: what the loop's weights stand for, `performance` or `stability`.
        combination: of the Gramian's blocks, 0 is Enns, 1 is Lin and Chiu; between them Varga and Anderson.
        guard: make the reduced system stable for weights on both sides (Varga and Anderson), at some accuracy.
        slowest_hz: what decays slower than exp(-2 pi slowest_hz t) is kept as it is, like the unstable part.

    >>> G = StateSpace([[-1.0, 0.0], [0.0, -9.0]], [[1.0], [1.0]], [[1.0, 0.1]], [[0.0]])
    >>> fast = StateSpace([[-100.0]], [[100.0]], [[-1.0]], [[1.0]])
    >>> result = FrequencyWeighted(states=1).reduce(G, weights={"output": fast})
    >>> result.controller.states, result.details["weighted_error"] < 0.01
    (1, True)

    Enns 1984; Lin and Chiu 1992; Varga and Anderson 2003, doi:10.1016/S0005-1098(03)00030-X.
    """

    states: int | None = None
    method: str = "truncation"
    loop: str = "performance"
    combination: float = 0.0
    guard: bool = False
    slowest_hz: float = 0.0

    def __post_init__(self) -> None:
        who = "FrequencyWeighted"
        if self.states is not None:
            whole(who, "states", self.states, 0)
        one_of(who, "method", self.method, METHODS)
        one_of(who, "loop", self.loop, LOOPS)
        between(who, "combination", self.combination, 0.0, 1.0)
        between(who, "slowest_hz", self.slowest_hz, 0.0, np.finfo(float).max, "Hz")

    @takes_systems
    @single_threaded
    def reduce(
        self, controller: StateSpace, plant: StateSpace | None = None, weights: Weights = None
    ) -> ReductionResult:
        """Return the reduced system; `details["weighted_error"]` is the H-infinity norm of V (K - Kr) W.

        Without a plant to judge it by, a reduction that makes a stable part unstable is called `unstable`.

        Args:
            controller: K.
            plant: G, when the loop gives the weights or is to be looked at afterwards.
            weights: a mapping with `input` and `output`, systems of K's rate; what else is in it judges the loop.

        Raises:
            InputError: weights that do not fit, are unstable, or come from an unstable loop.
        """
        if plant is not None:
            fits("FrequencyWeighted", controller, plant)
        V, W = self._weights(controller, plant, weights)
        discrete = controller.rate_hz is not None
        stable, kept, _ = split(controller, self.slowest_hz)
        P = input_gramian(stable, _matrices(W), discrete, self.combination, guard=self.guard)
        Q = output_gramian(stable, _matrices(V), discrete, self.combination, guard=self.guard)
        keep = counted(self.states, kept[0].shape[0], stable[0].shape[0], lambda: balance.balancing(P, Q, 0)[2])
        reduced, hankel = project(stable, P, Q, keep, discrete, self.method)
        provenance = Provenance("FrequencyWeighted", asdict(self), parents=(controller.hash,), versions=versions())
        small = renamed(joined(reduced, kept), controller, provenance)
        P_loop = None if plant is None else judging_plant(plant, weights)
        error = _error(stable, reduced, V, W, controller.rate_hz)
        result = certified(controller, small, hankel, P=P_loop, details={"weighted_error": error})
        if plant is None and not np.isfinite(error):
            return replace(result, status=self._unstable(result.status))
        return kept_promise(result, controller, plant)

    def _unstable(self, status: Status) -> Status:
        """Say that the reduction made a stable part unstable, which is infinitely far from it."""
        way = "keep more states" if self.guard else "take guard=True or keep more states"
        return Status(
            StatusWord.UNSTABLE,
            f"{status.sentence.removesuffix('.')}; what was stable is not so with so few between these weights, {way}.",
        )

    def _weights(self, K: StateSpace, plant: StateSpace | None, weights: Weights) -> tuple[StateSpace, StateSpace]:
        """Return V and W, identities where there is none."""
        by_side = weights if isinstance(weights, Mapping) else {}
        nu, ny = K.D.shape
        V, W = (StateSpace(*static(np.eye(size)), rate_hz=K.rate_hz) for size in (nu, ny))
        if "input" in by_side or "output" in by_side:
            V, W = by_side.get("output", V), by_side.get("input", W)
        elif plant is not None:
            W = sensitivity(plant, K) if self.loop == "performance" else feedback(plant, K)
            V = feedback(plant, K) if self.loop == "performance" else V
            if not W.is_stable():
                raise InputError(
                    "FrequencyWeighted: the loop with the full controller is unstable; it gives no weights."
                )
        for name, weight, size in (("output", V, V.D.shape[1] == nu), ("input", W, W.D.shape[0] == ny)):
            same_rate("FrequencyWeighted", "the controller", K.rate_hz, f"the weight '{name}'", weight.rate_hz)
            if not size:
                raise InputError(
                    f"FrequencyWeighted: the weight '{name}' is {weight.D.shape}, the controller {nu} x {ny};"
                    " the two must join."
                )
            if not weight.is_stable():
                raise InputError(f"FrequencyWeighted: the weight '{name}' is unstable; take a stable one.")
        return V, W


def _matrices(system: StateSpace) -> Matrices:
    return system.A, system.B, system.C, system.D


def _error(full: Matrices, small: Matrices, V: StateSpace, W: StateSpace, rate_hz: float | None) -> float:
    A, B, C, D = joined(full, (small[0], small[1], -small[2]))
    difference = StateSpace(A, B, C, D - small[3], rate_hz)
    return hinf_norm(series(series(W, difference), V))[0]
