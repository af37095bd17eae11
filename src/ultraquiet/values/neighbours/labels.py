"""Channels as labels, as rows of a table, and back."""

import re
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any

from ultraquiet._base.errors import ToolError
from ultraquiet.values.channel import Channel

DOT, STANDS_FOR = "\u2024", "."  # python-control keeps the full stop for itself
LABEL = re.compile(r"(.*?)(?: \[([^\[\]]*)\])?(?: #\d+)?", re.DOTALL)
FIELDS = ("name", "unit", "low", "high")


def needed(package: str) -> Any:
    """Return a package that is not among this one's own dependencies.

    Raises:
        ToolError: it is not installed.
    """
    try:
        return import_module(package)
    except ImportError:
        raise ToolError(f"values: this takes the package '{package}'; install it with: pip install {package}") from None


def labels(wires: Sequence[Channel]) -> list[str]:
    """Return `name [unit]` for each channel, with ` #k` behind one that stands there already.

    >>> labels([Channel("strut 1.2", "N"), Channel("strut 1.2", "N")])
    ['strut 1․2 [N]', 'strut 1․2 [N] #2']
    """
    out: list[str] = []
    for k, c in enumerate(wires):
        text = f"{c.name} [{c.unit}]".replace(STANDS_FOR, DOT)
        out.append(text if text not in out else f"{text} #{k + 1}")
    return out


def channels_of(texts: Iterable[str] | None) -> list[Channel] | None:
    """Return the channels of labels; one without a unit has none.

    >>> channels_of(labels([Channel("strut 1.2", "N")])) == [Channel("strut 1.2", "N")], channels_of(["u[0]"])
    (True, [Channel(name='u[0]')])
    """
    if texts is None:
        return None
    out: list[Channel] = []
    for each in texts:
        found = LABEL.fullmatch(str(each).replace(DOT, STANDS_FOR))
        name, unit = found.groups() if found else (str(each), None)
        out.append(Channel(name, unit or ""))
    return out


def rows(wires: Sequence[Channel]) -> list[tuple[str, str, float, float]]:
    """Return name, unit and limits of each channel."""
    return [(c.name, c.unit, c.low, c.high) for c in wires]


def channels_from(table: Iterable[Sequence[Any]]) -> list[Channel]:
    """Return the channels of such rows."""
    return [Channel(str(name), str(unit), float(low), float(high)) for name, unit, low, high in table]
