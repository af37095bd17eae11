"""Report: the whole study from where it stands, judged and written down."""

import json
from typing import Any

from nicegui import ui
from pydantic import ValidationError

from ultraquiet._base.errors import UltraquietError
from ultraquiet.pipeline import Study, reload_study
from ultraquiet.workbench.engine.items import FACTS, Item
from ultraquiet.workbench.engine.session import Session
from ultraquiet.workbench.engine.steps import BOARDS
from ultraquiet.workbench.engine.written.own_files import EDITED
from ultraquiet.workbench.engine.written.study_text import content
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.controls import Doubted, button, chip, heading, loop_status, say, table, words
from ultraquiet.workbench.web.shell import TITLES, Columns
from ultraquiet.workbench.web.view import View

AGAIN = "Run the whole study again to judge it."
NAMED = 3  # of the items that changed
JUDGING = ("requirements", "closed_loop", "payload", "limits", "deploy")  # tables that a summary was judged by


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Report(view, columns)


class _Report:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view = view
        with columns.side:
            heading("Report")
            words(
                "What is there is reused; what is missing is computed; everything is judged and written down.",
                "caption",
            )
            button("Run the whole study", self._run, "run-study", main=True)
            words("The same from a shell, in the study's folder:", "caption")
            ui.label("ultraquiet run study.toml --out .").classes("uq-lines")
            ui.link("study.toml", "/study/study.toml").props('data-testid="get-toml"')
            ui.link("study.py", "/study/study.py").props('data-testid="get-python"')
            self._kept = words("", "caption").props('data-testid="kept"')
        with columns.main:
            self._place = ui.element("div").classes("uq-figures")
        view.watch(self._show)

    def _run(self) -> None:
        state = self.view.session.state
        if not state["model"] or not any(r["model"] == state["model"] for r in state["laws"].values()):
            say("report: a study needs a model and a law for it; choose both on their pages.")
            return
        session = self.view.session
        self.view.jobs.submit(WorkItem("run", "run the whole study", {}, {}, lambda _: session.measured_anew()))

    def _show(self) -> None:
        folder = self.view.session.folder
        kept = sorted(path.name for path in folder.glob(f"study.{EDITED}*"))
        self._kept.text = f"Written by hand, and kept under another name: {', '.join(kept)}." if kept else ""
        self._place.clear()
        with self._place:
            summary = folder / "summary.json"
            if not summary.exists():
                words("The study has not run yet: press Run the whole study; its report opens from here.", "caption")
                self._boards()
                return
            try:
                found = json.loads(summary.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                words(f"summary.json cannot be read ({error}); run the study again.", "doubt")
                return
            if older := since(self.view.session, summary.stat().st_mtime):
                words(f"This summary is older than what stands on the boards: {older}. {AGAIN}", "doubt").props(
                    'data-testid="older"'
                )
            self._judged(found)
            if (folder / "report.html").exists():
                ui.link("Open the report", "/study/report.html", new_tab=True).props('data-testid="open-report"')
            ui.link("summary.json", "/study/summary.json")

    def _judged(self, found: dict[str, Any]) -> None:
        asked = found.get("requirements")
        title = self.view.session.state["title"]
        ui.label(title).classes("uq-title-line")
        if asked:
            for each in asked.get("judged", []):
                with ui.element("div").classes("uq-row"):
                    chip("ok: met" if each.get("met") else "short: missed")
                    words(str(each.get("sentence", "")))
        rows = [
            (
                name,
                str(law.get("states", "")),
                _decibels(law.get("peak_sensitivity_db")),
                law["status"],
            )
            for name, law in found.get("design", {}).items()
        ]
        if rows:
            table(("law", "states", "peak of S", "status"), rows, "report-laws")
        for sentence in found.get("failures", []):
            words(str(sentence), "doubt")

    def _boards(self) -> None:
        session = self.view.session
        rows = [
            (TITLES[board], item.name, item.recipe["op"], _state(item))
            for board in BOARDS
            for item in session.items(board)
        ]
        if rows:
            heading("What stands on the boards")
            table(("board", "item", "step", "state"), rows, "everything")


def since(session: Session, at: float) -> str:
    """Return what the boards hold that a summary, written at a time in seconds, knows nothing of; empty for nothing."""
    said = []
    for board in BOARDS[:-1]:  # code is no part of what is judged
        for item in session.items(board):
            if session.stale(board, item.name) is not None:
                said.append(f"{item.name} is stale")
            elif item.ready and (item.folder / FACTS).stat().st_mtime > at:
                said.append(f"{item.name} was made since")
    said += [f"[{name}] was changed" for name in _changed(session)]
    return ", ".join([*said[:NAMED], *([f"{len(said) - NAMED} more"] if len(said) > NAMED else [])])


def _changed(session: Session) -> list[str]:
    """Return the tables that ask for something else than the study that ran here did."""
    try:
        ran, now = reload_study(session.folder), Study.model_validate(content(session.state))
    except (UltraquietError, ValidationError):  # none ran here, or the boards are no whole study
        return []
    return [name for name in JUDGING if getattr(ran, name) != getattr(now, name)]


def _state(item: Item) -> str | Doubted:
    if not item.facts.get("status"):
        return "made" if item.ready else "not made"
    return loop_status(item.facts)


def _decibels(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} dB"
