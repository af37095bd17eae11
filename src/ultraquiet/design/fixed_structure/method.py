"""Controllers of a structure given beforehand: few states, one law for all channels, or a law for each."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.fixed_structure.minimax import balanced, lowest
from ultraquiet.design.fixed_structure.specification import Specification, band_of, specified
from ultraquiet.design.fixed_structure.tuning import ROUNDS, STEPS, InitialLaw, calmed, even_gain, posed, tuned
from ultraquiet.design.hinf.band_attenuation import BandAttenuation, common_mode
from ultraquiet.design.hinf.synthesis import synthesize_hinf
from ultraquiet.design.law_structure.controller_structure import decentralised, one_element, repeated
from ultraquiet.design.law_structure.elements import Element, StablePairs, from_system
from ultraquiet.design.law_structure.plane import Plane, plane_of
from ultraquiet.design.peak_bounded.method import PeakBounded
from ultraquiet.design.result import DesignResult
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.structure_words import DECENTRALISED, FULL, REPEATED, structure_word
from ultraquiet.design.verification import signed
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

STRUCTURES = (REPEATED, DECENTRALISED, FULL)
ASKED_STATES, UNASKED_STATES = 8, 12  # with a specification, and without one
MET = 1.01  # the specification's wish over its bound, for a search to rest
IDLE = 0.9  # of what no law at all would leave: such a law is worth no more than none
FURTHER, DRAWN = 2, 6  # ladders and random laws that are tried besides where nothing better was found
BEYOND, HIGHEST = 2.0, 0.2  # of a random start's poles: outside the band by this factor, below this share of the rate


@register("design", "fixed-structure")
@dataclass(frozen=True)
class FixedStructure(StatedRobustness):
    """The best law of a few states, the same on every channel or one for each, for a specification.

    min over theta of max over f of sigma(S) / s(f), subject to sigma(S) <= peak, sigma(K S) <= limit, ...

    Without a specification there is no band to be quiet: the largest singular value of S G, the plant's own response,
    is lowered, by the search of `PeakBounded` and with the peak of a specification's default.

    Args:
        states: of the law of one channel (of the whole law when `full`); 8 when absent, and 12 without a specification,
            where an odd number is taken one lower, for that search moves pairs.
        structure: `repeated` one scalar law used on every channel, `decentralised` a law for each, `full` one law for
            all; `alike` and `apart` are older words for the first two. Absent, `repeated`, and without a specification
            the one that suits the plant: `full` where channels do not move alike, or are not as many at both ends.
        specification: what is asked, also as a table of its settings.
        starts: how hard to search: laws of up to twice as many states more are cut down step by step and tuned on each,
            and as many points around the best are tried on the whole plant.
        seed: of the random starts.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = FixedStructure(states=0).design(plant)
    >>> result.status.ok, result.controller.states, result.peak_sensitivity_db <= 8
    (True, 0, True)

    Apkarian and Noll 2006, doi:10.1109/TAC.2005.860290; Burke, Henrion, Lewis and Overton 2006 (HIFOO),
    doi:10.3182/20060705-3-FR-2907.00059.
    """

    states: int | None = None
    structure: str | None = None
    specification: Specification | Mapping[str, Any] | None = None
    starts: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        who = "FixedStructure"
        if self.structure is not None:
            object.__setattr__(self, "structure", structure_word(who, self.structure, STRUCTURES))
        if self.states is not None:
            whole(who, "states", self.states, 0)
        whole(who, "starts", self.starts, 1)
        whole(who, "seed", self.seed, 0)
        object.__setattr__(self, "specification", specified(self.specification))

    @property
    def square_plants(self) -> bool:
        """Whether `design` takes square plants alone, as for a specification or a law of scalar ones."""
        return isinstance(self.specification, Specification) or self.structure in (REPEATED, DECENTRALISED)

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y; its status is `short` when the specification is not met by the best law found.

        `details["score"]` says how each requirement stands, `details["full_order"]` how the H-infinity law does that
        the search began with, `gamma` and `achieved` are the greatest requirement over its bound. Without a
        specification `details["attenuation_rms_db"]` says by how much the RMS of S G fell.

        Raises:
            InputError: a plant that is not square for a law that needs one, frequencies above Nyquist.
        """
        wanted = self.specification
        if not isinstance(wanted, Specification):
            return self._unasked(plant)
        wanted.fits("FixedStructure", plant)
        wanted = wanted.on(plant)
        heard = wanted.gains(plant)
        unit = float(np.exp2(np.round(np.log2(heard.max())))) if heard.size else 1.0
        begun = replace(self._begin(*even_gain(plant, wanted, unit)), unit=unit)
        return tuned(plant, begun, wanted, self, self.starts, self.seed, demanded=True)

    def _unasked(self, plant: StateSpace) -> DesignResult:
        """Return the law that lowers the plant's own response."""
        search = PeakBounded(
            states=UNASKED_STATES if self.states is None else self.states - self.states % 2,
            structure=self.structure,
            peak_db=Specification.peak_db,
            draws=0,
            seed=self.seed,
            disk_margin=self.disk_margin,
        )
        return signed(search.design(plant), plant, self)

    def _begin(self, plant: StateSpace, wanted: Specification) -> InitialLaw:
        """Return the structure and the reduced H-infinity design in it."""
        part = plant if self.structure == FULL else common_mode(plant)
        states = ASKED_STATES if self.states is None else self.states
        full = _of_full_order(wanted.weighted(part), part)
        n = plant.D.shape[0]
        if self.structure == FULL:
            element, theta = _reduced(full, states, plane_of(plant), part.D.shape, wanted)
            return InitialLaw(one_element(element), theta, full)
        # the search is a hundred times quicker on the function that all channels share
        first = _first_on_part(part, full, states, wanted, self.starts, self.seed)
        element = first.structure.elements[0]
        if self.structure == DECENTRALISED:
            return InitialLaw(decentralised((element,) * n, n), np.tile(first.theta, n), full)
        return InitialLaw(repeated(element, n), first.theta, full)


def _of_full_order(weighted: BandAttenuation, part: StateSpace) -> StateSpace | None:
    """Return the H-infinity law of the same wish; of a plant with poles on the axis, that of a problem made regular."""
    try:
        law = weighted.synthesis(part).controller
        return law or synthesize_hinf(weighted.generalised(part), *part.D.shape, regularise=True).controller
    except UltraquietError:
        return None


def _first_on_part(
    part: StateSpace, law: StateSpace | None, states: int, wanted: Specification, starts: int, seed: int
) -> InitialLaw:
    """Return the best scalar law for the function that all channels share.

    Ladders begin with a few states more and lose two at a time, tuned again on every rung: a law cut down at once lands
    in poorer valleys. Where what is asked is not met the search goes on from higher up, and where they end with no
    more than no law at all would do, also from laws drawn at random.
    """
    best, level, met = None, np.inf, 10 ** (-wanted.attenuation_db / 20)
    for more in range(0, 2 * starts + 1 + 2 * FURTHER, 2):
        if more > 2 * starts and level <= met * MET:
            break
        found, reached = _ladder(part, law, states, more, wanted)
        if reached < level:
            best, level = found, reached
    rng = np.random.default_rng(seed)
    for _ in range(DRAWN):
        if level < IDLE:
            break
        element, theta = _drawn(states, plane_of(part), part.D.shape, wanted, rng)
        found, reached = _tuned_from(part, element, theta, wanted)
        if reached < level:
            best, level = found, reached
    if best is None:
        element, theta = _reduced(law, states, plane_of(part), part.D.shape, wanted)
        best = InitialLaw(one_element(element), theta)
    return best


def _ladder(
    part: StateSpace, law: StateSpace | None, states: int, more: int, wanted: Specification
) -> tuple[InitialLaw | None, float]:
    """Return the law at the foot of one ladder, and its standing: of the specification's wishes where it is met."""
    plane = plane_of(part)
    element, theta = _reduced(law, states + more, plane, part.D.shape, wanted)
    for left in range(states + more, states - 1, -2):
        found, reached = _tuned_from(part, element, theta, wanted)
        if found is None or left == states:
            return found, reached
        cut = plane.from_plane(element.system(found.theta))
        element, theta = _reduced(cut, left - 2, plane, part.D.shape, wanted)
    return None, np.inf


def _tuned_from(
    part: StateSpace, element: Element, theta: FloatArray, wanted: Specification
) -> tuple[InitialLaw | None, float]:
    problem = posed(part, one_element(element), wanted)
    lowest_point = lowest(problem, [calmed(problem, theta)], STEPS, 2)
    if lowest_point is None:
        return None, np.inf
    theta, reached = balanced(problem, lowest_point[0], STEPS, ROUNDS)
    # as ratio to what no law at all leaves of the wish
    return InitialLaw(one_element(element), theta), reached / 10 ** (wanted.attenuation_db / 20)


def _reduced(
    law: StateSpace | None, states: int, plane: Plane, shape: tuple[int, int], wanted: Specification
) -> tuple[Element, FloatArray]:
    """Return a law balanced and truncated to some states as an element; a random one when that cannot be."""
    if law is not None and states and law.is_stable():
        M: Matrices = plane.to_plane(law)
        P, Q = balance.gramians(*M[:3], discrete=False)
        left, right, _ = balance.balancing(P, Q, states)
        element_and_theta = from_system(balance.truncate(M, left, right)) if left.shape[0] == states else None
        if element_and_theta is not None:
            return element_and_theta
    return _drawn(states, plane, shape, wanted, np.random.default_rng(0))


def _drawn(
    states: int, plane: Plane, shape: tuple[int, int], wanted: Specification, rng: np.random.Generator
) -> tuple[Element, FloatArray]:
    element = StablePairs(states, shape[1], shape[0], np.ones(states))
    low, high = band_of(wanted)
    top = BEYOND * high if plane.rate_hz is None else min(BEYOND * high, HIGHEST * plane.rate_hz)
    low, high = (float(w) for w in plane.of_hz(np.array([min(low, top) / BEYOND, top])))
    return element, element.start(rng, low, high)
