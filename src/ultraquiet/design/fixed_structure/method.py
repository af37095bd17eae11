"""Controllers of a structure given beforehand: few states, one law for all struts, or a law for each."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.fixed_structure.controller_structure import (
    ControllerStructure,
    decentralised,
    one_element,
    repeated,
)
from ultraquiet.design.fixed_structure.elements import Element, StablePairs, from_system
from ultraquiet.design.fixed_structure.minimax import balanced, lowest
from ultraquiet.design.fixed_structure.problem import Plane, TuningProblem, plane_of
from ultraquiet.design.fixed_structure.specification import Specification, specified
from ultraquiet.design.hinf.band_attenuation import common_mode
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.structure_words import DECENTRALISED, FULL, REPEATED, structure_word
from ultraquiet.design.verification import judged
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

STRUCTURES = (REPEATED, DECENTRALISED, FULL)
STEPS = 60
ROUNDS = 5
LEAST_DB = 0.02  # by which a peak that was missed is asked to be lower
WISHES = ("attenuation_db", "tone_")  # requirements that a law turned down only misses by more
QUIETER = 0.7  # a start that is unstable with the plant is turned down by this factor, again and again
TURNS = 40
SPREAD = 0.3  # of the random starts around the first, relative


@register("design", "fixed-structure")
@dataclass(frozen=True)
class FixedStructure:
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
        who = "FixedStructure"
        object.__setattr__(self, "structure", structure_word(who, self.structure, STRUCTURES))
        whole(who, "states", self.states, 0)
        whole(who, "starts", self.starts, 1)
        object.__setattr__(self, "specification", specified(self.specification))

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

    def _begin(self, plant: StateSpace, wanted: Specification) -> "InitialLaw":
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


@dataclass(frozen=True, eq=False)
class InitialLaw:
    """A structure, parameters to begin with, and the law of full order they came from."""

    structure: ControllerStructure
    theta: FloatArray
    full_order: StateSpace | None = None


def tuned(
    plant: StateSpace, start: InitialLaw, wanted: Specification, settings: Any, starts: int, seed: int, demanded: bool
) -> DesignResult:
    """Tune a structure to a specification and judge what comes out on the plant itself."""
    who = type(settings).__name__
    problem = posed(plant, start.structure, wanted)
    points = _points(problem, start.theta, starts, np.random.default_rng(seed))
    lowest_point = lowest(problem, points, STEPS, 2)
    if lowest_point is None:
        return refused(f"{who}: no start gave a stable loop; try another structure, more states or more starts.")
    theta = _within(problem, balanced(problem, lowest_point[0], STEPS, ROUNDS)[0], plant, wanted)
    levels = problem.measured(theta)
    controller = problem.plane.from_plane(start.structure.system(theta))
    score = wanted.score(plant, controller)
    details = {
        "score": score,
        "levels": dict(zip([r.name for r in problem.requirements], levels.tolist(), strict=True)),
        "theta": theta,
        "parameters": theta.size,
        "specification": wanted,
        "full_order": start.full_order,
        "points": problem.samples.w.size,
    }
    result = judged(plant, controller, settings, float(levels.max()), _achieved(wanted, score), {}, details)
    return worded(result, score, demanded)


def _within(problem: TuningProblem, theta: FloatArray, plant: StateSpace, wanted: Specification) -> FloatArray:
    """Return a law that meets what is hard, by the exact norms of the finished loop, where one is found.

    A search stops a per mille beside a bound, and a grid may miss the top of a peak: it is asked again for a little
    more than is wanted, and at last the law is turned down.
    """
    trial, asked = theta, wanted
    for _ in range(ROUNDS):
        missing = _hard(problem, trial, plant, wanted)
        if not missing:
            return trial
        asked = _tightened(asked, missing)
        trial = balanced(posed(plant, problem.structure, asked), trial, STEPS, ROUNDS)[0]
    for _ in range(TURNS):
        if not _hard(problem, trial, plant, wanted):
            return trial
        trial = _turned(problem, trial, QUIETER)
    return theta


def _hard(problem: TuningProblem, theta: FloatArray, plant: StateSpace, wanted: Specification) -> dict[str, float]:
    """Return what a law misses of the requirements that are more than wishes."""
    score = wanted.score(plant, problem.plane.from_plane(problem.structure.system(theta)))
    return {k: v for k, v in score.shortfall.items() if v > 0 and not k.startswith(WISHES)}


def _tightened(wanted: Specification, missing: Mapping[str, float]) -> Specification:
    """Return a specification that asks for twice what is missing more."""
    more: dict[str, float] = {}
    if np.isfinite(missing.get("peak_db", np.nan)):
        more["peak_db"] = wanted.peak_db - max(2 * missing["peak_db"], LEAST_DB)
    if np.isfinite(missing.get("control_gain", np.nan)):
        more["control_limit"] = wanted.control_limit / (1 + 2 * missing["control_gain"])
    return replace(wanted, **more) if more.get("peak_db", 1.0) > 0 else wanted


def posed(plant: StateSpace, structure: ControllerStructure, wanted: Specification) -> TuningProblem:
    """Return the problem of a specification on a plant."""
    P, requirements = wanted.requirements(plant)
    return TuningProblem(P, plant, structure, requirements, more_hz=wanted.grid_hz())


def worded(result: DesignResult, score: Any, demanded: bool) -> DesignResult:
    """Say in the status whether a specification is met; what is only wished cannot fail."""
    missing = {k for k, v in score.shortfall.items() if v > 0}
    if not result.status.ok or not (missing if demanded else missing - {"attenuation_db"}):
        return result
    return replace(result, status=Status(StatusWord.SHORT, f"{score.sentence} This is the best found."))


def _achieved(wanted: Specification, score: Any) -> float:
    """Return the greatest requirement over its bound, from the norms measured on the finished loop."""
    got = score.measured
    ratios = [
        10 ** ((wanted.attenuation_db - got["attenuation_db"]) / 20),
        10 ** ((got["peak_db"] - wanted.peak_db) / 20),
        got["control_gain"] / wanted.control_limit,
    ]
    if wanted.disk_margin is not None:
        ratios.append(wanted.disk_margin / got["disk_margin"])
    if wanted.roll_off_hz is not None:
        ratios.append(10 ** ((wanted.roll_off_db - got["roll_off_db"]) / 20))
    return max(ratios + [10 ** ((wanted.tone_db - got[f"tone_{f:g}_hz_db"]) / 20) for f in wanted.tones_hz])


def _points(problem: TuningProblem, theta: FloatArray, starts: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return the start, turned down until the loop is stable, and others around it."""
    out = [_calmed(problem, theta)]
    for _ in range(starts - 1):
        out.append(_calmed(problem, theta * (1 + SPREAD * rng.standard_normal(theta.size))))
    return out


def _calmed(problem: TuningProblem, theta: FloatArray) -> FloatArray:
    trial = theta.copy()
    for _ in range(TURNS):
        if problem.stability(trial) < 0:
            return trial
        trial = _turned(problem, trial, QUIETER)
    return theta


def _turned(problem: TuningProblem, theta: FloatArray, factor: float) -> FloatArray:
    """Return the parameters of factor times the whole law."""
    structure = problem.structure
    return np.concatenate(
        [e.turned_down(t, factor) for e, t in zip(structure.elements, structure.parts(theta), strict=True)]
    )


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
            lowest_point = lowest(problem, [_calmed(problem, theta)], STEPS, 2)
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
