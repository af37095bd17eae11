"""Closed loop: what a law does to disturbances on the model, and measured on the bench where there is one."""

from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet._base.shown.line import loudness
from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve, Region
from ultraquiet.values import StateSpace
from ultraquiet.values.channel import ratio
from ultraquiet.workbench.engine.live import grid_hz, responses
from ultraquiet.workbench.figures.scale import Scale
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, choice, field, heading, say, table, words
from ultraquiet.workbench.web.shell import Columns, doing
from ultraquiet.workbench.web.view import View

NO_LAW = "No law yet: design one first. What it does to disturbances is drawn here."


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _ClosedLoop(view, columns)


class _ClosedLoop:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view, self._drawn = view, None
        self._measured: dict[str, Any] = {}
        with columns.side:
            heading("Closed loop")
            laws = list(view.session.state["laws"])
            self.law = choice("the law", laws, "loop-law", view.session.state["law"], lambda _: self._refresh())
            tones = view.session.state["tables"].get("closed_loop", {}).get("tones_hz", [])
            self.tones = field("tones (Hz)", "tones", ", ".join(map(str, tones)), "none")
            button("Measure on the bench", self._close, "close-loop", main=True)
            words("Without a bench the loop is that of the model.", "caption")
            ui.link("Deploy", view.link("Deploy")).props('data-testid="to-deploy"')
        with columns.main:
            self._place = ui.element("div")
            self.chart = ChartElement(view.frames, "directions-chart")
            self.step = ChartElement(view.frames, "step-chart")
        view.watch(self._refresh)

    def _close(self) -> None:
        if "bench" not in self.view.session.state["tables"]:
            say("closed loop: this study has no bench; what is drawn is the loop of the model.", "warning")
            return
        if self.law.value is None:
            say("closed loop: there is no law yet; design one first.")
            return
        try:
            tones = [float(each) for each in str(self.tones.value or "").split(",") if each.strip()]
        except ValueError:
            say("closed loop: write tones as numbers with commas between.")
            return
        loop = {**self.view.session.state["tables"].get("closed_loop", {}), "tones_hz": tones}
        if tones != self.view.session.state["tables"].get("closed_loop", {}).get("tones_hz", []):
            doing(self.view, {"op": "table", "table": "closed_loop", "values": loop})
        name = self.law.value
        self.view.jobs.on_bench("close", f"close {name} on the bench", lambda job: self._closed(name, job), law=name)

    def _closed(self, name: str, job: WorkItem) -> None:
        """Keep what was measured; called when the process is done, drawn with the next refresh."""
        if job.status == "done":
            self._measured[name] = job.result
            self._drawn = None

    def _refresh(self) -> None:
        session = self.view.session
        laws = list(session.state["laws"])
        if self.law.options != laws:
            self.law.set_options(laws, value=self.law.value if self.law.value in laws else session.state["law"])
        name = self.law.value
        if name is None or not session.item("laws", name).ready:
            self._place.clear()
            with self._place:
                words(
                    NO_LAW if name is None else f"{name} is not made yet; what it does is drawn here then.", "caption"
                )
            return
        item = session.item("laws", name)
        asked = (item.key, self.view.scale, name in self._measured)
        if asked == self._drawn:
            return
        self._drawn = asked
        plant = session.item("models", item.recipe["model"]).value()
        self._tell(name)
        self.chart.show(directions(name, plant, item.value(), self._measured.get(name), self.view.scale))
        self.step.show(noise_figure(name, plant, item.value()))

    def _tell(self, name: str) -> None:
        self._place.clear()
        found = self._measured.get(name)
        with self._place:
            if found is None:
                words(f"The loop of {name} with its model; nothing was measured on a bench yet.", "caption")
                return
            for unit, facts in found["facts"]["units"].items():
                words(f"{unit}: {facts['status']}").props(f'data-testid="loop-{unit}"')
                paper = bool(self.view.session.state["tables"].get("paper", {}).get("counts_plant"))
                keys = ("reduction_db", "paper_db")[: 1 + paper]
                rows = [
                    (f"{tone} Hz", *(_reduction(tone_facts.get(key)) for key in keys))
                    for tone, tone_facts in facts.get("tones", {}).items()
                ]
                if rows:
                    heads = ("tone", "worst channel", "as the paper counts")[: 2 + paper]
                    table(heads, rows, f"tones-{unit}")


def _reduction(value: float | None) -> str:
    """Return by how much a tone got quieter; `None` is what noise hides wholly."""
    return "-" if value is None else loudness(value)


def directions(name: str, plant: StateSpace, law: StateSpace, found: Any, scale: Scale) -> Chart:
    """Return by how much the best and the worst direction are quieter, on the model and as measured."""
    known = responses(plant, law)
    g, k = np.moveaxis(known.G, 2, 0), np.moveaxis(known.K, 2, 0)
    S = np.linalg.inv(np.eye(g.shape[1]) - g @ k)
    reached = S @ np.linalg.qr(g)[0] if g.shape[1] > g.shape[2] else S
    sizes = np.linalg.svd(reached, compute_uv=False)
    x = scale.x(known.f_hz)
    curves = [
        Curve("model, worst direction", x, scale.y(sizes[:, 0]), "chosen", "--"),
        Curve("model, best direction", x, scale.y(sizes[:, -1]), "open", "--"),
    ]
    measured = {} if found is None else found["curves"]
    for unit, curve in measured.items():
        colour = "chosen" if unit == next(iter(measured)) else "law-1"
        at = scale.x(np.array(curve["f_hz"]))
        curves.append(Curve(f"{unit}, worst direction", at, scale.y(np.array(curve["worst"])), colour))
    axis = scale.gains("outputs with the law over without")
    regions = [Region("louder", y=(0.0 if scale.decibels else 1.0, None), colour="bad")]
    worst = float(20 * np.log10(sizes[:, 0].max()))
    caption = f"On the model the loudest direction gains {worst:.1f} dB, at {known.f_hz[sizes[:, 0].argmax()]:.4g} Hz."
    panel = ChartPanel(scale.frequencies(), axis, curves, regions=regions, height=300)
    return Chart("directions", f"What {name} does to disturbances", caption, [panel])


def noise_figure(name: str, plant: StateSpace, law: StateSpace) -> Chart:
    """Return what white disturbance at the inputs leaves at each output, open and closed: density over frequency."""
    f = grid_hz(plant)
    G, K = plant.frequency_response(f), law.frequency_response(f)
    g, k = np.moveaxis(G, 2, 0), np.moveaxis(K, 2, 0)
    closed = np.linalg.solve(np.eye(g.shape[1]) - g @ k, g)
    panels: list[ChartPanel] = []
    lower_db: list[float] = []
    units = {channel.unit for channel in plant.actuators}
    for i, wire in enumerate(plant.sensors):
        opened, quiet = (np.sqrt(np.sum(np.abs(r[:, i, :]) ** 2, axis=1)) for r in (g, closed))
        had, left = (float(np.trapezoid(density**2, f)) for density in (opened, quiet))
        lower_db.append(10 * float(np.log10(had / left)) if had > 0 and left > 0 else 0.0)
        gain = ratio(wire.unit, next(iter(units))) if len(units) == 1 else f"{wire.unit} per unit".strip()
        axes = Axis("frequency (Hz)", "log"), Axis(f"gain ({gain})", "log")
        curves = [Curve("without", f, opened, "open"), Curve("with the law", f, quiet, "chosen")]
        panels.append(ChartPanel(*axes, curves, title=wire.name, height=170))
    title = f"White disturbances at all inputs: what each output reads, without and with {name}"
    least = int(np.argmin(lower_db))
    caption = (
        "Density of each output over that of the disturbances, alike and independent at all inputs, on the model. The "
        f"rms that gains least is that of {plant.sensors[least].name}: {loudness(lower_db[least])}."
    )
    return Chart("densities", title, caption, panels, columns=1 if len(panels) < 3 else 2)
