"""`[paper]` of a study file: what a publication did, and what it printed."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ultraquiet._base.lines import Place
from ultraquiet._base.tables import Strict
from ultraquiet.pipeline.tables.numbers import Band, Flag, Order


class Claim(Strict):
    """`[[paper.claims]]`: something that a publication printed, beside what the study finds.

    Args:
        where: in the publication.
        printed: what stands there.
        ours: label -> place in `summary.json`, names joined by "/": "closed_loop/lqg/ground/tones/5/paper_db"; stages
            that the summary leaves out are found under their names, "validation/...", "analysis/...".
        unit: of these figures.
        why: what accounts for the difference, in words.
    """

    where: str
    printed: str
    ours: dict[str, str] = Field(default={})
    unit: str = ""
    why: str = ""


Shown = Literal["excitation", "responses", "bode", "simulation", "singular_values", "under_tone"]


class Paper(Strict):
    """`[paper]`: what a publication reported of this bench, shown beside what the study finds.

    Its structure is fitted to each of its test signals; `channel` is the one whose functions it prints, counted from
    one; `simulated` are records that models are shown beside; `says` are sentences of the report, as they stand.
    Over `band_hz` it compares its models; without it that is the band of `[closed_loop]`. `figures` are where it shows
    what a figure of the report shows; `zeros` is what its physics says of them; with `counts_plant` tones are told
    as |y| / |d| as well, the plant's own gain with them; its `processor` gives the table of code its cycles.
    """

    structure: str = "box-jenkins"
    order: Order = 5
    records: list[str] = Field(min_length=1)
    channel: Annotated[int, Field(ge=1, le=10_000, strict=True)] = 1
    simulated: list[str] = Field(default=[])
    band_hz: Band | None = None
    figures: dict[Shown, str] = Field(default={})
    zeros: str = ""
    counts_plant: Flag = False
    processor: Literal["c31"] | None = None
    says: list[str] = Field(default=[])
    claims: list[Claim] = Field(default=[])


def with_paper(content: dict[str, Any], places: Mapping[Place, int]) -> tuple[dict[str, Any], Mapping[Place, int]]:
    """Return the content with the older keys `identify.paper_*` as the table `paper` that they are now."""
    sweep = content.get("identify")
    if not isinstance(sweep, dict) or "paper" in content:
        return content, places
    older = {
        key: key.removeprefix("paper_") for key in sweep if key in ("paper_structure", "paper_order", "paper_records")
    }
    if not older:
        return content, places
    table: dict[str, Any] = {"records": ["chirp", "noise", "prbs"], **{new: sweep[key] for key, new in older.items()}}
    moved = {("paper", new): places[("identify", key)] for key, new in older.items() if ("identify", key) in places}
    rest = {key: value for key, value in sweep.items() if key not in older}
    return {**content, "identify": rest, "paper": table}, {**places, **moved}
