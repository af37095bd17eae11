"""Turn a report into one HTML file that needs nothing beside it."""

from pathlib import Path

from ultraquiet.files import write_bytes
from ultraquiet.plot import draw_svg
from ultraquiet.report.content import Report


def render(report: Report) -> str:
    """Return the report as one HTML text; figures stand in it as SVG, no address is fetched."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ultraquiet.report", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )
    drawn = {figure.name: draw_svg(figure) for section in report.sections for figure in section.figures}
    return environment.get_template("page.html.j2").render(report=report, drawn=drawn)


def write(report: Report, path: Path) -> Path:
    """Write the report to `path`, through a temporary file; say so when that fails."""
    return write_bytes(path, render(report).encode())
