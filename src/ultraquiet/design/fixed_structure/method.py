"""Controllers of a structure given beforehand: few states, one law for all struts, or a law for each."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.fixed_structure.controller_structure import decentralised, one_element, repeated
from ultraquiet.design.fixed_structure.elements import Element, StablePairs, from_system
from ultraquiet.design.fixed_structure.minimax import balanced, lowest
from ultraquiet.design.fixed_structure.plane import Plane, plane_of
from ultraquiet.design.fixed_structure.specification import Specification, specified
from ultraquiet.design.fixed_structure.tuning import ROUNDS, STEPS, InitialLaw, calmed, posed, tuned
from ultraquiet.design.hinf.band_attenuation import common_mode
from ultraquiet.design.result import DesignResult
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.structure_words import DECENTRALISED, FULL, REPEATED, structure_word
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

STRUCTURES = (REPEATED, DECENTRALISED, FULL)


@register("design", "fixed-structure")
@dataclass(frozen=True)
class FixedStructure(StatedRobustness):
    """The best law of a few states, the same on every channel or one for each, for a specification.

    min over theta of max over f of sigma(S) / s(f), subject to sigma(S) <= peak, sigma(K S) <= limit, ...

    Args:
        states: of the law of one channel (of the whole law when `full`).
        structure: `repeated` one scalar law used on every channel, `decentralised` a law for each, `full` one law for
            all; `alike` and `apart` are older words for the first two.
        specification: what is asked, also as a table of its settings. Absent, the attenuation in the default's band is
            a wish and no demand.
        starts: how hard to search: laws of up to twice as many states more are cut down step by step and tuned on each,
            and as many points around the best are tried on the whole plant.
        seed: of the random starts.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = FixedStructure(states=2).design(plant)
    >>> result.status.ok, result.controller.states, result.peak_sensitivity_db <= 8
    (True, 2, True)

    Apkarian and Noll 2006, doi:10.1109/TAC.2005.860290; Burke, Henrion, Lewis and Overton 2006 (HIFOO),
    doi:10.3182/20060705-3-FR-2907.00059.
    """

    states: int = 8
    structure: str = REPEATED
    specification: Specification | Mapping[str, Any] | None = None
    starts: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        who = "FixedStructure"
        object.__setattr__(self, "structure", structure_word(who, self.structure, STRUCTURES))
        whole(who, "states", self.states, 0)
        whole(who, "starts", self.starts, 1)
        object.__setattr__(self, "specification", specified(self.specification))

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y; its status is `short` when the specification is not met by the best law found.

        `details["score"]` says how each requirement stands, `details["full_order"]` how the H-infinity law does that
        the search began with, `gamma` and `achieved` are the greatest requirement over its bound.

        Raises:
            InputError: a plant that is not square, frequencies above Nyquist.
        """
        wanted = self.specification if isinstance(self.specification, Specification) else Specification()
        wanted.fits("FixedStructure", plant)
        begun = self._begin(plant, wanted)
        return tuned(plant, begun, wanted, self, self.starts, self.seed, demanded=self.specification is not None)

    def _begin(self, plant: StateSpace, wanted: Specification) -> InitialLaw:
        """Return the structure and the reduced H-infinity design in it."""
        part = plant if self.structure == FULL else common_mode(plant)
        try:
            full = wanted.weighted().synthesis(part).controller
        except UltraquietError:
            full = None
        n = plant.D.shape[0]
        if self.structure == FULL:
            element, theta = _reduced(full, self.states, plane_of(plant), part.D.shape)
            return InitialLaw(one_element(element), theta, full)
        # the search is a hundred times quicker on the function that all channels share
        first = _first_on_part(part, full, self.states, wanted, self.starts)
        element = first.structure.elements[0]
        if self.structure == REPEATED:
            return InitialLaw(repeated(element, n), first.theta, full)
        return InitialLaw(decentralised((element,) * n, n), np.tile(first.theta, n), full)


def _first_on_part(
    part: StateSpace, law: StateSpace | None, states: int, wanted: Specification, starts: int
) -> InitialLaw:
    """Return the best scalar law for the function that all channels share.

    Ladders begin with a few states more and lose two at a time, tuned again on every rung: a law cut down at once lands
    in poorer valleys.
    """
    plane, best, level = plane_of(part), None, np.inf
    for more in range(0, 2 * starts + 1, 2):
        element, theta = _reduced(law, states + more, plane, part.D.shape)
        for left in range(states + more, states - 1, -2):
            problem = posed(part, one_element(element), wanted)
            lowest_point = lowest(problem, [calmed(problem, theta)], STEPS, 2)
            if lowest_point is None:
                break
            theta, reached = balanced(problem, lowest_point[0], STEPS, ROUNDS)
            if left == states:
                if reached < level:
                    best, level = InitialLaw(one_element(element), theta), reached
            else:
                element, theta = _reduced(plane.from_plane(element.system(theta)), left - 2, plane, part.D.shape)
    if best is None:
        element, theta = _reduced(law, states, plane, part.D.shape)
        best = InitialLaw(one_element(element), theta)
    return best


def _reduced(law: StateSpace | None, states: int, plane: Plane, shape: tuple[int, int]) -> tuple[Element, FloatArray]:
    """Return a law balanced and truncated to some states as an element; a random one when that cannot be."""
    if law is not None and states and law.is_stable():
        M: Matrices = plane.to_plane(law)
        P, Q = balance.gramians(*M[:3], discrete=False)
        left, right, _ = balance.balancing(P, Q, states)
        element_and_theta = from_system(balance.truncate(M, left, right)) if left.shape[0] == states else None
        if element_and_theta is not None:
            return element_and_theta
    element = StablePairs(states, shape[1], shape[0], np.ones(states))
    low, high = (
        float(w) for w in plane.of_hz(np.array([5.0, 500.0 if plane.rate_hz is None else 0.2 * plane.rate_hz]))
    )
    return element, element.start(np.random.default_rng(0), low, high)
