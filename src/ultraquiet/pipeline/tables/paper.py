"""`[paper]` of a study file: what a publication did, and what it printed."""

from typing import Annotated

from pydantic import Field

from ultraquiet._base.tables import Strict
from ultraquiet.pipeline.tables.numbers import Band, Order


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


class Paper(Strict):
    """`[paper]`: what a publication reported of this bench, shown beside what the study finds.

    Its structure is fitted to each of its test signals; `channel` is the one whose functions it prints, counted from
    one; `simulated` are records that models are shown beside; `says` are sentences of the report, as they stand.
    """

    structure: str = "box-jenkins"
    order: Order = 5
    records: list[str] = Field(min_length=1)
    channel: Annotated[int, Field(ge=1)] = 1
    simulated: list[str] = Field(default=[])
    band_hz: Band = (10.0, 250.0)
    says: list[str] = Field(default=[])
    claims: list[Claim] = Field(default=[])
