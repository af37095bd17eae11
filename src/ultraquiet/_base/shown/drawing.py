"""Who draws what: the room of plots enters its figures here, and is loaded by name when the first is asked for."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

FIGURES, AXES = "ultraquiet.plot.objects", "ultraquiet.plot.axes"

_table: dict[type[Any], Callable[[Any], Any]] = {}

Drawer = TypeVar("Drawer", bound=Callable[[Any], Any])


def draws(*kinds: type[Any]) -> Callable[[Drawer], Drawer]:
    """Enter a function from an object of these classes (or theirs) to a figure as data."""

    def enter(drawer: Drawer) -> Drawer:
        _table.update(dict.fromkeys(kinds, drawer))
        return drawer

    return enter


def figure_of(shown: object) -> Any:
    """Return the figure of an object as data (`plot.Figure`): that of its class, or of the nearest base that has one.

    As methods are entered in the registry and found by name, so are figures: whoever makes values knows no picture.
    """
    import_module(FIGURES)
    return next(_table[kind] for kind in type(shown).__mro__ if kind in _table)(shown)


def drawn(figure: Any, ax: Any = None) -> Any:
    """Return the matplotlib axes that a figure was drawn on."""
    return import_module(AXES).draw_axes(figure, ax)
