"""The figures of a page: drawn by its script from numbers that stand in it once, and beside that a still for print."""

import base64
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

from ultraquiet.chart import Packing, Scene
from ultraquiet.plot import Figure, chart_of, draw_small_png, figure_of
from ultraquiet.plot.page import still_of
from ultraquiet.report.content import Picture, Report

MOST_BYTES = 60_000  # of a still


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
    return {picture.name: _prepared(picture, packing) for picture in pictures}


def _prepared(picture: Picture, packing: Packing) -> PageFigure:
    chart = chart_of(picture) if isinstance(picture, Figure) else picture
    figure = (
        picture
        if isinstance(picture, Figure)
        else still_of(picture)
        if isinstance(picture, Scene)
        else figure_of(picture)
    )
    still = base64.b64encode(draw_small_png(figure, MOST_BYTES)).decode()
    spec = packing.spec(chart)
    spec.pop("caption", None)  # stands below the figure already
    return PageFigure(picture.name, picture.title, picture.caption, spec, still)


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
