"""The few controls that pages are made of, each with its `data-testid`."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nicegui import ui

WORDS = {"ok": "ok", "fragile": "fragile", "short": "fragile", "not white": "fragile", "poor fit": "fragile"}
SHAPES = {"ok": "●", "fragile": "▲", "bad": "■", "none": "○"}


def mark_of(text: str) -> str:
    """Return a text as a `data-testid`.

    >>> mark_of("Try orders (1-8)")
    'try-orders-1-8'
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def button(label: str, act: Callable[[], object], mark: str = "", main: bool = False, tip: str = "") -> ui.button:
    """Return a button; `main` is the one that goes on."""
    made = ui.button(label, on_click=act, color=None).props(
        f'no-caps unelevated dense data-testid="{mark or mark_of(label)}"'
    )
    made.classes("uq-main-button" if main else "uq-button")
    if tip:
        made.tooltip(tip)
    return made


def field(label: str, mark: str, value: str = "", hint: str = "", width: str = "100%") -> ui.input:
    """Return a text field."""
    made = ui.input(label or None, value=value, placeholder=hint)
    made.props(f'dense outlined {"stack-label" if label else ""} data-testid="{mark}"')
    return made.style(f"width: {width}")


def choice(
    label: str, options: Sequence[str] | Mapping[str, str], mark: str, value: str | None, then: Callable[..., object]
) -> ui.select:
    """Return a choice of one."""
    given: Any = dict(options) if isinstance(options, Mapping) else list(options)
    made = ui.select(given, label=label or None, value=value, on_change=lambda event: then(event.value))
    return made.props(f'dense outlined options-dense data-testid="{mark}"').classes("w-full")


def heading(text: str) -> None:
    """Write the heading of a part of a page."""
    ui.label(text).classes("uq-heading")


def words(text: str, kind: str = "") -> ui.label:
    """Write a sentence; `kind` is "caption", "doubt" or nothing."""
    return ui.label(text).classes(f"uq-words {kind}")


def verdict(status: str) -> str:
    """Return what colour a status has: `ok`, `fragile`, `bad` or `none`.

    >>> verdict("not white: The residual ..."), verdict("unstable: ..."), verdict("")
    ('fragile', 'bad', 'none')
    """
    word = status.partition(":")[0]
    return "none" if not word else WORDS.get(word, "bad")


def chip(status: str, mark: str = "") -> None:
    """Show a status: a word and a shape beside its colour; its sentence on hovering."""
    kind = verdict(status)
    word = status.partition(":")[0] or "not made"
    made = ui.label(f"{SHAPES[kind]} {word}").classes(f"uq-chip {kind}")
    if mark:
        made.props(f'data-testid="{mark}"')
    if ":" in status:
        made.tooltip(status.partition(":")[2].strip())


def table(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    mark: str,
    picked: Callable[[int], object] | None = None,
    strong: int | None = None,
) -> None:
    """Show a table; a click on a row, or Enter on it, picks it."""
    with (
        ui.element("div").classes("uq-table-box"),
        ui.element("table").classes("uq-table").props(f'data-testid="{mark}"'),
    ):
        with ui.element("thead"), ui.element("tr"):
            for name in columns:
                with ui.element("th"):
                    ui.html(_escaped(name), sanitize=False)
        with ui.element("tbody"):
            for k, row in enumerate(rows):
                line = ui.element("tr").props(f'data-testid="{mark}-{k}"')
                if k == strong:
                    line.classes("strong")
                if picked is not None:
                    line.props('tabindex="0" role="button"').classes("pick")
                    line.on("click", lambda _, k=k: picked(k)).on("keydown.enter", lambda _, k=k: picked(k))
                with line:
                    for cell in row:
                        _cell(cell)


def _cell(text: str) -> None:
    kind = verdict(text) if ":" in text else ""
    with ui.element("td"):
        if kind:
            chip(text)
        else:
            ui.html(_escaped(text), sanitize=False)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
