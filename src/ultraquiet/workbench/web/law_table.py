"""Laws side by side, and whether each does what is asked."""

from typing import Any

import numpy as np
from nicegui import ui

from ultraquiet._base.shown.line import loudness, opening, rounded
from ultraquiet.design.robustness import DISK_MARGIN
from ultraquiet.workbench.engine.items import Item
from ultraquiet.workbench.figures.loops import SensitivityDemand
from ultraquiet.workbench.web.controls import Doubted, button, chip, field, heading, loop_status, say, table, words
from ultraquiet.workbench.web.shell import doing, making
from ultraquiet.workbench.web.view import View

ASKED = {"attenuation_db": "quieter by (dB)", "peak_db": "peak at most (dB)", "disk_margin": "disk margin at least"}
UNBROKEN = "\u2011"  # a hyphen at which no line ends
COLUMNS = ("law", "method", "states", "quieter by", "peak of S", "disk in / out", "asked", "loop")


class LawTable:
    """The laws of the study with what their loops keep; a click on a row chooses one.

    Args:
        view: the page.
    """

    def __init__(self, view: View) -> None:
        self.view = view
        self._verdict = ui.element("div")
        self._place = ui.element("div")
        with ui.expansion("Requirements").props('dense data-testid="requirements"').classes("w-full"):
            self._form()
        view.watch(self._show)

    def _form(self) -> None:
        tables = self.view.session.state["tables"]
        asked, loop = tables.get("requirements", {}), tables.get("closed_loop", {})
        band = loop.get("band_hz") or ("", "")
        with ui.element("div").classes("uq-row"):
            self.low = field("over the band from (Hz)", "asked-low", str(band[0]), "the plant's own", "160px")
            self.high = field("to (Hz)", "asked-high", str(band[1]), "the plant's own", "120px")
            self.fields = {
                key: field(label, f"asked-{key.replace('_', '-')}", str(asked.get(key, "")), "not asked", "160px")
                for key, label in ASKED.items()
            }
            button("Ask for it", self._ask, "ask")

    def _ask(self) -> None:
        try:
            asked = {key: float(one.value) for key, one in self.fields.items() if one.value}
            band = [float(self.low.value), float(self.high.value)] if self.low.value and self.high.value else None
        except ValueError:
            say("requirements: write numbers, or leave a field empty to ask nothing.")
            return
        if band is not None and not 0 < band[0] < band[1]:
            say("requirements: the band must rise, and begin above zero.")
            return
        loop = {**self.view.session.state["tables"].get("closed_loop", {}), "band_hz": band}
        made = [item.name for item in self.view.session.items("laws") if item.ready]
        doing(self.view, {"op": "table", "table": "closed_loop", "values": {k: v for k, v in loop.items() if v}})
        doing(self.view, {"op": "table", "table": "requirements", "values": asked or None})
        for name in made:  # what each keeps over another band is found out anew
            if not self.view.session.item("laws", name).ready:
                making(self.view, "laws", name)

    def _show(self) -> None:
        laws = [item for item in self.view.session.items("laws") if item.ready]
        self._place.clear()
        self._verdict.clear()
        chosen = self.view.session.state["law"]
        with self._verdict:
            _headline(next((item for item in laws if item.name == chosen), None), self.view)
        with self._place:
            if not laws:
                words(_none_yet(self.view), "caption").props('data-testid="no-law"')
                return
            heading("Laws; a click chooses the study's")
            names = [item.name for item in laws]
            rows = [_row(item, self.view) for item in laws]
            strong = names.index(chosen) if chosen in names else None
            table(COLUMNS, rows, "laws", lambda k: doing(self.view, {"op": "choose", "law": names[k]}), strong)


def _none_yet(view: View) -> str:
    """Return what to do, or to wait for, where no law is made."""
    if asked := list(view.session.state["laws"]):
        return f"{', '.join(asked[:3])}: not made yet; what is at work stands above the log."
    if not view.session.state["models"]:
        return "No model yet: identify one first. Laws are designed for a model."
    return "No law yet: choose a method at the right and press Design."


def asked_of(view: View) -> SensitivityDemand:
    """Return what the study asks of |S|."""
    tables = view.session.state["tables"]
    asked, band = tables.get("requirements", {}), tables.get("closed_loop", {}).get("band_hz")
    return SensitivityDemand(tuple(band) if band else None, asked.get("attenuation_db"), asked.get("peak_db"))


def disk_asked(view: View) -> float:
    """Return the disk margin that the study asks of a loop, by default that of a verdict."""
    return float(view.session.state["tables"].get("requirements", {}).get("disk_margin", DISK_MARGIN))


def judged(facts: dict[str, Any], asked: dict[str, Any]) -> str:
    """Return whether a law's loop does what is asked, as a status.

    >>> judged({"attenuation_db": 12.0}, {"attenuation_db": 20.0})
    'short: quieter by 12.0 dB, quieter by 20 dB asked'
    >>> judged({}, {})
    ''
    """
    missed = []
    if (want := asked.get("attenuation_db")) is not None and facts["attenuation_db"] < want:
        missed.append(f"{loudness(facts['attenuation_db'])}, quieter by {want:g} dB asked")
    if (want := asked.get("peak_db")) is not None and not (facts["peaks"]["S"][0] or 1e9) <= want:
        missed.append(f"peak {facts['peaks']['S'][0]:.3g} dB, {want:g} allowed")
    for end in ("input", "output"):
        want, have = asked.get("disk_margin"), facts.get("margins", {}).get(end, {}).get("disk_all", 0.0)
        if want is not None and have < want:
            missed.append(f"disk margin {have:.2g} at the {end}, {want:g} asked")
    if missed:
        return f"short: {'; '.join(missed)}"
    return "ok: all that is asked" if asked else ""


def _quieter(by_db: float) -> str:
    """Return a cell below "quieter by".

    >>> _quieter(3.04), _quieter(-3.04), _quieter(-0.01)
    ('3.0 dB', 'louder by 3.0 dB', '0.0 dB')
    """
    said = loudness(by_db)
    return said if said.startswith("louder") else f"{rounded(abs(by_db))} dB"


def _row(item: Item, view: View) -> tuple[str | Doubted, ...]:
    facts = item.facts
    margins, peak = facts["margins"], facts["peaks"]["S"]
    quiet = "" if facts["attenuation_db"] is None else _quieter(facts["attenuation_db"])
    asked = judged(facts, view.session.state["tables"].get("requirements", {}))
    return (
        item.name,
        item.recipe["method"]["method"],
        str(facts["states"]),
        quiet,
        "infinite" if peak[0] is None else f"{peak[0]:.1f} dB at {peak[1]:.3g} Hz",
        f"{margins['input']['disk_all']:.2f} / {margins['output']['disk_all']:.2f}",
        loop_status(facts, asked) if asked else "nothing",
        loop_status(facts),
    )


def _own_band(item: Item) -> list[str]:
    """Return what a design says of the readings over the band that it was made for, and where that is not the judged.

    The worst direction of a plant of sharp modes hardly gets quieter where all that is read does.
    """
    details = item.facts["design"].get("details", {})
    fallen, band = details.get("attenuation_rms_db"), details.get("band_hz")
    if fallen is None or not band or item.recipe.get("reduce") is not None:
        return []
    own = f"{band[0]:.4g}{UNBROKEN}{band[1]:.4g} Hz"
    said = [f"What white disturbances at the inputs leave in all readings, {own}, is {loudness(fallen)} in rms."]
    if not np.allclose(band, item.facts["band_hz"], rtol=0.01):
        said.append(f"The law is made for {own}; to judge it over that band, name it in Requirements.")
    return said


def _headline(item: Item | None, view: View) -> None:
    if item is None:
        return
    facts = item.facts
    quiet, (low, high) = facts["attenuation_db"], facts["band_hz"]
    with ui.element("div").classes("uq-row"):
        if quiet is None or not facts["design"]["ok"]:
            text = f"{item.name}: {facts['status'].partition(':')[0]}"
        else:
            said = loudness(quiet)
            text = f"{opening(said)} in the worst direction, {low:.3g}{UNBROKEN}{high:.3g} Hz"
        ui.label(text).classes("uq-title-line").props('data-testid="headline"')
        asked = judged(facts, view.session.state["tables"].get("requirements", {}))
        chip(loop_status(facts, asked or None), "verdict")
    words(" ".join([f"{item.name}: {facts['status'].partition(': ')[2]}", *_own_band(item)]), "caption")
    if isinstance(loop_status(facts), Doubted):
        words(
            f"What it does to each output by itself stands on Closed loop. For less in the worst direction too, try a "
            f"band narrower than {low:.3g}{UNBROKEN}{high:.3g} Hz: at the right, for the design, and in Requirements, "
            "over which it is judged.",
            "caption",
        ).props('data-testid="next"')
