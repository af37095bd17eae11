"""`--order`: a number, or what the record itself says."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import lookup
from ultraquiet.cli.settings import method as make
from ultraquiet.identify.searched_order import AUTO, SearchedOrder


def of_order(name: str, assignments: Sequence[str], order: str | None) -> Any:
    """Return the settings of a method with the order that was asked for; `auto` leaves it to the record.

    Raises:
        InputError: neither a number nor `auto`; a method that has no order, or none to be chosen.
    """
    if order != AUTO:
        return make("identify", name, assignments, order=None if order is None else _number(order))
    kind = lookup("identify", name)
    if not issubclass(kind, SearchedOrder):
        has_one = any(field.name == "order" for field in fields(kind))
        what = "does not choose its order" if has_one else "has no order"
        remedy = "give --order a number" if has_one else "leave --order away"
        raise InputError(f"identify: '{name}' {what}; {remedy}.")
    return make("identify", name, assignments, order=AUTO)


def chooses(settings: Any) -> bool:
    """Return whether a method with these settings looks for its order itself, on the whole record it is given."""
    return isinstance(settings, SearchedOrder) and settings.given_order is None


def found_order(settings: Any, result: Any) -> int | None:
    """Return the order that a model came to; None for a method without one."""
    order = getattr(settings, "order", None)
    return order if order is not None else getattr(result, "details", {}).get("order", getattr(result, "order", None))


def _number(order: str) -> int:
    try:
        return int(order)
    except ValueError:
        raise InputError(f"identify: '--order' must be a whole number or '{AUTO}', got '{order}'.") from None
