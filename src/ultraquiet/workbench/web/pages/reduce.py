"""Reduce: how many states a law needs: what each state carries, and what the loop loses without the others."""

from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.shown.line import counted, several_of
from ultraquiet.chart.spec import Axis, Chart, ChartPanel, Curve, Mark
from ultraquiet.linalg import balance
from ultraquiet.linalg.even import even_states
from ultraquiet.values import StateSpace
from ultraquiet.workbench.engine.live import live_loop, responses
from ultraquiet.workbench.figures.loops import loop_grid, sizes_of
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, choice, field, heading, loop_status, say, table, words
from ultraquiet.workbench.web.method_form import MethodForm
from ultraquiet.workbench.web.shell import Columns, doing, making
from ultraquiet.workbench.web.view import View

USUAL = "closed-loop-weighted"
MEANT = (
    "States: how many are kept. Without a number the fewest are kept that lose no more than loss (dB), of the peak of "
    "S, the band and the tones. Loss: by what share the norm of the closed loop may grow instead, a twentieth is 0.05. "
    "Budget: how many multiply-adds a step of the law may cost."
)
MORE = "Allow more loss, or write a smaller number of states."


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Reduce(view, columns)


class _Reduce:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view, self._drawn = view, None
        with columns.side:
            heading("Reduce")
            laws = list(view.session.state["laws"])
            self.law = choice("the law", laws, "reduce-law", view.session.state["law"], lambda _: self._refresh())
            self.form = MethodForm("reduce", USUAL, lambda _: self._tell())
            self._meaning = words(MEANT, "caption").props('data-testid="meant"')
            self.name = field("name of the new law", "reduced-name", "", "as the law, -small")
            button("Reduce", self._reduce, "reduce", main=True)
            words("A click on the chart of states writes the number of states into the form.", "caption")
            ui.link("Deploy", view.link("Deploy")).props('data-testid="to-deploy"')
        with columns.main:
            self._table = ui.element("div")
            self.states = ChartElement(view.frames, "hankel-chart", on_point=self._picked)
            self.loops = ChartElement(view.frames, "reduced-chart")
        view.watch(self._refresh)

    def _tell(self) -> None:
        self._meaning.set_visibility(self.form.method == USUAL)

    def _picked(self, at: dict[str, Any]) -> None:
        if at.get("x") is not None and "states" in self.form.names():
            self.form.put("states", max(1, round(at["x"])))

    def _reduce(self) -> None:
        made = self.form.table()
        if made is None or self.law.value is None:
            say("reduce: there is no law yet; design one first.")
            return
        recipe = self.view.session.state["laws"][self.law.value]
        name = str(self.name.value or f"{self.law.value}-small")
        step = {"op": "design", "name": name, "model": recipe["model"], "method": recipe["method"], "reduce": made}
        step |= {"around": recipe["around"]} if recipe.get("around") else {}
        if doing(self.view, step):
            making(self.view, "laws", name)
            shown = [each for each in self.view.shown("laws") if each != name]
            self.view.set(laws=",".join([*shown, name][-8:]))

    def _refresh(self) -> None:
        session = self.view.session
        laws = list(session.state["laws"])
        if self.law.options != laws:
            self.law.set_options(laws, value=self.law.value if self.law.value in laws else session.state["law"])
        ready = [item for item in session.items("laws") if item.ready]
        asked = ([item.key for item in ready], self.law.value, self.view.scale)
        if asked == self._drawn:
            return
        self._drawn = asked
        self._list(ready)
        shown = [item for item in ready if item.name in self.view.shown("laws")]
        if shown:
            self._loops(shown)
        if self.law.value in [item.name for item in ready]:
            self._hankel(session.item("laws", self.law.value).value())

    def _list(self, ready: list[Any]) -> None:
        self._table.clear()
        with self._table:
            if not ready:
                words("No law yet: design one first.", "caption")
                return
            rows, whole = [], []
            for item in ready:
                cut = (item.facts["design"].get("reduction") or {}).get("from_states")
                if cut == item.facts["states"]:
                    whole.append(item.name)
                peak = item.facts["peaks"]["S"][0]
                size = f"{item.facts['states']}" + (f" of {cut}" if cut else "")
                shown = "infinite" if peak is None else f"{peak:.1f} dB"
                disks = [f"{item.facts['margins'][end]['disk_all']:.2f}" for end in ("input", "output")]
                rows.append((item.name, size, shown, *disks, loop_status(item.facts)))
            table(("law", "states", "peak of S", "disk, input", "disk, output", "loop"), rows, "reduced")
            if whole:
                words(f"{', '.join(whole)}: no state is left out, so nothing is gained. {MORE}", "doubt").props(
                    'data-testid="nothing-gained"'
                )

    def _hankel(self, law: StateSpace) -> None:
        try:
            values = hankel_values(law)
        except (UltraquietError, np.linalg.LinAlgError):
            return
        if not values.any():
            return
        some = values[values > 0.0]  # of a logarithmic axis
        x = np.arange(1, some.size + 1, dtype=float)
        curve = Curve("Hankel values", x, some / some[0], "chosen", kind="points")
        marks = [Mark("a thousandth", y=1e-3)]
        axes = Axis("state", ticks="int"), Axis("of the largest (1)", "log")
        panel = ChartPanel(*axes, [curve], marks=marks, height=220)
        few = int(np.count_nonzero(values > 1e-3 * values[0]))
        kind = "" if values.size == law.states else "stable "
        most = "more than a thousandth of the largest"
        caption = f"{few} of {counted(values.size, f'{kind}state')} {several_of(few, 'carries', 'carry')} {most}."
        self.states.show(Chart("hankel", "What each state of the law carries", caption, [panel], legend="none"))

    def _loops(self, shown: list[Any]) -> None:
        sizes, unit = {}, ""
        for item in shown:
            plant = self.view.session.item("models", item.recipe["model"]).value()
            known = responses(plant, item.value())
            loop = live_loop(known.G, known.K, known.f_hz)
            sizes[item.name], unit = sizes_of(loop.f_hz, loop.S, loop.T, loop.KS), known.unit
        colours = self.view.colours("laws")
        self.loops.show(loop_grid("The loops side by side", "", sizes, colours, self.view.scale, unit=unit))


def hankel_values(law: StateSpace) -> np.ndarray:
    """Return the Hankel singular values of the stable part of a law, one a state, the largest first, scaled evenly."""
    A, B, C, _ = even_states(law.A, law.B, law.C)
    discrete = law.rate_hz is not None
    T, inverse, stable = balance.stable_first(A, discrete, balance.BOUNDARY)
    inner = (inverse @ A @ T)[:stable, :stable]
    R, L = balance.gramian_factors(inner, (inverse @ B)[:stable], (C @ T)[:, :stable], discrete)
    values = np.linalg.svd(L.T @ R, compute_uv=False)
    return np.pad(values, (0, stable - values.size))  # factors leave away what is not reached or not seen at all
