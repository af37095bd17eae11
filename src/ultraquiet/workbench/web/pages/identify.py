"""Identify: a form for the method, the order by a click, and up to eight models over the measurement."""

from dataclasses import replace
from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet._base.shown.line import chance
from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.identification import grouped
from ultraquiet.plot.pages.modes import mode_shapes
from ultraquiet.plot.pages.stabilisation import stabilisation
from ultraquiet.values.sketch import Sketch
from ultraquiet.workbench.engine.forms import settings_of
from ultraquiet.workbench.figures.responses import Modelled, SeenResponse, pole_map, response_grid
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, field, heading, say, table, words
from ultraquiet.workbench.web.method_form import MethodForm
from ultraquiet.workbench.web.pages.spectra import measured_of
from ultraquiet.workbench.web.shell import Columns, doing, making
from ultraquiet.workbench.web.view import Looker, View

TRIED = list(range(1, 11))
POINTS = 400
HALVES = "grid-template-columns: minmax(0, 1fr) minmax(0, 1fr)"
NO_MODEL = "No model yet: choose a method at the right and press Identify, or try some orders first."
NO_RECORD = "No record yet: drop a file on Records, or let the bench measure. Models are made of records."
LEAST = -20.0  # a fit far below zero says no more than one at zero, and would hide the others


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Identify(view, columns)


class _Identify:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view, self._drawn = view, None
        self._measured: Any = None
        self._looker, self._orders, self._lines, self._shape = (Looker(view) for _ in range(4))
        self._orders.failed(self._untried)
        self._lines.failed(lambda _: None)  # a record too short for it is told of by the orders beside it
        self._sketch: Sketch | None = None
        self._asks_bench = True
        self._stabilised: Any = None
        self._at_work: WorkItem | None = None
        self._tried: dict[str, Any] = {}
        with columns.side:
            self._settings()
        with columns.main:
            self._candidates = ui.element("div")
            with ui.element("div").classes("uq-row"):
                self._trying = ui.label("").classes("uq-words caption").props('data-testid="trying" aria-live="polite"')
                self._cancel = button("Cancel", self._give_up, "end-orders")
            with ui.element("div").classes("uq-figures").style(HALVES):  # what a button leads to stands in sight
                self.orders = ChartElement(view.frames, "orders-chart", on_point=self._picked)
                self.stable = ChartElement(view.frames, "stabilisation-chart", on_point=self._stood)
            self.responses = ChartElement(view.frames, "models-chart")
            with ui.element("div").classes("uq-figures").style(HALVES):
                self.poles = ChartElement(view.frames, "poles-chart")
                self.modes = ChartElement(view.frames, "modes-chart")
        view.watch(self._refresh)
        view.watch(self._tell_orders, often=True)

    def _settings(self) -> None:
        heading("Identify")
        self.record = ui.select(self._records(), label="from the records", value=self._first(), multiple=True)
        self.record.props('dense outlined options-dense use-chips data-testid="identify-record"').classes("w-full")
        self.period = field("period (samples)", "period", "", "none: one record that moves all inputs")
        self.units = field("further units of the bench", "units", "", "none; their names, with commas between")
        self.units.set_visibility("bench" in self.view.session.state["tables"])
        self.form = MethodForm("identify", self._fitting())
        self.name = field("name of the model", "model-name", "", "method and order")
        with ui.element("div").classes("uq-row"):
            button("Identify", self._identify, "identify", main=True)
            button("Try orders 1 to 10", self._try, "try-orders", tip="fits of each, and a stabilisation diagram")
        words(
            "Judged on the last 40 % of the record, which those models have not seen; click an order to take it.",
            "caption",
        )
        heading("Go on")
        ui.link("Validate", self.view.link("Validate")).props('data-testid="to-validate"')
        ui.link("Design a law", self.view.link("Design")).props('data-testid="to-design"')

    def _records(self) -> list[str]:
        names = list(self.view.session.state["data"])
        return list(dict.fromkeys([*grouped(names), *names]))

    def _first(self) -> list[str]:
        shown = [item.name for item in self.view.responding()] or self.view.shown("data")
        groups = grouped(list(self.view.session.state["data"]))
        return [name for name, members in groups.items() if set(members) & set(shown)][-1:]

    def _fitting(self) -> str:
        """Return the method that is offered first: of several inputs and outputs all at once, in seconds."""
        items = self.view.session.state["data"]
        shown = [self.view.session.item("data", name).facts for name in self._members() if name in items]
        many = any(len(facts["actuators"]) > 1 or len(facts["sensors"]) > 1 for facts in shown if facts)
        return "subspace" if many else "box-jenkins"

    def _members(self) -> list[str]:
        groups = grouped(list(self.view.session.state["data"]))
        return [each for name in self.record.value or [] for each in groups.get(name, [name])]

    def _identify(self) -> None:
        table_ = self.form.table()
        if table_ is None:
            return
        if not self.record.value:
            say("identify: there is no record yet; drop a file on Records.")
            return
        self._take(table_, str(self.name.value or ""))

    def _take(self, method: dict[str, Any], name: str) -> None:
        names = self._members()
        try:
            period = int(self.period.value) if self.period.value else None
        except ValueError:
            say("identify: write the period as a whole number of samples.")
            return
        name = name or f"{method['method']}-{_order(method)}"
        named = [each.strip() for each in str(self.units.value or "").split(",") if each.strip()]
        units = {"units": named} if named else {}
        step = {"op": "identify", "name": name, "records": names, "period_samples": period, "method": method, **units}
        if doing(self.view, step):
            making(self.view, "models", name)
            shown = [each for each in self.view.shown("models") if each != name]
            self.view.set(models=",".join([*shown, name][-8:]))

    def _try(self) -> None:
        made = self.form.table()
        members = self._members()
        if made is None or not members:
            return
        bare = {key: value for key, value in made.items() if key != "order"}
        self._tried = bare
        # poles by order take a second, fits of a record of many channels a minute each: what is quick stands first
        self._lines.ask("modes", "poles by order", self._show_stable, data=members[0])
        words_ = {"data": members[0], "method": bare, "tried": TRIED}
        self._at_work = self._orders.ask("orders", f"orders of {bare['method']}", self._show_orders, **words_)
        self._tell_orders()

    def _tell_orders(self) -> None:
        """Say how far the trial of orders is, and offer to end it."""
        job = self._at_work
        busy = job is not None and not job.over
        self._cancel.set_visibility(busy)
        if job is None or not busy:
            self._trying.text = ""
            return
        tried = f"Trying orders {TRIED[0]} to {TRIED[-1]} of {self._tried['method']}"
        self._trying.text = f"{tried}: {job.progress:.0%}; they are drawn here …"

    def _give_up(self) -> None:
        if self._at_work is not None:
            self.view.jobs.cancel(self._at_work)

    def _untried(self, sentence: str) -> None:
        say(sentence)

    def _show_orders(self, found: dict[str, Any], _: Any) -> None:
        rows = [row for row in found["rows"] if "unseen" in row]
        if not rows:
            say(found["rows"][0].get("refused", "identify: no order could be identified."))
            return
        x = np.array([row["order"] for row in rows], dtype=float)
        seen, unseen = (np.maximum([row[key] for row in rows], LEAST) for key in ("seen", "unseen"))
        curves = [
            Curve("seen", x, seen, "open", "--", "path"),
            Curve("not seen", x, unseen, "chosen", "-", "path"),
            Curve("click to take", x, unseen, "chosen", kind="points"),
        ]
        best = max(rows, key=lambda row: row["unseen"])
        caption = f"Order {best['order']} meets unseen data best, {best['unseen']:.1f} %; prefer the knee of the curve."
        panel = ChartPanel(Axis("order"), Axis("median fit (%)"), curves, height=300)
        self.orders.show(Chart("orders", f"Orders of {self._tried['method']}", caption, [panel]))

    def _show_stable(self, _: Any, found: dict[str, Any]) -> None:
        rows, rate_hz = found["rows"], float(found["rate_hz"])
        roots = {int(n): rows[rows[:, 0] == n, 1:] for n in found["orders"]}
        self._stabilised = list(roots)
        inside = rows[(rows[:, 1] > 0) & (rows[:, 1] < 0.49 * rate_hz), 1]
        low = float(inside.min()) / 1.2 if inside.size else rate_hz / 1e3
        chart = stabilisation(roots, (low, rate_hz / 2), None)
        self.stable.show(replace(chart, caption=f"{chart.caption} A click takes that order of 'subspace'."))

    def _stood(self, at: dict[str, Any]) -> None:
        if at.get("y") is not None and self._stabilised:
            order = min(self._stabilised, key=lambda each: abs(each - at["y"]))
            self._take({"method": "subspace", "order": order}, "")

    def _picked(self, at: dict[str, Any]) -> None:
        if at.get("x") is not None and self._tried:
            order = min(TRIED, key=lambda each: abs(each - at["x"]))
            self._take({**self._tried, "order": order}, "")

    def _refresh(self) -> None:
        self._table()
        data, models = self.view.responding(), self.view.ready("models")
        asked = ([i.key for i in data], [i.key for i in models], self.view.scale, self.view.session.state["model"])
        if asked == self._drawn:
            return
        self._drawn = asked
        own = self._own_response()
        if own is not None:
            self._measured = own
            self._draw()
        elif data:
            names, settings = [item.name for item in data], {"estimator": "H1"}
            self._looker.ask("response", "frequency response", self._measure, names=names, settings=settings)
        else:
            self._draw()

    def _own_response(self) -> SeenResponse | None:
        """Return the response that the study's model was fitted to, unless records were clicked.

        Groups of periodic records each move a part of the band: none of them alone shows the whole.
        """
        name = self.view.session.state["model"]
        if "data" in self.view.params or name is None:
            return None
        item = self.view.session.item("models", name)
        if not item.ready or item.recipe.get("period_samples") is None:
            return None
        found = item.value(stored.RESPONSE)
        return SeenResponse(
            found.f_hz, found.values, found.coherence, found.variance, found.actuators, found.sensors, found.estimator
        )

    def _measure(self, _: Any, found: dict[str, Any]) -> None:
        self._measured = measured_of(self.view, found)
        self._draw()

    def _draw(self) -> None:
        models, colours = self.view.ready("models"), self.view.colours("models")
        systems = {item.name: item.value() for item in models}
        measured = self._measured
        if measured is None and not systems:
            return
        drawn = []
        for name, system in systems.items():
            f_hz = np.geomspace(system.rate_hz * 1e-4, 0.49 * system.rate_hz, POINTS)
            if measured is not None:
                f_hz = np.geomspace(measured.f_hz[measured.f_hz > 0][0], measured.f_hz[-1], POINTS)
            drawn.append(Modelled(name, f_hz, system.frequency_response(f_hz), colours[name]))
        if measured is not None:
            drawn = [m for m in drawn if m.values.shape[:2] == measured.values.shape[:2]]
        title = "Models over the measurement" if drawn else "Measured response"
        self.responses.show(response_grid(title, measured, drawn, self.view.scale))
        if systems:
            poles = {name: (system.poles(), colours[name]) for name, system in systems.items()}
            self.poles.show(pole_map("Poles", poles))
            self._draw_modes(systems)

    def _draw_modes(self, systems: dict[str, Any]) -> None:
        """Show the modes of the study's own model, else of the last that is shown."""
        own = self.view.session.state["model"]
        system = systems.get(own) or list(systems.values())[-1]
        if self._sketch is None and "bench" in self.view.session.state["tables"] and self._asks_bench:
            self._asks_bench = False
            self._shape.ask("describe", "bench", lambda found, _: self._sketched(found, systems))
        scene = mode_shapes(system, self.view.span(system), self._sketch)
        if scene is not None:
            self.modes.show(scene)

    def _sketched(self, found: dict[str, Any], systems: dict[str, Any]) -> None:
        if "sketch" in found:
            self._sketch = Sketch(**found["sketch"])
            self._draw_modes(systems)

    def _table(self) -> None:
        self._candidates.clear()
        session, names = self.view.session, list(self.view.session.state["models"])
        rows = [_row(session.item("models", name)) for name in names]
        chosen = session.state["model"]
        strong = names.index(chosen) if chosen in names else None
        with self._candidates:
            if not rows:
                words(NO_MODEL if session.state["data"] else NO_RECORD, "caption")
                return
            heading("Candidates; a click chooses the study's model")
            columns = ("model", "method", "from", "states", "fit %", "whiteness p", "status")
            table(columns, rows, "candidates", lambda k: doing(self.view, {"op": "choose", "model": names[k]}), strong)


def _order(method: dict[str, Any]) -> str:
    """Return the order that a method takes: what is given, its default, or that of the record.

    >>> _order({"method": "arx", "order": 4}), _order({"method": "box-jenkins"}), _order({"method": "subspace"})
    ('4', '5', 'auto')
    """
    default = next((one.default for one in settings_of("identify", method["method"]) if one.name == "order"), "")
    return str(method.get("order", default if default.isdigit() else "auto"))


def _row(item: Any) -> tuple[str, ...]:
    facts, recipe = item.facts, item.recipe
    fit = facts.get("plant", {}).get("fit_percent")
    fits = "" if fit is None else ", ".join(f"{f:.1f}" for f in fit[:4]) + (" …" if len(fit) > 4 else "")
    white = facts.get("whiteness_p")
    whites = "" if not white else chance(min(white))
    method = f"{recipe['method']['method']} {recipe['method'].get('order', '')}".strip()
    status = facts.get("status", "not made yet")
    return item.name, method, ", ".join(recipe["records"][:3]), str(facts.get("states", "")), fits, whites, status
