"""What several sections show of laws: which one was chosen, its colour, its loop as measured and as designed."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray, frozen
from ultraquiet._base.provenance import ByContents, content_hash
from ultraquiet.analyse.loop_response import loop_response
from ultraquiet.analyse.peaks import beside_poles, refined
from ultraquiet.chart import Chart, law_colours
from ultraquiet.design.weights.loop_weights import LoopFunction
from ultraquiet.linalg.norms import largest_gains
from ultraquiet.pipeline.facts.loops import StableLoop
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.plot.pages.loops import (
    LoopCurve,
    RequiredOfLoop,
    loci,
    margin_bars,
    measured_loops,
    shaped_loops,
    worst_direction_db,
)
from ultraquiet.plot.pages.weights import WeightedFunction, weighted_loops
from ultraquiet.values.channel import ratio
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace

_Responses = tuple[FloatArray, ComplexArray, Mapping[str, ComplexArray]]
FUNCTIONS: tuple[LoopFunction, ...] = ("S", "T", "KS")
SHARP = 0.05  # damping below which a pole of a loop has lines of its own,
WIDTHS = np.array([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0])  # so many widths off
LOCUS = 1500  # points of an eigenvalue locus, which turns quickly near a resonance

TALL = "S is of all directions of the sensors; what no actuator reaches, no law makes quieter."
HIDDEN = "Lines that noise hides are drawn as measured; tables count them at the bound that it leaves."


def chosen(result: StudyResult) -> str:
    """Return the law that the study is for: that of its requirements, or the one that is quietest where it is worst."""
    if result.requirements is not None and result.requirements.law in result.designs:
        return result.requirements.law

    def worst(name: str) -> float:
        if name not in result.loops:
            return -np.inf
        loops = result.loops[name].facts.units.values()
        return min(loop.worst_direction_band_db if isinstance(loop, StableLoop) else -np.inf for loop in loops)

    return max(result.designs, key=worst)


def colours(result: StudyResult) -> dict[str, str]:
    """Return the colour of every law, the same in all sections."""
    return law_colours(result.designs, chosen(result))


def asked(result: StudyResult) -> RequiredOfLoop:
    """Return what is required of the sensitivity, or the band alone."""
    required = result.study.requirements
    if required is None or result.requirements is None:
        return RequiredOfLoop(result.plan.band_hz)
    return RequiredOfLoop(result.requirements.band_hz, required.attenuation_db, required.peak_db)


def measured_chart(result: StudyResult, names: Sequence[str], stem: str = "sensitivity") -> Chart | None:
    """Return the worst direction of laws as measured on every unit; None where none settled."""
    paint, curves, hides = colours(result), list[LoopCurve](), False
    units = result.plan.units
    for name in (n for n in names if n in result.loops):
        for unit, dash in zip(units, ("-", "--", ":", "-.") * len(units), strict=False):
            S = result.sensitivity(name, unit)
            if S is None:
                continue
            label = name if len(units) == 1 else f"{name}, {unit}"
            curves.append(LoopCurve(label, S.f_hz, worst_direction_db(S.values), paint[name], dash))
            loop = result.loops[name].facts.units[unit]
            hides |= isinstance(loop, StableLoop) and bool(loop.lines_hidden)
    if not curves:
        return None
    chart = measured_loops(stem, curves, asked(result))
    return replace(chart, caption=f"{chart.caption} {HIDDEN}") if hides else chart


def _responses(result: StudyResult) -> _Responses:
    """Return the plant and every law over frequency, `(nf, outputs, inputs)`, with lines where a loop rings."""
    f, plant, laws = result.analysis.facts.f_hz, result.design_plant, result.laws
    parts = (part for name, law in laws.items() for part in (name, law.hash))
    return _over_frequency(ByContents((f, plant, laws), content_hash(f, plant.hash, *parts)))


# The charts of loops and of weights show the same: where S is largest is a search, and is made once.
@lru_cache(maxsize=1)
def _over_frequency(asked: ByContents[tuple[FloatArray, StateSpace, Mapping[str, StateSpace]]]) -> _Responses:
    f, plant, laws = asked.value
    f = np.unique(np.concatenate([f, *(_seen_at(plant, law, f) for law in laws.values())]))
    return frozen(f), _matrices(plant, f), {name: _matrices(law, f) for name, law in laws.items()}


def _matrices(system: StateSpace, f_hz: FloatArray) -> ComplexArray:
    return frozen(np.moveaxis(system.frequency_response(f_hz), 2, 0))


def _seen_at(plant: StateSpace, law: StateSpace, f_hz: FloatArray) -> FloatArray:
    """Return lines about the sharp poles of a loop and where S is largest, in Hz: none of them is a line of a grid."""
    lines = beside_poles(sensitivity(plant, law).poles(), plant.rate_hz, SHARP, WIDTHS)
    lines = np.unique(np.concatenate([f_hz, lines[(lines > f_hz[0]) & (lines < f_hz[-1])]]))

    def sizes(at_hz: FloatArray) -> FloatArray:
        return largest_gains(loop_response(plant, law, at_hz)[0])

    return np.append(lines, refined(sizes, lines, sizes(lines))[1])


def shaped_charts(result: StudyResult, shown: Sequence[LoopFunction] = FUNCTIONS, stem: str = "loops") -> list[Chart]:
    """Return S, T and KS of all laws on the design model, or some of them; nothing where there is no law."""
    f, G, laws = _responses(result)
    if not laws:
        return []
    members: dict[str, dict[str, FloatArray]] = {member: {} for member in shown}
    for name, K in laws.items():
        for member, values in _largest(G, K, shown).items():
            members[member][name] = values
    chart = shaped_loops(stem, f, members, colours(result), {"KS": unit_of_control(result)}, asked(result))
    return [replace(chart, caption=f"{chart.caption} {TALL}")] if is_tall(result) else [chart]


def _largest(G: ComplexArray, K: ComplexArray, shown: Iterable[LoopFunction]) -> dict[LoopFunction, FloatArray]:
    """Return the largest singular values `(nf,)` of S, T and KS, or some of them; plant and law `(nf, ...)`."""
    eye = np.eye(G.shape[1])
    S = np.linalg.inv(eye - G @ K)
    made: dict[LoopFunction, NDArray[np.complexfloating[Any, Any]]] = {"S": S, "T": S - eye, "KS": K @ S}
    return {each: np.linalg.svd(made[each], compute_uv=False)[:, 0].astype(np.float64) for each in shown}


def weight_charts(result: StudyResult) -> list[Chart]:
    """Return S, T and KS of every law whose cost weighs them, under what that leaves; nothing where none does."""
    f, G, laws = _responses(result)
    left_open: dict[str, str] = {}
    members: dict[LoopFunction, list[WeightedFunction]] = {member: [] for member in FUNCTIONS}
    for name, K in laws.items():
        weights, facts = result.loop_weights(name), result.designs[name].facts
        if weights is None:
            left_open[name] = facts.method
            continue
        left = weights.left(f, facts.achieved if np.isfinite(facts.achieved) else facts.gamma)
        for member, values in _largest(G, K, facts.weights_on).items():
            members[member].append(WeightedFunction(name, values, left[member]))
    seen = {member: each for member, each in members.items() if each}
    if not seen:
        return []
    units = {"KS": unit_of_control(result)}
    return [weighted_loops("weights", f, seen, colours(result), units, asked(result).band_hz, left_open)]


def is_tall(result: StudyResult) -> bool:
    """Tell whether the plant has more outputs than inputs: some directions of its sensors no law reaches."""
    return len(result.design_plant.sensors) > len(result.design_plant.actuators)


def unit_of_control(result: StudyResult) -> str:
    """Return the unit of |K S|; none where channels have different ones or none was stated."""
    over, under = ({c.unit for c in wires} for wires in (result.design_plant.actuators, result.design_plant.sensors))
    if len(over) > 1 or len(under) > 1 or not any((*over, *under)):
        return ""
    return ratio(next(iter(over), ""), next(iter(under), ""))


def margin_charts(result: StudyResult) -> list[Chart]:
    """Return the disk margins of every channel at both ends of the design model."""
    plant = result.design_plant
    channels = {"input": [c.name for c in plant.actuators], "output": [c.name for c in plant.sensors]}
    ends: dict[str, dict[str, FloatArray]] = {}
    for end, names in channels.items():
        for name, outcome in result.designs.items():
            margins = outcome.facts.law_margins.get(end)
            if margins is not None and margins.disk.size == len(names):
                ends.setdefault(end, {})[name] = margins.disk
    if not ends:
        return []
    required = result.study.requirements
    return [margin_bars(ends, channels, colours(result), None if required is None else required.disk_margin)]


def locus_charts(result: StudyResult) -> list[Chart]:
    """Return the eigenvalue loci of the chosen law's loop."""
    name, shown = chosen(result), result.analysis.facts.f_hz
    if name not in result.laws:
        return []
    f = np.geomspace(shown[0], shown[-1], LOCUS)
    G, K = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (result.design_plant, result.laws[name]))
    loop = K @ G if G.shape[1] > G.shape[2] else G @ K  # the eigenvalues that are not zero are those of both
    return [loci(name, np.moveaxis(loop, 0, 2))]
