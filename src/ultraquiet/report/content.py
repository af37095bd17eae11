"""What a report is made of: sections with sentences, tables and figures."""

from collections.abc import Sequence
from dataclasses import dataclass

from ultraquiet.plot import Figure


@dataclass(frozen=True)
class Table:
    """Rows of cells under column heads; numbers are shown as they are given, so round them first."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True)
class Section:
    """One part of the walk: what was done, what came of it."""

    title: str
    paragraphs: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


@dataclass(frozen=True)
class Report:
    """A titled list of sections. `facts` are the few lines under the title, as (name, value)."""

    title: str
    lead: str
    facts: Sequence[tuple[str, str]]
    sections: Sequence[Section]
