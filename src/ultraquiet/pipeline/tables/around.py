"""Laws of a study that are put round one another."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Protocol

from ultraquiet._base.mistakes import Mistakes
from ultraquiet._base.registry import lookup
from ultraquiet._base.tables import Method


class PutRound(Protocol):
    """`[controllers.NAME]`."""

    @property
    def design(self) -> Method:
        """How the law is designed."""
        ...

    @property
    def around(self) -> str | None:
        """The name of the law inside."""
        ...


Controllers = Mapping[str, PutRound]


def inside(controllers: Controllers, name: str) -> list[str]:
    """Return a law and those that stand inside it, outermost first; a circle is gone through once."""
    found: list[str] = []
    while name in controllers and name not in found:
        found.append(name)
        name = controllers[name].around or ""
    return found


def check_around(controllers: Controllers, mistakes: Mistakes) -> None:
    """Note laws put round what is no other law, and designs that are put round none."""
    for name, table in controllers.items():
        if table.around is None:
            continue
        fault = ""
        if table.around not in controllers:
            fault = f"there is no law '{table.around}' among the controllers {', '.join(controllers)}."
        elif name in inside(controllers, table.around):
            fault = f"'{table.around}' is put round '{name}' in turn; one of them must stand alone."
        elif "around" not in {field.name for field in fields(lookup("design", table.design.method))}:
            fault = f"'{table.design.method}' is put round no other law; leave it away."
        elif "around" in table.design.settings:
            fault = "the design's own 'around' says something else; give one of them."
        if fault:
            mistakes.add(("controllers", name, "around"), f"controllers.{name}.around: {fault}")
