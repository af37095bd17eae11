"""The first page: the answer, what was asked and reached on every unit, the picture, and how to make it all again."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from ultraquiet._base.shown.line import counted, loudness, on_its_side, opening
from ultraquiet.pipeline.facts.code import CodeFacts, WholeNumberFacts
from ultraquiet.pipeline.facts.loops import StableLoop, UnstableLoop
from ultraquiet.pipeline.facts.requirements import RequirementFacts, RequirementsFacts
from ultraquiet.pipeline.report import laws
from ultraquiet.pipeline.report.mission import payload_charts
from ultraquiet.pipeline.requirements import in_short
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.study import packaged_study, quick_study
from ultraquiet.report import Front, Picture, Span, Table, Verdict


def front(result: StudyResult) -> Front:
    """Return the first page of a finished study."""
    asked = result.requirements
    name = laws.chosen(result)
    tables = [] if asked is None else [_asked_and_reached(asked, _units(result))]
    return Front(
        headline=_headline(result, name),
        verdict=None if asked is None else _verdict(asked),
        below=_law_in_short(result, name) if asked is not None else _not_judged(result, name),
        tables=tables,
        figures=hero(result),
        commands=commands(result),
    )


def _units(result: StudyResult) -> tuple[str, ...]:
    return result.plan.units if result.loops else ()


def _verdict(asked: RequirementsFacts) -> Verdict:
    """Count what the table on the first page has a line for: what one unit misses is missed."""
    every = {each.requirement for each in asked.judged}
    missed = {each.requirement for each in asked.judged if not each.met}
    aside = f"{len(every) - len(missed)} of {counted(len(every), 'requirement')} met"
    return Verdict.of(asked.ok, "ok" if asked.ok else "not ok", aside)


def _headline(result: StudyResult, name: str) -> str:
    """Say in one sentence what the law reaches where it was measured."""
    if name not in result.loops:
        found = result.designs[name].facts
        return (
            f"{name}: a law of {counted(found.states, 'state')}" if name in result.laws else f"{name}: no law was found"
        )
    loops = result.loops[name].facts.units
    failed = {unit: loop for unit, loop in loops.items() if isinstance(loop, UnstableLoop)}
    if failed:
        unit, loop = next(iter(failed.items()))
        said = loop.on(name, unit)
        return said if said.startswith(name) else opening(said)
    worst = min(_band_db(loop) for loop in loops.values() if isinstance(loop, StableLoop))
    asked = result.requirements
    low, high = result.plan.band_hz if asked is None or asked.law != name else asked.band_hz
    for loop in loops.values():  # what is said of every direction holds where the bench was heard
        if isinstance(loop, StableLoop) and loop.heard_hz is not None and loop.unheard((low, high)):
            low, high = max(low, loop.heard_hz[0]), min(high, loop.heard_hz[1])
    if worst > 0:
        return f"Quieter by {worst:.1f} dB in every direction, {low:.4g}-{high:.4g} Hz"
    return f"Not quieter in every direction: the worst is {loudness(worst)}, {low:.4g}-{high:.4g} Hz"


def _band_db(loop: StableLoop) -> float:
    own = loop.required_band_db
    return loop.worst_direction_band_db if own is None else own


def _law_in_short(result: StudyResult, name: str) -> str:
    """Say what the law is and what its code came to."""
    facts, code = result.designs[name].facts, result.deployment.get(name)
    on = f" on {' and '.join(_units(result))}" if len(_units(result)) > 1 else ""
    method = "" if facts.method == name else f", {facts.method}"  # a law that nobody named has its method's name
    text = f"{name}: one law{on}{method}, {counted(facts.states, 'state')}"
    if isinstance(code, CodeFacts):
        words = f"; its code is {code.verdict.partition(':')[0]}"
        text += f"{words}, {code.flash_bytes / 1024:.0f} kB of flash, {code.ram_bytes / 1024:.1f} kB of RAM"
    elif isinstance(code, WholeNumberFacts):
        text += f"; its code of whole numbers, {code.precision}, is {code.verdict.partition(':')[0]}"
    return f"{text}."


def _not_judged(result: StudyResult, name: str) -> str:
    best = "" if len(result.designs) == 1 else " The best of the laws is shown."
    return f"The study asks for nothing, so nothing is judged.{best} {_law_in_short(result, name)}"


def _asked_and_reached(asked: RequirementsFacts, units: Sequence[str]) -> Table:
    """Return a line a requirement: what was asked, what every unit reached, the verdict."""
    rows: list[list[object]] = []
    for requirement, group in groupby(asked.judged, key=lambda each: each.requirement):
        judged = list(group)
        words, unit = in_short(requirement, asked.band_hz)
        rows.append([words, f"{judged[0].asked:g}{unit}", *_reached(judged, units), None])
        failed = [each.where for each in judged if not each.met]
        rows[-1][-1] = Verdict.of(not failed, aside=f"on {', '.join(failed)}" if failed and len(judged) > 1 else "")
    return Table(f"Required of {asked.law}", ("requirement", "asked", *(units or ("reached",)), "verdict"), rows)


def _reached(judged: Sequence[RequirementFacts], units: Sequence[str]) -> list[object]:
    by_place = {each.where: _figure(each) for each in judged}
    if units and set(by_place) <= set(units):
        return [by_place.get(unit, "-") for unit in units]
    if len(by_place) == 1:
        return [Span(next(iter(by_place.values())), max(len(units), 1))]
    return [Span(", ".join(f"{place} {figure}" for place, figure in by_place.items()), max(len(units), 1))]


def _figure(each: RequirementFacts) -> str:
    if each.figure is None or not np.isfinite(each.figure):
        return "not measured"
    decimals = 1 if each.requirement.endswith("_db") else 2
    return f"{each.figure:.{decimals}f}" if each.met else on_its_side(each.figure, each.asked, decimals)


def hero(result: StudyResult) -> list[Picture]:
    """Return the picture that one remembers: the loop that was measured, or what the design model says of it."""
    felt = payload_charts(result, laws.chosen(result), "felt")
    if felt:
        return [*felt]
    measured = laws.measured_chart(result, (laws.chosen(result),), "reached")
    return [measured] if measured is not None else [*laws.shaped_charts(result, ("S",), "designed")]


def commands(result: StudyResult) -> list[str]:
    """Return what makes the study again, from nothing but what it was made of."""
    seed = result.study.study.seed
    packaged = packaged_study("suite")
    for option, study in (("", packaged), (" --quick", quick_study(packaged))):
        own = study.study.seed
        if study.model_copy(update={"study": result.study.study}).model_dump() == result.study.model_dump():
            return [f"ultraquiet demo{option}{'' if seed == own else f' --seed {seed}'} --out DIR"]
    return ["mkdir again && cp study.json again", "ultraquiet report again"]
