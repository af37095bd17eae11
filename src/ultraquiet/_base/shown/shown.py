"""What every object of this package can do to be looked at."""

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any, cast

from ultraquiet._base.shown.card import card
from ultraquiet._base.shown.drawing import drawn, figure_of
from ultraquiet._base.shown.line import line


class Shown:
    """A base for what people look at: `repr` on one line with the status, a card for notebooks, `plot`."""

    __slots__ = ()

    def __init_subclass__(cls, **further: Any) -> None:
        super().__init_subclass__(**further)
        # A dataclass writes its own repr unless its class has one: it must stand there before the decorator looks.
        if "__repr__" not in vars(cls):
            cls.__repr__ = Shown.__repr__

    def __repr__(self) -> str:
        return line(self)

    def _repr_html_(self) -> str:
        return card(self)

    def plot(self, ax: Any = None) -> Any:
        """Draw with matplotlib, loaded only now.

        Args:
            ax: matplotlib axes to draw on, one a panel; a new figure when absent.

        Returns:
            The axes, one or an array of them, with names, units and confidence where it is known.

        Raises:
            InputError: fewer axes than panels.
        """
        return drawn(figure_of(self), ax)


SHOWN = ("__repr__", "_repr_html_", "plot")


def show(room: Mapping[str, Any], names: Iterable[str]) -> None:
    """Let the classes that a room exports show themselves as `Shown` does; a room's door calls this once.

    What a class says itself stays, unless a dataclass wrote it; protocols, errors and enumerations are left alone.
    """
    for name in names:
        kind: Any = room[name]
        if not isinstance(kind, type) or issubclass(cast("type[Any]", kind), Enum | BaseException | Shown):
            continue
        own: dict[str, Any] = dict(vars(cast("type[Any]", kind)))
        if getattr(kind, "_is_protocol", False):
            continue
        for verb in SHOWN:
            written = own.get(verb)
            by_hand = written is not None and not _by_dataclass(kind, verb)
            if not by_hand and not (verb == "plot" and hasattr(kind, "plot")):
                setattr(kind, verb, getattr(Shown, verb))


def _by_dataclass(kind: type[Any], verb: str) -> bool:
    """Return whether `dataclass` or `NamedTuple` wrote a repr, nobody by hand."""
    params = getattr(kind, "__dataclass_params__", None)
    return verb == "__repr__" and (bool(getattr(params, "repr", False)) or issubclass(kind, tuple))
