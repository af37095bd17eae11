"""The pages by their names, and the door."""

from collections.abc import Callable

from fastapi import Request
from nicegui import ui

from ultraquiet.workbench.web.pages import (
    bench,
    closed_loop,
    deploy,
    design,
    excite,
    identify,
    records,
    reduce,
    report,
    spectra,
    validate,
)
from ultraquiet.workbench.web.place import ServedStudy
from ultraquiet.workbench.web.shell import PAGES, Columns, shell
from ultraquiet.workbench.web.view import View

BUILDERS: dict[str, Callable[[View, Columns], object]] = {
    "Bench": bench.build,
    "Excite": excite.build,
    "Records": records.build,
    "Spectra": spectra.build,
    "Identify": identify.build,
    "Validate": validate.build,
    "Design": design.build,
    "Reduce": reduce.build,
    "Closed loop": closed_loop.build,
    "Deploy": deploy.build,
    "Report": report.build,
}


def add_pages(place: ServedStudy) -> None:
    """Make every page known to the server."""
    for name in PAGES:
        _add(place, name, BUILDERS[name])

    @ui.page("/")
    def door(request: Request) -> None:
        _show(place, "Records", BUILDERS["Records"], request)


def _add(place: ServedStudy, name: str, build: Callable[[View, Columns], object]) -> None:
    @ui.page(f"/{name.lower().replace(' ', '-')}")
    def page(request: Request) -> None:
        _show(place, name, build, request)


def _show(place: ServedStudy, name: str, build: Callable[[View, Columns], object], request: Request) -> None:
    view = View(place, name, dict(request.query_params))
    with shell(view) as columns:
        build(view, columns)
