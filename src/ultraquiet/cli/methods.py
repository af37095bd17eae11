"""`ultraquiet methods`: what is registered, with settings and defaults."""

from dataclasses import MISSING, fields
from typing import Annotated

import typer

from ultraquiet._base import registry
from ultraquiet._base.errors import UnknownMethodError
from ultraquiet.cli.output.screen import screen
from ultraquiet.cli.output.text_table import TextTable


def methods(
    family: Annotated[str | None, typer.Argument(help="One family: signals, bench, identify, design, reduce.")] = None,
) -> None:
    """List every registered method with its settings and their defaults."""
    if family is not None and family not in registry.FAMILIES:
        raise UnknownMethodError(f"methods: there is no family '{family}', only {', '.join(registry.FAMILIES)}.")
    grid = TextTable(("family", "method", "settings", "what it does"))
    for name in [family] if family else registry.FAMILIES:
        for method, kind in registry.methods(name).items():
            settings = ", ".join(_setting(f) for f in fields(kind))
            grid.add(name, method, settings, (kind.__doc__ or "").split("\n")[0])
    screen().table(grid)
    screen().result(grid.records())


def _setting(field: object) -> str:
    name, default = getattr(field, "name"), getattr(field, "default")  # noqa: B009  typed access to dataclasses.Field
    return name if default is MISSING or default is None else f"{name}={typed(default)}"


def typed(value: object) -> str:
    """Return a default as `--set` and a study file take it; one that is found out from the data stands without value.

    >>> typed(True), typed((1.0, None)), typed("lqg")
    ('true', '[1.0, -]', "'lqg'")
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(typed, value))}]"
    return "-" if value is None else repr(value)
