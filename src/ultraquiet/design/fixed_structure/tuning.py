"""A controller of fixed structure tuned to a specification: from a first law to one that is judged on the plant."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.design.fixed_structure.minimax import balanced, lowest
from ultraquiet.design.fixed_structure.problem import TuningProblem
from ultraquiet.design.fixed_structure.specification import Score, Specification, band_of
from ultraquiet.design.law_structure.controller_structure import ControllerStructure
from ultraquiet.design.peak_bounded.outcome import rms_reduction_db
from ultraquiet.design.result import LITTLE_DB, STABLE_WORDS, DesignResult, refused
from ultraquiet.design.verification import judged
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

STEPS = 60
ROUNDS = 5
LEAST_DB = 0.02  # by which a peak that was missed is asked to be lower
WISHES = ("attenuation_db", "tone_")  # requirements that a law turned down only misses by more
QUIETER = 0.7  # a start that is unstable with the plant is turned down by this factor, again and again
TURNS = 40
SPREAD = 0.3  # of the random starts around the first, relative


@dataclass(frozen=True, eq=False)
class InitialLaw:
    """A structure, parameters to begin with, the law of full order they came from, and the plant's unit of gain.

    The parameters are those of `unit` times the law, for the plant over `unit`: a search knows no units.
    """

    structure: ControllerStructure
    theta: FloatArray
    full_order: StateSpace | None = None
    unit: float = 1.0


def tuned(
    plant: StateSpace, start: InitialLaw, wanted: Specification, settings: Any, starts: int, seed: int, demanded: bool
) -> DesignResult:
    """Tune a structure to a specification and judge what comes out on the plant itself."""
    who, given, asked = type(settings).__name__, plant, wanted
    plant, wanted = even_gain(plant, wanted, start.unit)
    problem = posed(plant, start.structure, wanted)
    points = _points(problem, start.theta, starts, np.random.default_rng(seed))
    lowest_point = lowest(problem, points, STEPS, 2)
    if lowest_point is None:
        return refused(f"{who}: no start gave a stable loop; try another structure, more states or more starts.")
    theta = _within(problem, balanced(problem, lowest_point[0], STEPS, ROUNDS)[0], plant, wanted)
    levels = problem.measured(theta)
    controller = of_gain(start.structure.law(theta, problem.plane), 1 / start.unit)
    score = asked.score(given, controller)
    details = {
        "score": score,
        "levels": dict(zip([r.name for r in problem.requirements], levels.tolist(), strict=True)),
        "theta": theta,
        "parameters": theta.size,
        "specification": asked,
        "full_order": start.full_order and of_gain(start.full_order, 1 / start.unit),
        "points": problem.samples.w.size,
    }
    result = judged(given, controller, settings, float(levels.max()), _achieved(asked, score), {}, details)
    # what is only wished cannot fail, but a law that makes nothing quieter is none
    return worded(result, score, demanded or _idle(given, controller, asked, score))


def _idle(plant: StateSpace, law: StateSpace, asked: Specification, score: Score) -> bool:
    """Return whether a law makes nothing quieter, neither S in its worst direction nor S G in the mean."""
    if score.measured["attenuation_db"] >= LITTLE_DB:
        return False
    return not score.stable or rms_reduction_db(plant, law, band_of(asked)) < LITTLE_DB


def of_gain(G: StateSpace, factor: float) -> StateSpace:
    """Return factor times a system."""
    return StateSpace(G.A, G.B, factor * G.C, factor * G.D, G.rate_hz) if factor != 1.0 else G


def even_gain(plant: StateSpace, wanted: Specification, unit: float) -> tuple[StateSpace, Specification]:
    """Return the plant over a unit, a power of two, and what is asked of it then."""
    return of_gain(plant, 1 / unit), replace(wanted, control_limit=_limit(wanted) * unit)


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
    score = wanted.score(plant, problem.structure.law(theta, problem.plane))
    return {k: v for k, v in score.shortfall.items() if v > 0 and not k.startswith(WISHES)}


def _tightened(wanted: Specification, missing: Mapping[str, float]) -> Specification:
    """Return a specification that asks for twice what is missing more."""
    more: dict[str, float] = {}
    if np.isfinite(missing.get("peak_db", np.nan)):
        more["peak_db"] = wanted.peak_db - max(2 * missing["peak_db"], LEAST_DB)
    if np.isfinite(missing.get("control_gain", np.nan)):
        more["control_limit"] = _limit(wanted) / (1 + 2 * missing["control_gain"])
    return replace(wanted, **more) if more.get("peak_db", 1.0) > 0 else wanted


def _limit(wanted: Specification) -> float:
    assert wanted.control_limit is not None
    return wanted.control_limit


def posed(plant: StateSpace, structure: ControllerStructure, wanted: Specification) -> TuningProblem:
    """Return the problem of a specification on a plant."""
    P, requirements = wanted.requirements(plant)
    return TuningProblem(P, plant, structure, requirements, more_hz=wanted.grid_hz())


def worded(result: DesignResult, score: Any, demanded: bool) -> DesignResult:
    """Say in the status whether a specification is met; what is only wished cannot fail."""
    missing = {k for k, v in score.shortfall.items() if v > 0}
    short = missing if demanded else missing - {"attenuation_db"}
    if result.status.word not in STABLE_WORDS or not short:
        return result
    if not result.status.ok:
        return replace(result, status=Status(result.status.word, f"{result.status.sentence} {score.sentence}"))
    return replace(result, status=Status(StatusWord.SHORT, f"{score.sentence} This is the best found."))


def _achieved(wanted: Specification, score: Any) -> float:
    """Return the greatest requirement over its bound, from the norms measured on the finished loop."""
    got = score.measured
    ratios = [
        10 ** ((wanted.attenuation_db - got["attenuation_db"]) / 20),
        10 ** ((got["peak_db"] - wanted.peak_db) / 20),
        got["control_gain"] / _limit(wanted),
    ]
    if wanted.disk_margin:
        ratios.append(wanted.disk_margin / got["disk_margin"])
    if wanted.roll_off_hz is not None:
        ratios.append(10 ** ((wanted.roll_off_db - got["roll_off_db"]) / 20))
    return max(ratios + [10 ** ((wanted.tone_db - got[f"tone_{f:g}_hz_db"]) / 20) for f in wanted.tones_hz])


def _points(problem: TuningProblem, theta: FloatArray, starts: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return the start, turned down until the loop is stable, and others around it."""
    out = [calmed(problem, theta)]
    for _ in range(starts - 1):
        out.append(calmed(problem, theta * (1 + SPREAD * rng.standard_normal(theta.size))))
    return out


def calmed(problem: TuningProblem, theta: FloatArray) -> FloatArray:
    """Return the parameters turned down until the loop is stable; as they are where that does not help."""
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
