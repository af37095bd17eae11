"""Turn a report into one HTML file that needs nothing beside it."""

from dataclasses import replace
from itertools import count
from pathlib import Path

from ultraquiet.files import write_bytes
from ultraquiet.plot import Figure, draw_svg
from ultraquiet.report.content import Report


def render(report: Report) -> str:
    """Return the report as one HTML text; figures stand in it as SVG, no address is fetched."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ultraquiet.report", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )
    apart = named_apart(report)
    drawn = {figure.name: draw_svg(figure) for section in apart.sections for figure in section.figures}
    return environment.get_template("page.html.j2").render(report=apart, drawn=drawn)


def named_apart(report: Report) -> Report:
    """Return the report with a number behind the name of every figure whose name stands on the page already."""
    taken: set[str] = set()

    def apart(figure: Figure) -> Figure:
        names = (figure.name if number == 1 else f"{figure.name}-{number}" for number in count(1))
        name = next(name for name in names if name not in taken)
        taken.add(name)
        return replace(figure, name=name)

    sections = [replace(s, figures=[apart(figure) for figure in s.figures]) for s in report.sections]
    return replace(report, sections=sections)


def write(report: Report, path: Path) -> Path:
    """Write the report to `path`, through a temporary file; say so when that fails."""
    return write_bytes(path, render(report).encode())
