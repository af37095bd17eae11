"""A form for one of a family's methods, made of the registry: what each setting is, its unit, range and meaning."""

from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from ultraquiet.workbench.engine.forms import Setting, entered, offered, settings_of
from ultraquiet.workbench.web.controls import choice, explained, say

FEW = 6
CHOSEN = {"bench": "bench", "signals": "signal"}  # as it is called where there is more than one form; else the method


class MethodForm:
    """A choice of a method and the fields of its settings; empty fields stand for the defaults.

    Args:
        family: of the registry.
        method: which is shown first.
        changed: called after every change with the table as it is.
        values: what stands in the fields first.
        names: methods that are offered; all of the family when absent.
    """

    def __init__(
        self,
        family: str,
        method: str,
        changed: Callable[[dict[str, Any]], object] | None = None,
        values: Mapping[str, Any] | None = None,
        names: list[str] | None = None,
    ) -> None:
        self.family, self.method, self._changed = family, method, changed
        self._fields: dict[str, Any] = {}
        known = offered(family)
        choice(CHOSEN.get(family, "method"), names or list(known), f"{family}-method", method, self._choose)
        self._told = ui.label(known[method]).classes("uq-meaning")
        self._place = ui.element("div").style("width: 100%")
        self._build(values or {})

    @property
    def texts(self) -> dict[str, Any]:
        """What stands in the fields that differ from the defaults."""
        given: dict[str, Any] = {}
        for setting, made in self._fields.values():
            value = made.value
            if setting.kind == "flag":
                if str(bool(value)) != setting.default:
                    given[setting.name] = bool(value)
            elif value not in (None, "") and str(value) != setting.default:
                given[setting.name] = value
        return given

    def table(self) -> dict[str, Any] | None:
        """Return the method's table; None where a field will not do, which then says why."""
        made, faults = entered(self.family, self.method, self.texts)
        for name, (_, control) in self._fields.items():
            if hasattr(control, "error"):
                control.error = faults.get(name)
        if "" in faults:
            say(faults[""])
        return None if faults else made

    def names(self) -> list[str]:
        """Return the settings that the form has."""
        return list(self._fields)

    def put(self, name: str, value: Any) -> None:
        """Write a value into a field."""
        text = ", ".join(f"{v:.4g}" for v in value) if isinstance(value, list | tuple) else f"{value:.4g}"
        self._fields[name][1].value = text

    def _choose(self, name: str) -> None:
        self.method = name
        self._told.text = offered(self.family)[name]
        self._build({})
        self._say()

    def _build(self, values: Mapping[str, Any]) -> None:
        self._place.clear()
        self._fields = {}
        settings = settings_of(self.family, self.method)
        first, rest = settings[:FEW], settings[FEW:]
        with self._place:
            with ui.element("div").classes("uq-form"):
                for k, setting in enumerate(first):
                    self._add(setting, values, k % 2)
            if rest:
                with (
                    ui.expansion(f"{len(rest)} more settings")
                    .props(f'dense data-testid="{self.family}-more"')
                    .classes("w-full"),
                    ui.element("div").classes("uq-form"),
                ):
                    for k, setting in enumerate(rest):
                        self._add(setting, values, k % 2)

    def _add(self, setting: Setting, values: Mapping[str, Any], column: int) -> None:
        mark = f"{self.family}-{'variant' if setting.name == 'method' else setting.name.replace('_', '-')}"
        value = values.get(setting.name)
        if setting.kind == "flag":
            start = setting.default == "True" if value is None else bool(value)
            made: Any = ui.switch(setting.label, value=start, on_change=self._say)
            made.props(f'dense data-testid="{mark}"')
        elif setting.kind == "choice":
            made = choice(setting.label, setting.choices, mark, value or setting.default, lambda _: self._say())
        else:
            text = "" if value is None else ", ".join(map(str, value)) if isinstance(value, list) else str(value)
            made = ui.input(setting.label, value=text, placeholder=setting.default, on_change=self._say)
            made.props(f'dense outlined stack-label hide-bottom-space debounce="300" data-testid="{mark}"')
        told = [setting.meaning, f"Range: {setting.allowed}." if setting.allowed else ""]
        told.append(f"Default: {setting.default}." if setting.default else "")
        explained(made, " ".join(filter(None, told)), column)
        self._fields[setting.name] = (setting, made)

    def _say(self, *_: Any) -> None:
        made, faults = entered(self.family, self.method, self.texts)
        for name, (_, control) in self._fields.items():
            if hasattr(control, "error"):
                control.error = faults.get(name)
        if self._changed is not None and not faults:
            self._changed(made)
