"""Two studies side by side: what each reached, their loops in one picture, and which settings differ."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet import files
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import counted
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.loops import StableLoop
from ultraquiet.pipeline.report import laws
from ultraquiet.pipeline.report.naming import NamedStudy, told_apart
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.study import BenchTable
from ultraquiet.plot.pages.loops import LoopCurve, measured_loops, worst_direction_db
from ultraquiet.report import Picture, Section, Table
from ultraquiet.values import FrequencyResponse

# Figures of a loop as a reader says them, and whether more of it is better.
FIGURES = {
    "worst_direction_band_db": ("worst direction over the band, dB", True),
    "peak_amplification_db": ("largest amplification, dB", False),
    "broadband_db": ("rms of the worst sensor over the band, dB", True),
}


@dataclass(frozen=True)
class Finished:
    """What a finished study left, as plain JSON: its summary and its settings; what tells it from another."""

    summary: Mapping[str, Any]
    settings: Mapping[str, Any]
    named: NamedStudy
    beside: Path  # folder of the study that it is set beside

    def names(self, result: StudyResult) -> tuple[str, str]:
        """Return what the study of a result is called beside it, and what it is called itself."""
        own = NamedStudy(result.study.study.title, _bench(result.study.bench), self.beside)
        return told_apart(own, self.named)


def finished(folder: Path, beside: Path) -> Finished:
    """Read what a study left, to set it beside the one in the folder `beside`.

    Raises:
        InputError: the folder holds no finished study.
    """
    try:
        summary, settings = (
            json.loads((folder / name).read_text(encoding="utf-8")) for name in ("summary.json", "study.json")
        )
        table = settings.get("bench")
        bench = None if table is None else BenchTable.model_validate(table)
        named = NamedStudy(str(summary.get("title", "")), _bench(bench), folder)
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(
            f"report: '{folder}' holds no finished study to compare with ({type(error).__name__}); run it first."
        ) from error
    return Finished(summary, settings, named, beside)


def _bench(table: BenchTable | None) -> str:
    return "no bench" if table is None else table.title


def compared(result: StudyResult, other: Finished) -> Section:
    """Return both studies' figures, loops and settings side by side."""
    here, there = other.names(result)
    rows = list(_figures(result, other))
    changed = list(_changed(_flat(json.loads(result.study.model_dump_json())), _flat(other.settings)))
    better = sum(1 for row in rows if str(row[-1]).startswith("better"))
    worse = sum(1 for row in rows if str(row[-1]).startswith("worse"))
    found = f"{counted(better, 'is', 'are')} better here, {worse} worse"
    both = f"of {counted(len(rows), 'figure')} that both have, {found}"
    text = f"{here}, the study of this report, beside {there}: {both if rows else 'no law of both ran on one unit'}; "
    text += f"{counted(len(changed), 'setting differs', 'settings differ') if changed else 'no setting differs'}."
    heads = ("law", "unit", "figure", here, there, "difference")
    tables = [Table("What both reached on the bench", heads, rows)] if rows else []
    if changed:
        tables.append(Table("Settings that differ", ("setting", here, there), changed, folded=True))
    return Section("Compared", [text], tables, _loops(result, other))


def _figures(result: StudyResult, other: Finished) -> Iterator[tuple[object, ...]]:
    there = other.summary.get("closed_loop") or {}
    for name, outcome in result.loops.items():
        for unit, loop in outcome.facts.units.items():
            found = (there.get(name) or {}).get(unit)
            if found is None or not isinstance(loop, StableLoop) or not found.get("stable"):
                continue
            for key, (words, more) in FIGURES.items():
                here, beyond = getattr(loop, key), found.get(key)
                if here is not None and beyond is not None and np.isfinite(here):
                    yield name, unit, words, f"{here:.1f}", f"{beyond:.1f}", _difference(here - beyond, more)
            for tone, facts in loop.tones.items():
                beyond = ((found.get("tones") or {}).get(tone) or {}).get("reduction_db")
                words, here = f"worst channel at {tone} Hz, dB", facts.reduction_db
                if beyond is not None and np.isfinite(here):
                    yield name, unit, words, f"{here:.1f}", f"{beyond:.1f}", _difference(here - beyond, True)


def _difference(by: float, more: bool) -> str:
    if abs(by) < 0.05:
        return "the same"
    return f"{'better' if (by > 0) == more else 'worse'} by {abs(by):.1f}"


def _loops(result: StudyResult, other: Finished) -> list[Picture]:
    """Return the chosen law of both studies, as measured, in one picture."""
    name, theirs = laws.chosen(result), _chosen(other)
    here, there = other.names(result)
    curves: list[LoopCurve] = []
    for unit in result.plan.units:
        mine = result.sensitivity(name, unit) if name in result.loops else None
        path = other.named.folder / "loops" / f"{stored.sensitivity(theirs, unit)}.h5"
        beyond = files.load(path) if path.exists() else None
        for S, label, colour in ((mine, f"{here}: {name}", "chosen"), (beyond, f"{there}: {theirs}", "law-1")):
            if isinstance(S, FrequencyResponse):
                dash = "-" if unit == result.plan.units[0] else "--"
                curves.append(LoopCurve(f"{label}, {unit}", S.f_hz, worst_direction_db(S.values), colour, dash))
    return [measured_loops("compared", curves, laws.asked(result))] if curves else []


def _chosen(other: Finished) -> str:
    """Return the law of the other study's requirements, or that of its loops that is quietest."""
    asked = other.summary.get("requirements")
    if asked:
        return str(asked["law"])
    loops = other.summary.get("closed_loop") or {}

    def worst(name: str) -> float:
        return min((u.get("worst_direction_band_db") or -np.inf for u in loops[name].values()), default=-np.inf)

    return max(loops, key=worst, default="")


def _flat(value: Any, at: str = "") -> dict[str, Any]:
    if isinstance(value, Mapping):
        return {k: v for key, each in value.items() for k, v in _flat(each, f"{at}.{key}" if at else str(key)).items()}
    return {at: value}


def _changed(here: Mapping[str, Any], there: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    for key in dict.fromkeys([*here, *there]):
        if here.get(key) != there.get(key):
            yield key, _said(here.get(key)), _said(there.get(key))


def _said(setting: Any) -> str:
    """Return a setting as a reader writes it.

    >>> _said([10.0, None]), _said(True)
    ('10, -', 'yes')
    """
    if setting is None:
        return "-"
    if isinstance(setting, bool):
        return "yes" if setting else "no"
    if isinstance(setting, list):
        return ", ".join(map(_said, setting))
    return f"{setting:g}" if isinstance(setting, float) else str(setting)
