"""Deploy: a law as C99, compiled, proved against its twin, and handed over."""

import io
import zipfile
from typing import Any, get_args

from nicegui import ui

from ultraquiet.deploy.figures import said
from ultraquiet.pipeline.tables.code import Deploy
from ultraquiet.workbench.engine.items import Item
from ultraquiet.workbench.engine.making.work import CODE
from ultraquiet.workbench.web.controls import button, chip, choice, field, heading, table, words
from ultraquiet.workbench.web.shell import Columns, doing, making, say
from ultraquiet.workbench.web.view import View

PRECISIONS = get_args(Deploy.model_fields["precision"].annotation)
SHOWN = (
    "states",
    "form",
    "precision",
    "flash_bytes",
    "ram_bytes",
    "cortex_m7_instructions",
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
        self.precision = choice("precision", PRECISIONS, "precision", precision, lambda _: None)
        self.limits = field("largest command", "limits", str(table_.get("limits", "")), "the actuators' own")
        words("In the actuators' unit; without limits of their own, the largest that the records hold.", "caption")
        self.range = field("largest reading", "range", str(table_.get("range", "")), "the sensors' own")
        words("For whole numbers, q31 and q15, in the sensors' unit.", "caption")
        button("Generate and prove", self._deploy, "deploy", main=True)

    def _deploy(self) -> None:
        if self.law.value is None:
            say("deploy: there is no law yet; design one first.")
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
        if values != {"precision": "float32"} or "deploy" in self.view.session.state["tables"]:
            doing(self.view, {"op": "table", "table": "deploy", "values": values})
        if doing(self.view, {"op": "deploy", "law": self.law.value}):
            making(self.view, "codes", self.law.value)
            self.view.set(codes=self.law.value)

    def _sizes(self) -> dict[str, ui.input]:
        return {"limits": self.limits, "range": self.range}

    def _show(self) -> None:
        laws = list(self.view.session.state["laws"])
        if self.law.options != laws:
            self.law.set_options(laws, value=self.view.session.state["law"])
        self._place.clear()
        with self._place:
            items = [item for item in self.view.session.items("codes") if item.ready]
            if not items:
                words("No code yet: choose a law at the right and press Generate.", "caption")
            for item in items:
                self._code(item)

    def _code(self, item: Item) -> None:
        facts = item.facts
        with ui.element("section").props(f'data-testid="code-{item.name}"'):
            with ui.element("div").classes("uq-row"):
                ui.label(f"{item.name} as C99").classes("uq-title-line")
                chip(facts["status"], f"proof-{item.name}")
            words(facts["status"].partition(": ")[2], "caption")
            rows = said({key: facts["code"][key] for key in SHOWN if key in facts["code"]})
            rows.append(("commands end at", ", ".join(f"{low:.4g} to {high:.4g}" for low, high in facts["limits"][:6])))
            table(("figure", "value"), rows, f"figures-{item.name}")
            button("Download (zip)", lambda: _download(item), f"download-{item.name}")
            heading("Files")
            for path in sorted((item.folder / CODE).rglob("*")):
                if path.is_file():
                    name = path.relative_to(self.view.session.folder)
                    ui.link(str(path.relative_to(item.folder / CODE)), f"/study/{name}").classes("uq-words caption")
                    ui.element("br")


def _download(item: Item) -> None:
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted((item.folder / CODE).rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(item.folder / CODE))
    ui.download.content(memory.getvalue(), f"{item.name}.zip")
