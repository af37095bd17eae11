"""Excite: a test signal over time and frequency, and the list that the bench executes."""

import numpy as np
from nicegui import ui

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.tables import Method
from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve
from ultraquiet.workbench.figures.scale import Scale
from ultraquiet.workbench.figures.traces import envelope
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, field, heading, say, words
from ultraquiet.workbench.web.method_form import MethodForm
from ultraquiet.workbench.web.shell import Columns, doing
from ultraquiet.workbench.web.view import View

USUAL_HZ = 1000.0  # round; the bench has its own


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Excite(view, columns)


class _Excite:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view = view
        with columns.main:
            self.chart = ChartElement(view.frames, "signal-chart")
        with columns.side:
            heading("Test signal")
            self.form = MethodForm("signals", "chirp", lambda _: self._show())
            with ui.element("div").classes("uq-form"):
                self.samples = field("samples", "samples", "7000")
                self.rate = field("rate (Hz)", "signal-rate", f"{USUAL_HZ:g}")
            button("Show", self._show, "show-signal")
            heading("The list")
            self.list = field("experiment list", "list", self._list(), "a TOML file in the study's folder")
            words("“suite” is the packaged list of the hexapod; a list of your own is a TOML file.", "caption")
            button("Measure the list", self._measure, "measure", main=True)
            self._told = words("", "caption")
            ui.link("See the records", view.link("Records")).props('data-testid="to-records"')
        self._show()

    def _list(self) -> str:
        return str(self.view.session.state["tables"].get("experiment", {}).get("list", "suite"))

    def _show(self) -> None:
        made = self.form.table()
        if made is None:
            return
        try:
            samples, rate = int(self.samples.value or 0), float(self.rate.value or 0)
            signal = Method.model_validate(made).make("signals")
            u = signal.generate(samples, rate)
            f_hz, density = signal.spectrum(samples, rate)
        except ValueError as error:
            say(f"excite: {error}")
            return
        except UltraquietError as error:
            say(str(error))
            return
        self.chart.show(signal_figure(made["method"], u, rate, f_hz, density, self.view.scale))

    def _measure(self) -> None:
        tables = self.view.session.state["tables"]
        if "bench" not in tables:
            say("excite: this study has no bench; take one on the page Bench.")
            return
        if tables.get("experiment", {}).get("list") != self.list.value:
            doing(self.view, {"op": "table", "table": "experiment", "values": {"list": self.list.value}})
        self.view.jobs.on_bench("measure", "measure the list", self._measured)

    def _measured(self, job: WorkItem) -> None:
        """Put what was measured on the board; called when the process is done."""
        if job.status != "done":
            return
        session = self.view.session
        for name, digest in job.result["records"].items():
            session.do({"op": "measure", "name": name, "file": f"records/{name}.h5", "hash": digest})


def signal_figure(
    name: str, u: np.ndarray, rate_hz: float, f_hz: np.ndarray, density: np.ndarray, scale: Scale
) -> Chart:
    """Return a signal over time, and its amplitude density."""
    places, shown = envelope(u[None], 900)
    over_time = Curve(name, places / rate_hz, shown[0], "measured")
    crest = float(np.abs(u).max() / max(np.sqrt(np.mean(u**2)), 1e-300))
    spectrum = Curve(name, scale.x(f_hz), np.sqrt(density), "measured")
    panels = [
        ChartPanel(Axis("time (s)"), Axis("command (actuator's unit)"), [over_time], title="over time", height=220),
        ChartPanel(
            scale.frequencies(), Axis("density (unit/√Hz)", "log"), [spectrum], title="amplitude density", height=260
        ),
    ]
    caption = (
        f"RMS {np.sqrt(np.mean(u**2)):.3g}, peak {np.abs(u).max():.3g}, crest factor {crest:.2f}, in the unit of the "
        "actuator that it will drive; a list that exceeds an actuator's limits is refused before anything moves."
    )
    return Chart("signal", f"{name}, {u.size / rate_hz:.3g} s", caption, panels, legend="none")
