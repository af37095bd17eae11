"""Deploy: a law as C99, compiled, proved against its twin, and handed over."""

import io
import zipfile
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from nicegui import ui

from ultraquiet.deploy.figures import said
from ultraquiet.deploy.fixed_point.law import WORDS
from ultraquiet.pipeline.tables.code import Deploy
from ultraquiet.workbench.engine.items import Item
from ultraquiet.workbench.engine.making.work import CODE
from ultraquiet.workbench.web.controls import button, chip, choice, field, heading, say, table, words
from ultraquiet.workbench.web.shell import Columns, doing, making
from ultraquiet.workbench.web.view import View

NOT_MADE = (
    "The code of {} is not made with these settings: press Generate and prove. Where that was refused, "
    "the log below says why."
)
PRECISIONS = get_args(Deploy.model_fields["precision"].annotation)
SHOWN = (
    "states",
    "form",
    "precision",
    "flash_bytes",
    "ram_bytes",
    "instructions_on",
    "bit_exact",
    "response_error",
    "state_bound",
    "noise_v",
    "multiply_adds",
)


def build(view: View, columns: Columns) -> None:
    """Build the page."""
    _Deploy(view, columns)


class _Deploy:
    def __init__(self, view: View, columns: Columns) -> None:
        self.view = view
        with columns.side:
            self._settings()
        with columns.main:
            self._place = ui.element("div").classes("uq-figures")
        view.watch(self._show)

    def _settings(self) -> None:
        state = self.view.session.state
        table_ = state["tables"].get("deploy", {})
        heading("Deploy")
        self.law = choice("the law", list(state["laws"]), "deploy-law", state["law"], lambda _: None)
        precision = table_.get("precision", "float32")
        self.precision = choice("number format", PRECISIONS, "precision", precision, self._of_format)
        self.limits = field("largest command", "limits", str(table_.get("limits", "")), "the actuators' own")
        words("In the actuators' unit; without limits of their own, the largest that the records hold.", "caption")
        self.range = field("largest reading", "range", str(table_.get("range", "")), "the sensors' own")
        words("In the sensors' unit, for whole numbers: q31 of 32 bits, q15 of 16.", "caption").bind_visibility_from(
            self.range
        )
        self._of_format(precision)
        button("Generate and prove", self._deploy, "deploy", main=True)

    def _of_format(self, precision: str) -> None:
        """Ask for the largest reading where the format is of whole numbers; others take any."""
        self.range.set_visibility(precision in WORDS)

    def _deploy(self) -> None:
        if self.law.value is None:
            say("deploy: there is no law yet; design one first.")
            return
        if self.precision.value in WORDS and not self.range.value and (bare := self._without_limits()):
            names, have = (", ".join(bare[:3]) + (" ..." if len(bare) > 3 else ""), "have" if bare[1:] else "has")
            say(f"deploy: whole numbers need the largest reading, and {names} {have} no limits; write it in its field.")
            return
        # What a study file says of the code beside these stays.
        kept = self.view.session.state["tables"].get("deploy", {})
        values: dict[str, Any] = {key: value for key, value in kept.items() if key not in ("limits", "range")}
        values["precision"] = self.precision.value
        try:
            values |= {key: float(size.value) for key, size in self._sizes().items() if size.value}
        except ValueError:
            say("deploy: write the largest command and the largest reading as numbers.")
            return
        differs = values != {"precision": "float32"} or "deploy" in self.view.session.state["tables"]
        if differs and not doing(self.view, {"op": "table", "table": "deploy", "values": values}):
            return
        if doing(self.view, {"op": "deploy", "law": self.law.value}):
            making(self.view, "codes", self.law.value)
            self.view.set(codes=self.law.value)

    def _without_limits(self) -> list[str]:
        """Return the sensors of the law's model of which nobody has said how far they go."""
        session = self.view.session
        item = session.item("models", session.state["laws"][self.law.value]["model"])
        if not item.ready:
            return []
        return [c.name for c in item.value().sensors if not np.isfinite([c.low, c.high]).all()]

    def _sizes(self) -> dict[str, ui.input]:
        return {"limits": self.limits} | ({"range": self.range} if self.precision.value in WORDS else {})

    def _show(self) -> None:
        laws = list(self.view.session.state["laws"])
        if self.law.options != laws:
            self.law.set_options(laws, value=self.view.session.state["law"])
        self._place.clear()
        with self._place:
            items = self.view.session.items("codes")
            if not items:
                todo = "choose a law at the right and press Generate and prove." if laws else "design a law first."
                words(f"No code yet: {todo}", "caption")
            for item in items:
                if item.ready:
                    self._code(item)
                else:
                    words(NOT_MADE.format(item.name), "doubt").props(f'data-testid="not-made-{item.name}"')

    def _ends(self, item: Item) -> list[str]:
        session = self.view.session
        law = session.state["laws"].get(item.name)
        model = {} if law is None else session.item("models", law["model"]).facts
        limits = item.facts["limits"]
        return ends_of(limits, model.get("actuators") or [(f"command {k + 1}", "") for k in range(len(limits))])

    def _code(self, item: Item) -> None:
        facts = item.facts
        with ui.element("section").props(f'data-testid="code-{item.name}"'):
            with ui.element("div").classes("uq-row"):
                ui.label(f"{item.name} as C99").classes("uq-title-line")
                chip(facts["status"], f"proof-{item.name}")
            words(facts["status"].partition(": ")[2], "caption")
            rows = said({key: facts["code"][key] for key in SHOWN if key in facts["code"]})
            rows += [("commands end at", each) for each in self._ends(item)]
            table(("figure", "value"), rows, f"figures-{item.name}")
            button("Download (zip)", lambda: _download(item), f"download-{item.name}")
            heading("Files")
            for path in sorted((item.folder / CODE).rglob("*")):
                if path.is_file():
                    name = path.relative_to(self.view.session.folder)
                    ui.link(str(path.relative_to(item.folder / CODE)), f"/study/{name}").classes("uq-words caption")
                    ui.element("br")


def ends_of(limits: Sequence[tuple[float, float]], actuators: Sequence[tuple[str, str]]) -> list[str]:
    """Return where the commands of each actuator end, in its unit, those that end alike together.

    >>> ends_of([(-2.0, 2.0), (-2.0, 2.0), (-100.0, 100.0)], [("left", "A"), ("right", "A"), ("stack", "V")])
    ['-2 to 2 A (left, right)', '-100 to 100 V (stack)']
    """
    groups: dict[str, list[str]] = {}
    for (low, high), (name, unit) in zip(limits, actuators, strict=True):
        groups.setdefault(f"{low:.4g} to {high:.4g} {unit}".strip(), []).append(name)
    return [f"{span} ({', '.join(names[:6])}{' ...' if names[6:] else ''})" for span, names in groups.items()]


def _download(item: Item) -> None:
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted((item.folder / CODE).rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(item.folder / CODE))
    ui.download.content(memory.getvalue(), f"{item.name}.zip")
