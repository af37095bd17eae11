"""The publication of a study's bench, claim by claim: what it printed, what this run finds, why they differ."""

from collections.abc import Mapping
from typing import Any

from ultraquiet._base.shown.line import rounded
from ultraquiet.pipeline.facts.typed import finite, to_plain
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.summary import summarise
from ultraquiet.pipeline.tables.paper import Claim
from ultraquiet.report import Section, Table

COLUMNS = ("where", "printed", "found in this run", "why it differs")
MISSING = "not found in this run"


def claims(result: StudyResult) -> Section | None:
    """Return each claim beside the figures that this run left; None where the study names none."""
    paper = result.study.paper
    if paper is None or not paper.claims:
        return None
    found = {
        **finite(to_plain(summarise(result))),
        "validation": finite(to_plain(result.validation.facts)),
        "analysis": finite(to_plain(result.analysis.facts)),
    }
    rows = [(claim.where, claim.printed, _ours(claim, found), claim.why) for claim in paper.claims]
    text = ["Figures are read from this run's summary, none is written by hand; reasons are the study's own words."]
    return Section(
        "The paper, claim by claim", text, [Table("What was printed, and what this study finds", COLUMNS, rows)]
    )


def _ours(claim: Claim, found: Mapping[str, Any]) -> str:
    return "; ".join(f"{label}: {_said(at(place, found), claim.unit)}" for label, place in claim.ours.items()) or "-"


def at(place: str, found: Any) -> Any:
    """Return what stands at a place of nested mappings and lists, None where nothing does.

    >>> at("a/1/b", {"a": [0, {"b": 3.0}]})
    3.0
    """
    for name in place.split("/"):
        if isinstance(found, Mapping) and name in found:
            found = found[name]
        elif isinstance(found, list) and name.isdecimal() and int(name) < len(found):
            found = found[int(name)]
        else:
            return None
    return found


def _said(value: Any, unit: str) -> str:
    if value is None:
        return MISSING
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if unit == "dB":
        return f"{rounded(value)} dB"
    digits = f"{value:.4g}" if abs(value) < 1000 or isinstance(value, float) else str(value)
    return f"{digits} {unit}".rstrip()
