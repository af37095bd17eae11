"""The few controls that pages are made of, each with its `data-testid`."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from nicegui import ui

from ultraquiet._base.shown.line import loudness

WORDS = {"ok": "ok", "fragile": "fragile", "short": "fragile", "not white": "fragile", "poor fit": "fragile"}
COLUMN_PX = 190  # of a form, where it is widest
SHAPES = {"ok": "●", "fragile": "▲", "bad": "■", "none": "○"}


def mark_of(text: str) -> str:
    """Return a text as a `data-testid`.

    >>> mark_of("Try orders (1-8)")
    'try-orders-1-8'
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def say(sentence: str, kind: Literal["negative", "warning", "info"] = "negative") -> None:
    """Say a sentence on the page, long enough to be read, and below the boards, where nothing stands to be pressed."""
    patience_ms = max(12_000, 120 * len(sentence))
    ui.notify(sentence, type=kind, multi_line=True, timeout=patience_ms, close_button="ok", position="bottom-left")


def explained(control: Any, text: str, column: int) -> None:
    """Say on hovering what a control of a form is, at the form's left: above and below stand other fields."""
    with control:
        told = ui.tooltip(text)
    told.props(f'anchor="center left" self="center right" :offset="[{8 + column * COLUMN_PX}, 0]"')


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


@dataclass(frozen=True)
class Doubted:
    """A status that is true, beside something that a reader must not overlook: `ok` with a warning mark."""

    status: str
    doubt: str


def loop_status(facts: dict[str, Any], status: str | None = None) -> str | Doubted:
    """Return what a law's loop is judged, its own status unless another is given, with the doubt that belongs to it.

    A loop is ok that is stable and keeps its margins; that it makes its band louder is said beside, not against, it.

    >>> loop_status({"status": "ok: The loop is stable.", "attenuation_db": 12.0})
    'ok: The loop is stable.'
    >>> loop_status({"status": "ok: The loop is stable.", "attenuation_db": -3.0}).doubt
    'Yet its worst direction is louder by 3.0 dB.'
    """
    said = facts["status"] if status is None else status
    quiet = facts.get("attenuation_db")
    if quiet is None or quiet >= 0 or loudness(quiet) == loudness(0.0):
        return said
    return Doubted(said, f"Yet its worst direction is {loudness(quiet)}.")


def chip(status: str | Doubted, mark: str = "") -> None:
    """Show a status: a word and a shape beside its colour; its sentence on hovering."""
    doubt = ""
    if isinstance(status, Doubted):
        status, doubt = status.status, status.doubt
    kind = verdict(status)
    word = status.partition(":")[0] or "not made"
    if doubt and kind == "ok":
        kind, word = "fragile", f"{word}, louder"
    made = ui.label(f"{SHAPES[kind]} {word}").classes(f"uq-chip {kind}")
    if mark:
        made.props(f'data-testid="{mark}"')
    told = " ".join(filter(None, (status.partition(":")[2].strip(), doubt)))
    if told:
        made.tooltip(told)


def table(
    columns: Sequence[str],
    rows: Sequence[Sequence[str | Doubted]],
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


def _cell(text: str | Doubted) -> None:
    with ui.element("td"):
        if isinstance(text, Doubted) or (":" in text and verdict(text) != "none"):
            chip(text)
        else:
            ui.html(_escaped(text), sanitize=False)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
