"""Spectra: frequency responses with their coherence, amplitude densities and what they add up to."""

from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve
from ultraquiet.values import Channel
from ultraquiet.workbench.figures.responses import SeenResponse, coherence_grid, response_grid
from ultraquiet.workbench.figures.scale import Scale
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, choice, field, heading, say, words
from ultraquiet.workbench.web.shell import Columns
from ultraquiet.workbench.web.view import Looker, View

KINDS = ("frequency response", "amplitude density", "cumulative RMS")


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Spectra(view, columns)


class _Spectra:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view, self._asked = view, None
        self._looker = Looker(view)
        with columns.side:
            self._settings()
        with columns.main:
            self._empty = words("No record yet: drop a file on Records, or let the bench measure.", "caption")
            self.chart = ChartElement(view.frames, "spectra-chart")
            self.second = ChartElement(view.frames, "coherence-chart")
        view.watch(self._refresh)

    def _settings(self) -> None:
        heading("Spectra")
        kind = self.view.params.get("show", KINDS[0])
        self.kind = choice("show", KINDS, "spectra-kind", kind, lambda value: self.view.set(show=value))
        self.estimator = choice("estimator", ("H1", "H2", "Hv"), "estimator", "H1", lambda _: self._refresh())
        words("H1: noise on the outputs; H2: noise on the inputs; Hv: on both.", "caption")
        self.segment = field("segment (samples)", "segment", "", "an eighth of the record")
        self.window = choice(
            "window", ("hann", "boxcar", "flattop", "blackman"), "window", "hann", lambda _: self._refresh()
        )
        button("Estimate", self._refresh, "estimate", main=True)
        with ui.element("div").classes("uq-row"):
            button("Hz / rad/s (H)", lambda: self.view.set(f=None if self.view.scale.radians else "rad"), "key-h")
            button("dB / plain (D)", lambda: self.view.set(g="plain" if self.view.scale.decibels else None), "key-d")

    def _refresh(self) -> None:
        names = [item.name for item in self.view.responding()]
        self._empty.set_visibility(not names)
        if not names:
            return
        settings: dict[str, Any] = {"window": self.window.value}
        if self.segment.value:
            try:
                settings["segment_samples"] = int(self.segment.value)
            except ValueError:
                say("spectra: write the length of a segment as a whole number of samples.")
                return
        items = [self.view.session.item("data", name) for name in names]
        asked = (self.kind.value, self.estimator.value, settings, [i.key for i in items], self.view.scale)
        if asked == self._asked:
            return
        self._asked = asked
        if self.kind.value == KINDS[0]:
            settings["estimator"] = self.estimator.value
            self._looker.ask("response", "frequency response", self._response, names=names, settings=settings)
        else:
            self._looker.ask("density", "density", self._density, name=names[-1], settings=settings)

    def _response(self, _: Any, found: dict[str, Any]) -> None:
        measured = measured_of(self.view, found)
        self.chart.show(
            response_grid("Frequency response, measured, with its 95 % band", measured, [], self.view.scale)
        )
        self.second.set_visibility(True)
        self.second.show(coherence_grid(measured, self.view.scale))

    def _density(self, _: Any, found: dict[str, Any]) -> None:
        facts = self.view.responding()[-1].facts
        channels = [*facts["actuators"], *facts["sensors"]]
        key = "asd" if self.kind.value == KINDS[1] else "rms"
        self.second.set_visibility(False)
        self.chart.show(density_grid(str(found["words"]), found["f_hz"], found[key], channels, key, self.view.scale))


def measured_of(view: View, found: dict[str, Any]) -> SeenResponse:
    """Return a measured response with the channels of the record that is shown."""
    facts = view.responding()[-1].facts
    inputs = [Channel(*facts["actuators"][int(k)]) for k in found["inputs"]]
    outputs = [Channel(*c) for c in facts["sensors"]]
    words_ = str(found["words"])
    return SeenResponse(found["f_hz"], found["values"], found["coherence"], found["variance"], inputs, outputs, words_)


def density_grid(
    words_: str, f_hz: np.ndarray, values: np.ndarray, channels: list[list[str]], key: str, scale: Scale
) -> Chart:
    """Return one panel a channel: amplitude density, or the RMS of everything below a frequency."""
    what = "amplitude density" if key == "asd" else "RMS below the frequency"
    panels = []
    for row, (name, unit) in zip(values, channels, strict=True):
        axis = Axis(f"{what} ({unit}/sqrt(Hz))" if key == "asd" else f"{what} ({unit})", "log")
        curve = Curve(name, scale.x(f_hz), row, "measured")
        panels.append(ChartPanel(scale.frequencies(), axis, [curve], title=name, height=190))
    return Chart("density", what.capitalize(), words_, panels, columns=1 if len(panels) < 3 else 2, legend="none")
