"""The figures of a page: drawn by its script from numbers that stand in it once, and beside that a still for print."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

from ultraquiet.chart import Packing, Scene
from ultraquiet.plot import Figure, chart_of, figure_of
from ultraquiet.plot.page import still_of
from ultraquiet.report.content import Picture, Report
from ultraquiet.report.stills import stills


@dataclass(frozen=True)
class PageFigure:
    """A figure as the page holds it: a spec for the script, and a PNG as base64 for print and for pages without it."""

    name: str
    title: str
    caption: str
    spec: dict[str, Any]
    still: str


def on_page(pictures: Iterable[Picture], packing: Packing) -> dict[str, PageFigure]:
    """Return each picture by its name, which must differ."""
    pictures = list(pictures)
    drawn = stills([_on_paper(picture) for picture in pictures])
    return {
        p.name: PageFigure(p.name, p.title, p.caption, _spec(p, packing), s)
        for p, s in zip(pictures, drawn, strict=True)
    }


def _on_paper(picture: Picture) -> Figure:
    if isinstance(picture, Figure):
        return picture
    return still_of(picture) if isinstance(picture, Scene) else figure_of(picture)


def _spec(picture: Picture, packing: Packing) -> dict[str, Any]:
    spec = packing.spec(chart_of(picture) if isinstance(picture, Figure) else picture)
    spec.pop("caption", None)  # stands below the figure already
    return spec


def pictures_of(report: Report) -> list[Picture]:
    """Return all pictures of a report in their order."""
    front = [] if report.front is None else list(report.front.figures)
    return [*front, *(picture for section in report.sections for picture in section.figures)]


def named_apart(report: Report) -> Report:
    """Return the report with a number behind the name of every figure whose name stands on the page already."""
    taken: set[str] = set()

    def apart(picture: Picture) -> Picture:
        names = (picture.name if number == 1 else f"{picture.name}-{number}" for number in count(1))
        name = next(name for name in names if name not in taken)
        taken.add(name)
        return replace(picture, name=name)

    front = report.front and replace(report.front, figures=[apart(picture) for picture in report.front.figures])
    sections = [replace(s, figures=[apart(picture) for picture in s.figures]) for s in report.sections]
    return replace(report, front=front, sections=sections)
