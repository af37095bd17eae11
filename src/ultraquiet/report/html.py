"""Turn a report into one HTML file that needs nothing beside it."""

import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ultraquiet import chart
from ultraquiet.files import write_bytes
from ultraquiet.report.content import Report, Span, Table, Verdict
from ultraquiet.report.figures import named_apart, on_page, pictures_of

if TYPE_CHECKING:
    import jinja2
    import markupsafe

LONGEST = 40  # letters of a cell that stands on one line
NUMBER = re.compile(r"[-+\u2212]?\.?\d")
QUANTITY = re.compile(r"\d[\d.]*(?:-\d[\d.]*)? (?:Hz|dB|%)")
SHAPES = {"ok": "●", "fragile": "▲", "bad": "■"}  # beside the colour, for readers and printers that see none


def render(report: Report) -> str:
    """Return the report as one HTML text: its figures as numbers and stills, its script and its style; no address."""
    apart, packing = named_apart(report), chart.Packing()
    figures = on_page(pictures_of(apart), packing)
    environment = _environment()
    assert environment.loader is not None
    source = environment.loader.get_source
    return environment.get_template("page.html.j2").render(
        report=apart,
        figures=figures,
        data=packing.data,
        shapes=SHAPES,
        style=chart.style() + source(environment, "page.css")[0],
        script=chart.script() if figures else "",
        behaviour=source(environment, "page.js")[0],
    )


@cache
def _environment() -> "jinja2.Environment":
    """Return what fills the page, its template compiled once in a process."""
    import jinja2

    loader = jinja2.PackageLoader("ultraquiet.report", ".")
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    environment.tests.update(verdict=_is_verdict, span=_is_span)
    environment.globals["kinds"] = _kinds
    environment.filters["held"] = _held
    return environment


def _is_verdict(cell: Any) -> bool:
    return isinstance(cell, Verdict)


def _is_span(cell: Any) -> bool:
    return isinstance(cell, Span)


def _kinds(table: Table) -> list[str]:
    """Return what each column holds: "words" are sentences, which wrap, "word" stands at the left, "" are numbers."""
    rows = [row for row in table.rows if not any(isinstance(cell, Span) for cell in row)]
    columns = [[str(row[k]) for row in rows if k < len(row)] for k in range(len(table.columns))]
    wraps = len(rows) == len(table.rows)
    return [
        "words" if wraps and max(map(len, cells), default=0) > LONGEST else "" if _are_numbers(cells) else "word"
        for cells in columns
    ]


def _are_numbers(cells: list[str]) -> bool:
    """Return whether at least half of what a column holds begins with a number."""
    said = [cell for cell in cells if cell not in ("", "-")]
    return 2 * sum(bool(NUMBER.match(cell)) for cell in said) >= len(said)


def _held(head: str) -> "markupsafe.Markup":
    """Return the head of a column or of the page, whose numbers stay beside their units when it wraps.

    >>> str(_held("rms <10-100 Hz> of it"))
    'rms &lt;<span class="held">10-100 Hz</span>&gt; of it'
    """
    import markupsafe

    return markupsafe.Markup(QUANTITY.sub(r'<span class="held">\g<0></span>', str(markupsafe.escape(head))))


def write(report: Report, path: Path) -> Path:
    """Write the report to `path`, through a temporary file; say so when that fails."""
    return write_bytes(path, render(report).encode())
