"""One page in one browser: what is shown of the study, kept in its address, and told of every change."""

from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.chart.colours import law_colours
from ultraquiet.pipeline.identification import grouped
from ultraquiet.values import StateSpace
from ultraquiet.workbench.engine.items import Item
from ultraquiet.workbench.engine.session import Session
from ultraquiet.workbench.figures.scale import Scale
from ultraquiet.workbench.jobs.board import Jobs
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.jobs.looks import seen
from ultraquiet.workbench.web.controls import say
from ultraquiet.workbench.web.frames import FrameStore
from ultraquiet.workbench.web.place import ServedStudy

Then = Callable[[dict[str, Any], dict[str, Any]], object]  # told a result and its arrays
WIDER = 5.0  # than the band, at either end
MOST = 8  # curves of one kind in a figure


class View:
    """What one page shows.

    Args:
        place: the study that is served.
        page: which page this is.
        params: what its address says.
    """

    def __init__(self, place: ServedStudy, page: str, params: Mapping[str, str]) -> None:
        self.place, self.page = place, page
        self.params = {key: value for key, value in params.items() if key != "token"}
        self._watchers: list[Callable[[], object]] = []
        self._often: list[Callable[[], object]] = []
        self._seen = place.version
        self._stood = self._standing()

    @property
    def session(self) -> Session:
        """The study by hand."""
        return self.place.session

    @property
    def jobs(self) -> Jobs:
        """Its work."""
        return self.place.jobs

    @property
    def frames(self) -> FrameStore:
        """Figures on their way."""
        return self.place.frames

    @property
    def scale(self) -> Scale:
        """How frequencies and gains are shown."""
        return Scale(self.params.get("f") == "rad", self.params.get("g") != "plain")

    def shown(self, board: str) -> list[str]:
        """Return the items of a board that figures show: those that were clicked, else the last or the chosen one."""
        names = list(self.session.state[board])
        asked = [name for name in self.params.get(board, "").split(",") if name in names]
        if asked or not names:
            return asked[:MOST]
        chosen = self.session.state.get({"models": "model", "laws": "law"}.get(board, ""))
        made = [item.name for item in self.session.items(board) if item.ready]
        return [chosen or (made or names)[-1]]

    def ready(self, board: str) -> list[Item]:
        """Return those that are shown and made; a stale one stands for itself as it was."""
        items = [self.session.item(board, name) for name in self.shown(board)]
        return [item for item in items if item.ready]

    def responding(self) -> list[Item]:
        """Return the records whose response is shown: those that were clicked, else those of the study's own model.

        The last record of a study that ran may be a tone, which tells of one frequency; of a model made from several
        groups the first stands for all.
        """
        model = self.session.state["model"]
        if "data" in self.params or model is None:
            return self.ready("data")
        names = list(self.session.state["models"][model]["records"])
        first = next(iter(grouped(names).values()))
        items = [self.session.item("data", name) for name in first[:MOST]]
        return items if all(item.ready for item in items) else self.ready("data")

    def span(self, model: StateSpace) -> tuple[float, float]:
        """Return the frequencies in which a model's modes are looked for: its band, and some way beyond."""
        assert model.rate_hz is not None
        asked = self.session.state["tables"].get("closed_loop", {}).get("band_hz")
        low, high = asked or even_plant(model, who="workbench").band_hz
        return low / WIDER, min(high * WIDER, model.rate_hz / 2)

    def colours(self, board: str) -> dict[str, str]:
        """Return the colour that every item of a board keeps."""
        chosen = self.session.state.get({"models": "model", "laws": "law"}.get(board, ""))
        return law_colours(self.session.state[board], chosen)

    def toggle(self, board: str, members: list[str]) -> None:
        """Show an item, or the records of a group, or no longer; of records one group at a time."""
        names = self.shown(board)
        if board == "data":
            many = [] if names == members[:MOST] and "data" in self.params else members[:MOST]
        elif members[0] in names:
            many = [each for each in names if each not in members]
        else:
            many = [*names, *members][-MOST:]
        self.set(**{board: ",".join(many)})

    def set(self, **params: str | None) -> None:
        """Change what the address says, and with it what is shown."""
        for key, value in params.items():
            if value:
                self.params[key] = value
            else:
                self.params.pop(key, None)
        ui.run_javascript(f"history.replaceState(null, '', location.pathname + {('?' + urlencode(self.params))!r})")
        self.refresh()

    def link(self, page: str) -> str:
        """Return the address of another page that shows the same."""
        kept = {key: value for key, value in self.params.items() if key in ("data", "models", "laws", "f", "g")}
        return f"/{page.lower().replace(' ', '-')}" + (f"?{urlencode(kept)}" if kept else "")

    def watch(self, watcher: Callable[[], object], often: bool = False) -> None:
        """Call `watcher` now, after every change of the study, of what is shown, and when work begins or ends.

        Args:
            watcher: what is called.
            often: also while work only goes on; what a user may be pointing at should not be built anew so often.
        """
        (self._often if often else self._watchers).append(watcher)
        watcher()

    def refresh(self) -> None:
        """Tell everyone on this page."""
        self._seen, standing = self.place.version, self._standing()
        if standing != self._stood:
            self._stood = standing
            for watcher in self._watchers:
                watcher()
        for watcher in self._often:
            watcher()

    def _standing(self) -> tuple[object, ...]:
        """Return what changes when there is something else to see or to press."""
        work = tuple((job.number, job.status) for job in self.jobs.recent)
        return self.session.version, tuple(self.params.items()), work, self.place.stopped

    def tick(self) -> None:
        """Refresh when something has changed since."""
        if self.place.version != self._seen:
            self.refresh()

    def look(self, task: str, title: str, then: Then, **words: Any) -> WorkItem:
        """Compute something to look at; `then` is told the result and its arrays, on this page."""
        return Looker(self).ask(task, title, then, **words)


class Looker:
    """Asks for looks, one at a time: what was asked for last is what is shown."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._job: WorkItem | None = None
        self._then: Then | None = None
        self._failed: Callable[[str], object] = say
        self._timer = ui.timer(0.025, self._poll, active=False)  # twice as often as a live bench has frames

    def failed(self, told: Callable[[str], object]) -> None:
        """Tell `told` the sentence of a failure, in place of a notice."""
        self._failed = told

    def ask(self, task: str, title: str, then: Then, **words: Any) -> WorkItem:
        """Ask; an earlier question that is not answered yet is dropped."""
        self._then = then
        self._job = self._view.jobs.look(task, title, **words)
        self._timer.activate()
        return self._job

    def _poll(self) -> None:
        job = self._job
        if job is None or not job.over:
            return
        self._job = None
        self._timer.deactivate()
        if job.status == "done" and self._then is not None:
            arrays = seen(self._view.session.folder, job.result["view"]) if "view" in job.result else {}
            self._then(job.result, arrays)
        elif job.status == "failed":
            self._failed(job.sentence)
