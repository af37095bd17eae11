"""Validate: what models say to a record they have not seen, and what they leave of it."""

from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet.workbench.figures.traces import correlations, overlay
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import choice, heading, table, words
from ultraquiet.workbench.web.shell import Columns
from ultraquiet.workbench.web.view import Looker, View


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Validate(view, columns)


class _Validate:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view, self._asked = view, None
        self._found: dict[str, dict[str, Any]] = {}
        self._lookers: dict[str, Looker] = {}
        with columns.side:
            heading("Validate")
            names = list(view.session.state["data"])
            self.record = choice("on the record", names, "validate-record", self._unseen(), lambda _: self._refresh())
            words("Take a record that no model here was made from; Records splits one in two.", "caption")
            words("Models are those marked on the board at the left, up to eight.", "caption")
            self._facts = ui.element("div").props('data-testid="fits"')
            self._asking = ui.element("div")  # holds the timers of those who ask
            heading("Go on")
            ui.link("Design a law", view.link("Design")).props('data-testid="to-design"')
        with columns.main:
            self._empty = words("No model yet: identify one first.", "caption")
            self.chart = ChartElement(view.frames, "simulated-chart")
            self.residuals = ChartElement(view.frames, "residuals-chart")
        view.watch(self._refresh)

    def _unseen(self) -> str | None:
        state = self.view.session.state
        used = {name for recipe in state["models"].values() for name in recipe["records"]}
        free = [name for name in state["data"] if name not in used]
        judge = [name for name in free if name.endswith("-judge")]
        return (judge or free or list(state["data"]) or [None])[-1]

    def _refresh(self) -> None:
        models = self.view.ready("models")
        self._empty.set_visibility(not models)
        if not models or self.record.value is None:
            return
        record = self.view.session.item("data", self.record.value)
        asked = ([item.key for item in models], record.key)
        if asked == self._asked:
            return
        self._asked, self._found = asked, {}
        for item in models:
            if item.name not in self._lookers:
                with self._asking:
                    self._lookers[item.name] = Looker(self.view)
            self._ask(item.name)

    def _ask(self, name: str) -> None:
        def told(_: Any, arrays: dict[str, Any]) -> None:
            self._found[name] = arrays
            self._draw()

        self._lookers[name].ask("judge", f"judge {name}", told, model=name, data=self.record.value)

    def _draw(self) -> None:
        first = next(iter(self._found.values()))
        model = self.view.session.item("models", next(iter(self._found)))
        channels = [(c[0], c[1]) for c in model.facts["sensors"]]
        said = {name: found["simulated"] for name, found in self._found.items()}
        fits = {name: found["fit_percent"] for name, found in self._found.items()}
        best = max(fits, key=lambda name: float(np.median(fits[name])))
        caption = f"{best} meets the record best: {float(np.median(fits[best])):.1f} % of its movement, in the median."
        title = f"Simulated from the inputs of {self.record.value} alone"
        colours = self.view.colours("models")
        self.chart.show(overlay(title, caption, first["time_s"], first["measured"], said, channels, colours))
        found = self._found[best]
        names = [c[0] for c in channels]
        auto, cross, bound = found["auto"], found["cross"], float(found["bound"])
        self.residuals.show(correlations(f"What {best} leaves", auto, cross, bound, names))
        self._table(fits, channels)

    def _table(self, fits: dict[str, Any], channels: list[tuple[str, str]]) -> None:
        self._facts.clear()
        with self._facts:
            heading("Fit (%)")
            rows = [(c[0], *(f"{fit[k]:.1f}" for fit in fits.values())) for k, c in enumerate(channels)]
            table(("output", *fits), rows, "fit")
