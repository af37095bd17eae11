"""What stands around every page: the way through the study, the boards, the log, and the stop button."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from ultraquiet._base.errors import UltraquietError
from ultraquiet.pipeline.identification import grouped
from ultraquiet.workbench.engine.items import Item
from ultraquiet.workbench.engine.steps import BOARDS
from ultraquiet.workbench.engine.written.script import lines_of
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.controls import button, chip, heading, loop_status, say
from ultraquiet.workbench.web.view import View

PAGES = (
    "Bench",
    "Excite",
    "Records",
    "Spectra",
    "Identify",
    "Validate",
    "Design",
    "Reduce",
    "Closed loop",
    "Deploy",
    "Report",
)
TITLES = {"data": "Data", "models": "Models", "laws": "Laws", "codes": "Code"}
POLL_S = 0.25
SHOWN_JOBS = 4


@dataclass(frozen=True)
class Columns:
    """Where a page puts its figures and its settings."""

    main: Any
    side: Any


@contextmanager
def shell(view: View) -> Generator[Columns]:
    """Build the page around what is built inside."""
    ui.add_head_html('<link rel="stylesheet" href="/own/uq.css"><link rel="stylesheet" href="/own/workbench.css">')
    ui.add_head_html('<script src="/own/uq.js"></script><script src="/own/workbench.js"></script>')
    ui.page_title(f"{view.page} · {view.session.state['title']}")
    _bridge(view)
    with ui.element("div").classes("uq-shell"):
        _header(view)
        with ui.element("div").classes("uq-columns"):
            with ui.element("nav").classes("uq-boards").props('data-testid="boards" aria-label="boards"'):
                boards = ui.column().classes("uq-column")
            main = ui.element("main").classes("uq-main").props('data-testid="main"')
            side = ui.element("aside").classes("uq-side").props('data-testid="side" aria-label="settings"')
        log = ui.element("footer").classes("uq-log").props('data-testid="log"')
    yield Columns(main, side)
    view.watch(lambda: _boards(view, boards))
    view.watch(lambda: _log(view, log), often=True)
    ui.timer(POLL_S, view.tick)


def doing(view: View, step: dict[str, Any]) -> bool:
    """Take a step; a refusal is said on the page. Return whether it was taken."""
    try:
        view.session.do(step)
    except UltraquietError as error:
        say(str(error))
        return False
    view.refresh()
    return True


def making(view: View, board: str, name: str, then: Callable[[WorkItem], object] | None = None) -> WorkItem:
    """Make an item in the process beside."""
    return view.jobs.make(board, name, then)


def _bridge(view: View) -> None:
    """Listen to the keys that the page's script passes on."""

    def key(event: Any) -> None:
        word = event.args
        if word == "h":
            view.set(f=None if view.scale.radians else "rad")
        elif word == "d":
            view.set(g="plain" if view.scale.decibels else None)
        elif word == "undo":
            view.session.undo()
        elif word == "redo":
            view.session.redo()

    ui.on("uq-key", key)


def _header(view: View) -> None:
    with ui.element("header").classes("uq-header"):
        ui.label("Ultraquiet").classes("uq-brand")
        with ui.element("div").classes("uq-whose"):
            study = ui.label(view.session.state["title"]).classes("uq-study")
            study.props('data-testid="study"').props["title"] = view.session.state["title"]  # whole where it is cut
            busy = ui.label("").classes("uq-study busy").props('data-testid="busy" aria-live="polite"')
        with ui.element("nav").classes("uq-pages").props('aria-label="pages"') as pages:
            pass
        with (
            ui.element("button")
            .classes("uq-theme")
            .props(
                'type="button" data-testid="theme" onclick="uqTheme()" title="light or dark" aria-label="light or dark"'
            )
        ):
            ui.html("◐", sanitize=False)
        with (
            ui.element("button")
            .classes("uq-stop")
            .props('type="button" data-testid="stop" onclick="uqStop()" title="Esc twice" aria-label="stop everything"')
        ):
            ui.html("STOP", sanitize=False)

    def looking() -> None:
        at_work = [job for job in view.jobs.looked if not job.over]
        now = next((job for job in at_work if job.status == "running"), at_work[-1] if at_work else None)
        busy.text = "" if now is None else f"computing: {now.title} …"
        busy.props["title"] = busy.text  # whole where it is cut
        busy.update()

    view.watch(looking, often=True)

    def links() -> None:
        pages.clear()
        with pages:
            for name in PAGES:
                link = ui.link(name, view.link(name)).classes("uq-page")
                link.props(f'data-testid="page-{name.lower().replace(" ", "-")}"')
                if name == view.page:
                    link.classes("here").props('aria-current="page"')

    view.watch(links)


def _boards(view: View, place: Any) -> None:
    place.clear()
    session = view.session
    with place:
        with ui.row().classes("uq-undo"):
            undo = button("Undo", session.undo, "undo", tip="Ctrl+Z")
            redo = button("Redo", session.redo, "redo", tip="Ctrl+Shift+Z")
            undo.set_enabled(session.can_undo)
            redo.set_enabled(session.can_redo)
        missing = [item for board in BOARDS for item in session.items(board) if not item.ready]
        if missing and all(job.over for job in view.jobs.recent):
            button(f"Make missing ({len(missing)})", lambda: _make_all(view), "make-all", main=True)
        for board in BOARDS:
            heading(TITLES[board])
            if not session.state[board]:
                ui.label("nothing yet").classes("uq-words caption")
            for name, members in grouped(session.state[board]).items():
                _entry(view, session.item(board, members[0]), name, members)


def _make_all(view: View) -> None:
    for board in BOARDS:
        for item in view.session.items(board):
            if not item.ready:
                making(view, board, item.name)


def _entry(view: View, item: Item, label: str, members: list[str]) -> None:
    """Show an item, or the several records of one group as one."""
    session = view.session
    stale = session.stale(item.board, item.name)
    colour = view.colours(item.board).get(item.name, "measured") if item.board in ("models", "laws") else "measured"
    shown = item.name in view.shown(item.board)
    row = ui.element("div").classes("uq-item" + (" shown" if shown else "") + (" stale" if stale else ""))
    row.props(f'data-testid="item-{item.board}-{item.name}" tabindex="0" role="button" aria-pressed="{shown}"')
    row.on("click", lambda: view.toggle(item.board, members))
    row.on("keydown.enter", lambda: view.toggle(item.board, members))
    with row:
        ui.element("span").classes("uq-dot").style(f"background: var(--uq-{colour})")
        text = label if len(members) == 1 else f"{label} ×{len(members)}"
        with ui.element("span").classes("uq-item-words"):
            ui.label(text.replace("_", "_\u200b")).classes("uq-item-name").tooltip(", ".join(members))
            if item.board in ("models", "laws") and session.state[item.board[:-1]] == item.name:
                ui.label("★").classes("uq-star").tooltip("the study's own")
            if stale is not None:
                ui.label("stale").classes("uq-chip fragile").tooltip(f"made before: {stale[1]}")
            elif not item.ready:
                ui.label("not made").classes("uq-chip none")
            elif item.facts.get("status"):
                chip(loop_status(item.facts))
        _item_menu(view, item)


def _item_menu(view: View, item: Item) -> None:
    mark = f"more-{item.board}-{item.name}"
    with (
        ui.element("span").on("click.stop"),
        ui.button("⋯", color=None).props(f'flat dense size="sm" aria-label="more" data-testid="{mark}"'),
        ui.menu().props("auto-close"),
    ):
        if item.board in ("models", "laws"):
            key = item.board[:-1]
            ui.menu_item(f"Choose as the study's {key}", lambda: doing(view, {"op": "choose", key: item.name}))
        ui.menu_item("Make it again" if item.ready else "Make it", lambda: making(view, item.board, item.name))
        ui.menu_item("Copy as Python", lambda: _copy("\n".join(_lines(view, item.board, item.name))))
        ui.menu_item("Remove", lambda: doing(view, {"op": "remove", "board": item.board, "name": item.name}))


def _lines(view: View, board: str, name: str) -> list[str]:
    return lines_of(view.session.state, view.session.folder, board, name)


def _copy(text: str) -> None:
    ui.clipboard.write(text)
    ui.notify("copied", timeout=1500)


def _log(view: View, place: Any) -> None:
    place.clear()
    with place:
        with ui.row().classes("uq-log-head"):
            heading("Log: every step as one line of Python")
            ui.space()
            button("Copy as Python", lambda: _copy(view.session.python()), "copy-python")
            button("Copy as TOML", lambda: _copy(view.session.toml()), "copy-toml")
        for job in list(view.jobs.recent)[-SHOWN_JOBS:]:
            if not job.over or job.sentence:
                _job(view, job)
        lines = [line for board in BOARDS for name in view.session.state[board] for line in _lines(view, board, name)]
        with ui.element("pre").classes("uq-lines").props('data-testid="python"'):
            ui.html("\n".join(_escaped(line) for line in lines) or "# nothing yet", sanitize=False)


def _job(view: View, job: WorkItem) -> None:
    with ui.row().classes("uq-job").props(f'data-testid="job-{job.number}"'):
        if job.over:
            ui.label(job.sentence).classes(f"uq-words {'doubt' if job.status == 'failed' else 'caption'}")
            return
        ui.linear_progress(job.progress, show_value=False).props("instant-feedback rounded").classes("uq-progress")
        note = job.note or job.status
        ui.label(job.title if note == job.title else f"{job.title} — {note}").classes("uq-words caption")
        button("Cancel", lambda: view.jobs.cancel(job), f"cancel-{job.number}")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
