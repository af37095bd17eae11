"""What a report is made of: a first page with the verdict, then sections with sentences, tables and figures."""

from collections.abc import Sequence
from dataclasses import dataclass

from ultraquiet.chart import Chart, Scene
from ultraquiet.plot import Figure

Picture = Chart | Figure | Scene


@dataclass(frozen=True)
class Verdict:
    """A word with its colour and shape: `grade` is "ok", "fragile" or "bad"; `aside` follows in small print."""

    word: str
    grade: str
    aside: str = ""

    @classmethod
    def of(cls, met: bool, word: str = "", aside: str = "") -> "Verdict":
        """Return the verdict on something that is met or not.

        >>> Verdict.of(False).word
        'missed'
        """
        return cls(word or ("met" if met else "missed"), "ok" if met else "bad", aside)

    def __str__(self) -> str:
        """Return the word with what follows it."""
        return f"{self.word} {self.aside}".strip()


@dataclass(frozen=True)
class Span:
    """A cell over several columns."""

    text: str
    columns: int

    def __str__(self) -> str:
        """Return its text."""
        return self.text


@dataclass(frozen=True)
class Table:
    """Rows of cells under column heads; numbers are shown as they are given, so round them first.

    A cell may be a `Verdict` or a `Span`; a `folded` table is opened by its reader.
    """

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    folded: bool = False


@dataclass(frozen=True)
class Section:
    """One part of the walk: what was done, what came of it; `details` are sentences that a reader opens."""

    title: str
    paragraphs: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Picture] = ()
    details: Sequence[str] = ()


@dataclass(frozen=True)
class Front:
    """The first page: one sentence that answers, its verdict, what was asked and reached, how to make it again."""

    headline: str
    verdict: Verdict | None = None
    below: str = ""
    tables: Sequence[Table] = ()
    figures: Sequence[Picture] = ()
    commands: Sequence[str] = ()


@dataclass(frozen=True)
class Report:
    """A titled list of sections. `facts` are the few lines on the first page, as (name, value)."""

    title: str
    lead: str
    facts: Sequence[tuple[str, str]]
    sections: Sequence[Section]
    front: Front | None = None
