"""Design: a form for the method, what a hand moves seen at once, laws side by side over what is asked of them."""

from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.plot.pages.loops import margin_bars
from ultraquiet.workbench.engine.live import LiveLoop, Notched, Responses, live_loop, responses, weight_bound
from ultraquiet.workbench.figures.loops import Sizes, loop_grid, sizes_of
from ultraquiet.workbench.jobs.lane import WorkItem
from ultraquiet.workbench.web.chart import ChartElement
from ultraquiet.workbench.web.controls import button, choice, field, heading, say, words
from ultraquiet.workbench.web.law_table import LawTable, asked_of, disk_asked
from ultraquiet.workbench.web.method_form import MethodForm
from ultraquiet.workbench.web.shell import Columns, doing, making
from ultraquiet.workbench.web.view import Looker, View

MOVED = "by hand"
THROTTLE_S = 0.05
USUAL = "mixed-sensitivity"
ALONE = "none"


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Design(view, columns)


class _Design:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view, self._drawn = view, None
        self._known: dict[str, tuple[str, Responses]] = {}
        self._still: dict[str, tuple[LiveLoop, Sizes]] = {}
        self._names: dict[str, list[str]] = {}
        self._touched = False
        self._redrawn: tuple[str, str, str] | None = None  # a law that a hand replaces: its name, key and verdict
        self._looker, self._limit_of = Looker(view), ""
        self._asked: WorkItem | None = None
        self._looker.failed(self._tell_limit)
        with columns.main:
            self.table = LawTable(view)
            self.chart = ChartElement(view.frames, "loop-chart")
            self.margins = ChartElement(view.frames, "margins-chart")
            self._limit = words("", "caption").props('data-testid="limit"')
        with columns.side:
            self._settings()
            self._hands()
        view.watch(self._refresh)

    def _settings(self) -> None:
        heading("Design")
        models = list(self.view.session.state["models"])
        self.model = choice("for the model", models, "design-model", self.view.session.state["model"], lambda _: None)
        self.form = MethodForm("design", USUAL, lambda _: self._move())
        words(
            "Name the band that is to be quiet; a method that takes one takes the plant's whole range without it.",
            "caption",
        )
        laws = [ALONE, *self.view.session.state["laws"]]
        self.around = choice("put round the law", laws, "design-around", ALONE, lambda _: None)
        self.name = field("name of the law", "law-name", "", "the method")
        button("Design", self._design, "design", main=True)

    def _hands(self) -> None:
        heading("By hand")
        self._none_yet = words("Once there is a model, a hand can move the band, the gain and a notch here.", "caption")
        self._none_yet.props('data-testid="no-hands"')
        with ui.element("div").classes("uq-hands").props('data-testid="hands"') as self._by_hand:
            words(
                "Move a slider: S, T, KS and margins follow at once. Let go of the band and the law is made anew.",
                "caption",
            )
            self._put_sliders()
            words("The gain and the notch show what the law stands; they are not kept.", "caption")
        self._started = False
        self._start_sliders()

    def _put_sliders(self) -> None:
        self.sliders = {
            "low": _slider("band from (decades of Hz)", "band-low", -2, 4, 0.01, self._shape, self._let_go),
            "high": _slider("band to (decades of Hz)", "band-high", -2, 4, 0.01, self._shape, self._let_go),
            "height": _slider("height of the weight (dB)", "height", 0, 60, 0.5, self._shape, self._let_go),
            "gain": _slider("gain of the law (dB)", "gain", -20, 20, 0.1, self._move, None),
            "notch": _slider("notch at (decades of Hz)", "notch", -2, 4, 0.01, self._move, None),
            "depth": _slider("depth of the notch (dB)", "depth", 0, 60, 0.5, self._move, None),
        }

    def _start_sliders(self) -> None:
        """Put the sliders where the model's own band is, as soon as there is one."""
        if self._started:
            return
        name = self.view.session.state["model"]
        item = None if name is None else self.view.session.item("models", name)
        there = item is not None and item.ready
        self._by_hand.set_visibility(there)
        self._none_yet.set_visibility(not there)
        if item is None or not there:
            return
        self._started = True
        self._band = tuple(self.view.session.state["tables"].get("closed_loop", {}).get("band_hz") or ())
        made = next((law.facts.get("band_hz") for law in self.view.ready("laws")), None)
        low, high = self._band or made or even_plant(item.value(), who="workbench").band_hz
        for key, value in (
            ("low", np.log10(low)),
            ("high", np.log10(high)),
            ("height", 21.5),
            ("notch", np.log10(high)),
        ):
            self.sliders[key].set_value(round(float(value), 2))

    def _slid(self) -> dict[str, Any]:
        return {key: float(one.value or 0.0) for key, one in self.sliders.items()}

    def _design(self) -> None:
        made = self.form.table()
        if made is not None:
            self._take(made, str(self.name.value or made["method"]))

    def _take(self, method: dict[str, Any], name: str) -> None:
        if self.model.value is None:
            say("design: there is no model yet; identify one first.")
            return
        step = {"op": "design", "name": name, "model": self.model.value, "method": method, "reduce": None}
        step |= {} if self.around.value in (None, ALONE) else {"around": self.around.value}
        if doing(self.view, step):
            making(self.view, "laws", name)
            shown = [each for each in self.view.shown("laws") if each != name]
            self.view.set(laws=",".join([*shown, name][-8:]))

    def _let_go(self, *_: Any) -> None:
        """Make the law anew with the band where the hand has left it."""
        if not any(setting == "band_hz" for setting in self.form.names()):
            say(f"design: '{self.form.method}' has no band; choose a method that has one.", "warning")
            return
        at = self._slid()
        self.form.put("band_hz", sorted((10 ** at["low"], 10 ** at["high"])))
        if "height" in self.form.names():
            self.form.put("height", 10 ** (at["height"] / 20))
        self._note_redrawn(str(self.name.value or self.form.method))
        self._design()

    def _note_redrawn(self, name: str) -> None:
        """Remember a law that a hand is about to replace, and what its loop was judged."""
        if name in self.view.session.state["laws"]:
            item = self.view.session.item("laws", name)
            if item.ready:
                self._redrawn = (name, item.key, item.facts["status"].partition(":")[0])

    def _say_redrawn(self) -> None:
        """Say once that a law was replaced: one that was ok may not be any more."""
        if self._redrawn is None:
            return
        name, key, was = self._redrawn
        item = self.view.session.item("laws", name) if name in self.view.session.state["laws"] else None
        if item is None or item.key == key:  # it was taken back before it was made
            self._redrawn = None
        elif item.ready:
            self._redrawn = None
            now = item.facts["status"].partition(":")[0]
            turned = "" if now == was else f" and is {now} now, it was {was}"
            kind = "info" if now in (was, "ok") else "warning"
            say(
                f"{name} was made anew with the weight you drew{turned}; undo (Ctrl+Z) brings back the one before.",
                kind,
            )

    def _shape(self, *_: Any) -> None:
        """Show what a weight with this band would press S under."""
        self._touched = True
        self._move()

    def _move(self, *_: Any) -> None:
        """Show what a hand moves, from responses alone."""
        if self._known:
            self._draw()

    def _refresh(self) -> None:
        models = list(self.view.session.state["models"])
        if self.model.options != models:
            self.model.set_options(models, value=self.view.session.state["model"])
        inside = [ALONE, *self.view.session.state["laws"]]
        if self.around.options != inside:
            self.around.set_options(inside, value=self.around.value if self.around.value in inside else ALONE)
        self._start_sliders()
        self._say_redrawn()
        laws = self.view.ready("laws")
        chosen = self.view.session.state["law"]
        asked = ([item.key for item in laws], chosen, self.view.scale, str(self.view.session.state["tables"]))
        if asked == self._drawn:
            return
        self._drawn = asked
        for item in laws:
            known = self._known.get(item.name)
            if known is None or known[0] != item.key:
                plant = self.view.session.item("models", item.recipe["model"]).value()
                self._known[item.name] = (item.key, responses(plant, item.value()))
        self._known = {item.name: self._known[item.name] for item in laws}
        # while a hand moves, only what it moves is computed
        self._still = {name: _sized(live_loop(r.G, r.K, r.f_hz)) for name, (_, r) in self._known.items()}
        if laws:
            facts = self.view.session.item("models", laws[0].recipe["model"]).facts
            self._names = {"input": [c[0] for c in facts["actuators"]], "output": [c[0] for c in facts["sensors"]]}
        self._draw()
        self._ask_limit({item.name: item.key for item in laws})

    def _ask_limit(self, keys: dict[str, str]) -> None:
        """Ask how far the chosen law is from what any could do; its own process finds it out."""
        name = self._chosen()
        if name is None or keys[name] == self._limit_of:
            return
        self._limit_of = keys[name]
        self._tell_limit("the limit at its price is being found out ...")
        if self._asked is not None and not self._asked.over:
            self.view.jobs.cancel(self._asked)
        self._asked = self._looker.ask(
            "limit", f"limit of {name}", lambda _, found: self._tell_limit(str(found["words"])), law=name
        )

    def _tell_limit(self, sentence: str) -> None:
        self._limit.text = f"{self._chosen()} beside its limit: {sentence}"

    def _chosen(self) -> str | None:
        chosen = self.view.session.state["law"]
        return chosen if chosen in self._known else next(iter(self._known), None)

    def _draw(self) -> None:
        if not self._known:
            return
        colours = {**self.view.colours("laws"), MOVED: "law-5"}
        moved = self._moved()
        drawn = {**self._still, **({MOVED: _sized(moved)} if moved is not None else {})}
        shown = {name: loop for name, (loop, _) in drawn.items()}
        sizes = {name: size for name, (_, size) in drawn.items()}
        first = next(iter(self._known.values()))[1]
        asked = asked_of(self.view)
        figure = loop_grid("The loop, its worst direction", _caption(shown), sizes, colours, self.view.scale, asked,
                           self._bound(first), first.unit)  # fmt: skip
        self.chart.show(figure)
        self._draw_margins(shown, colours)

    def _draw_margins(self, shown: dict[str, LiveLoop], colours: dict[str, str]) -> None:
        ends = {end: {law: loop.channels[end] for law, loop in shown.items()} for end in self._names}
        self.margins.show(margin_bars(ends, self._names, colours, disk_asked(self.view)))

    def _moved(self) -> LiveLoop | None:
        at = self._slid()
        if not at["gain"] and not at["depth"]:
            return None
        name = self._chosen()
        if name is None:
            return None
        known = self._known[name][1]
        hand = Notched(at["gain"], [(10 ** at["notch"], 0.3, at["depth"])] if at["depth"] else [])
        return live_loop(known.G, known.K, known.f_hz, hand)

    def _bound(self, known: Responses) -> Sizes | None:
        if not self._touched or "height" not in self.form.names():
            return None
        at = self._slid()
        band = sorted((10 ** at["low"], 10 ** at["high"]))
        bound = weight_bound({"band_hz": band, "height": 10 ** (at["height"] / 20)}, known.f_hz)
        return None if bound is None else Sizes(known.f_hz, {"S": bound})


def _sized(loop: LiveLoop) -> tuple[LiveLoop, Sizes]:
    return loop, sizes_of(loop.f_hz, loop.S, loop.T, loop.KS)


def _slider(label: str, mark: str, low: float, high: float, step: float, move: Any, let_go: Any) -> ui.slider:
    with ui.element("div").style("width: 100%"):
        told = ui.label(label).classes("uq-meaning")
        made = ui.slider(min=low, max=high, step=step, value=0).props(f'dense data-testid="slide-{mark}"')
    plain = "decades" in label

    def tell() -> None:
        value = f"{10 ** (made.value or 0.0):.4g} Hz" if plain else f"{made.value:g} dB"
        told.text = f"{label.partition(' (')[0]}: {value}"

    made.on_value_change(tell)
    tell()
    made.on("update:model-value", move, throttle=THROTTLE_S, leading_events=True, trailing_events=True)
    if let_go is not None:
        made.on("change", let_go)
    return made


def _caption(loops: dict[str, LiveLoop]) -> str:
    said = [
        f"{name}: at most {loop.peak_db:.1f} dB louder in the directions that the inputs reach, at {loop.peak_hz:.4g} "
        f"Hz; disk margin of all channels at least {loop.disk['input']:.2f} at the input, {loop.disk['output']:.2f} at "
        "the output (bounds, found at once; the table has the margins themselves)"
        for name, loop in loops.items()
    ]
    return ". ".join(said)
