"""Bench: which one, its channels and limits, and what they read while one actuator moves."""

from dataclasses import replace
from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve, Mark, MovingShape, Scene
from ultraquiet.pipeline import packaged_study
from ultraquiet.plot.pages.modes import mode_shapes
from ultraquiet.values.sketch import Sketch
from ultraquiet.workbench.figures.traces import envelope
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, choice, heading, say, table, words
from ultraquiet.workbench.web.method_form import MethodForm
from ultraquiet.workbench.web.shell import Columns, doing
from ultraquiet.workbench.web.view import Looker, View

SHOWN_S = 4.0
DEMO = "suite"
CLOSED = ("fmu", "replay", "wrapped", "process")  # their settings are objects or programs: a study file names them


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Bench(view, columns)


def demo_steps() -> list[dict[str, Any]]:
    """Return the steps that make the packaged study's bench, list and measurements those of this one."""
    content = packaged_study(DEMO).model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    steps: list[dict[str, Any]] = [{"op": "title", "title": content["study"].pop("title")}]
    for name, values in content.items():
        if name not in ("plant", "controllers", "requirements"):
            steps.append({"op": "table", "table": name, "values": values})
    return steps


class _Bench:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view, self._known, self._asked = view, None, None
        self._job: WorkItem | None = None
        self._past: list[np.ndarray] = []
        self._fresh = False
        self._limited: Any = None
        self._looker = Looker(view)
        with columns.main:
            self._place = ui.element("div").classes("uq-figures")
            self.chart = ChartElement(view.frames, "live-chart")
            self.shape = ChartElement(view.frames, "shape-chart")
        with columns.side:
            self._settings()
        view.watch(self._refresh)
        ui.timer(0.025, self._draw)  # twice as often as frames come, or now and then two of them would be one

    def _settings(self) -> None:
        heading("The bench")
        bench = self.view.session.state["tables"].get("bench", {})
        self.form = MethodForm("bench", bench.get("method", "hexapod"), values=bench, names=["hexapod"])
        with ui.element("div").classes("uq-row"):
            button("Take this bench", self._take, "take-bench", main=True)
            button("Open the demo's study", self._demo, "demo", tip="bench, list and tables of the packaged demo")
        words('A bench of your own stands in study.toml as object = "FILE.py:CALLABLE".', "caption")
        heading("Live")
        self.actuator = choice("drive the actuator", {}, "live-actuator", None, lambda _: None)
        self.signal = MethodForm("signals", "noise")
        with ui.element("div").classes("uq-row"):
            button("Start", self._start, "live-start", main=True)
            button("Stop", self._stop, "live-stop")

    def _take(self) -> None:
        made = self.form.table()
        if made is not None:
            doing(self.view, {"op": "table", "table": "bench", "values": made})

    def _demo(self) -> None:
        for step in demo_steps():
            if not doing(self.view, step):
                return

    def _refresh(self) -> None:
        bench = self.view.session.state["tables"].get("bench")
        if bench is None:
            self._place.clear()
            with self._place, ui.element("div").classes("uq-empty"):
                words("This study has no bench. Take one at the right, open the demo's, or go on with files.")
                ui.link("Drop a file on Records", self.view.link("Records"))
        elif bench != self._asked:
            self._asked = bench
            self._looker.ask("describe", "bench", self._tell)

    def _tell(self, found: dict[str, Any], _: Any) -> None:
        self._known = found
        self.actuator.set_options({k: c[0] for k, c in enumerate(found["actuators"])}, value=0)
        self._place.clear()
        with self._place:
            ui.label(f"{found['name']}, {found['rate_hz']:g} Hz").classes("uq-title-line").props('data-testid="bench"')
            rows = [
                (side[:-1], c[0], c[1], _limit(c[2]), _limit(c[3]))
                for side in ("actuators", "sensors")
                for c in found[side]
            ]
            table(("kind", "channel", "unit", "lowest", "highest"), rows, "channels")

        if "sketch" in found:
            self.shape.show(self._scene(Sketch(**found["sketch"])))

    def _scene(self, sketch: Sketch) -> Scene:
        """Return the bench as it stands; moving in the modes of the study's model once there is one."""
        name = self.view.session.state["model"]
        item = None if name is None else self.view.session.item("models", name)
        if item is not None and item.ready:
            model = item.value()
            moving = mode_shapes(model, self.view.span(model), sketch)
            if moving is not None:
                return replace(moving, title=f"The bench, moving in the modes of {name}")
        still = np.zeros(sketch.points.shape)
        return Scene("bench", "The bench", "", sketch.points, sketch.lines, [MovingShape("at rest", still, still)])

    def _start(self) -> None:
        made = self.signal.table()
        if made is None or self._known is None:
            say("bench: take a bench first.")
            return
        if self._job is not None and not self._job.over:
            return
        self._past, self._fresh = [], False
        state = dict(self.view.session.state)
        words_ = {"signal": made, "actuator": int(self.actuator.value or 0)}
        self._job = self.view.jobs.submit(
            WorkItem("live", "live bench", state, words_, self._over, self._heard), "bench"
        )

    def _stop(self) -> None:
        if self._job is not None:
            self.view.jobs.cancel(self._job)

    def _over(self, job: WorkItem) -> None:
        self._fresh = bool(self._past)

    def _heard(self, part: dict[str, Any]) -> None:
        """Take a block; called by the reader of the process, so nothing is drawn here."""
        self._past.append(part["signals"])
        self._limited = part["limited"]
        keep = int(SHOWN_S * self._known["rate_hz"]) if self._known else 0
        while sum(block.shape[1] for block in self._past[1:]) > keep:
            self._past.pop(0)
        self._fresh = True

    def _draw(self) -> None:
        if not self._fresh or self._known is None:
            return
        self._fresh = False
        signals = np.hstack(list(self._past))
        places, shown = envelope(signals, 250)
        self.chart.show(strip(self._known, places / self._known["rate_hz"], shown, self._limited))


def strip(bench: dict[str, Any], time_s: np.ndarray, signals: np.ndarray, limited: list[int] | None) -> Chart:
    """Return the strip chart of all channels with their limits; the title says what met them."""
    wires = [*bench["actuators"], *bench["sensors"]]
    clipped = [c[0] for c, count in zip(wires, limited or [0] * len(wires), strict=True) if count]
    panels = []
    for k, ((name, unit, low, high), row) in enumerate(zip(wires, signals, strict=True)):
        limits = [
            Mark("limit", y=v, colour="bad") for v in (low, high) if v is not None and np.abs(row).max() > abs(v) / 2
        ]
        colour = "open" if k < len(bench["actuators"]) else "measured"
        word = "command" if k < len(bench["actuators"]) else "reading"
        axes = Axis("time (s)"), Axis(unit)
        panels.append(ChartPanel(*axes, [Curve(word, time_s, row, colour)], title=name, marks=limits, height=96))
    title = f"Live: {', '.join(clipped)} at the limit" if clipped else "Live"
    return Chart("live", title, "", panels, columns=3 if len(panels) > 8 else 2)


def _limit(value: float | None) -> str:
    return "none" if value is None else f"{value:g}"
