"""Turn a report into one HTML file that needs nothing beside it."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ultraquiet import chart
from ultraquiet.files import write_bytes
from ultraquiet.report.content import Report, Span, Table, Verdict
from ultraquiet.report.figures import named_apart, on_page, pictures_of

if TYPE_CHECKING:
    import jinja2

LONGEST = 40  # letters of a cell that stands on one line
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
    environment.globals["prose"] = _prose
    return environment


def _is_verdict(cell: Any) -> bool:
    return isinstance(cell, Verdict)


def _is_span(cell: Any) -> bool:
    return isinstance(cell, Span)


def _prose(table: Table) -> list[bool]:
    """Return which columns are sentences, which wrap and stand at the left; numbers never wrap."""
    longest = [
        max((len(str(row[k])) for row in table.rows if k < len(row)), default=0) for k in range(len(table.columns))
    ]
    spans = any(isinstance(cell, Span) for row in table.rows for cell in row)
    return [not spans and n > LONGEST for n in longest]


def write(report: Report, path: Path) -> Path:
    """Write the report to `path`, through a temporary file; say so when that fails."""
    return write_bytes(path, render(report).encode())
