"""`--order`: a number, or what a part of the record that is kept back prefers."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from ultraquiet._base.errors import InputError
from ultraquiet.cli.settings import method as make

if TYPE_CHECKING:
    from ultraquiet.values import Record

AUTO = "auto"


def of_order(name: str, assignments: Sequence[str], order: str | None, record: "Record") -> Any:
    """Return the settings of a method with the order that was asked for; `auto` asks the record.

    Raises:
        InputError: neither a number nor `auto`; a method that has no order, or none to be chosen.
    """
    if order != AUTO:
        return make("identify", name, assignments, order=None if order is None else _number(order))
    from ultraquiet.identify.polynomial.methods import PolynomialMethod
    from ultraquiet.identify.polynomial.order_selection import chosen_order

    settings = make("identify", name, assignments)
    order_field = next((f for f in fields(settings) if f.name == "order"), None)
    if isinstance(settings, PolynomialMethod):
        return replace(settings, order=chosen_order(settings, record))
    if order_field is not None and "None" in str(order_field.type):
        return replace(settings, order=None)  # it looks for the order itself
    what = "has no order" if order_field is None else "does not choose its order"
    remedy = "leave --order away" if order_field is None else "give --order a number"
    raise InputError(f"identify: '{name}' {what}; {remedy}.")


def found_order(settings: Any, result: Any) -> int | None:
    """Return the order that a model came to; None for a method without one."""
    order = getattr(settings, "order", None)
    return order if order is not None else getattr(result, "details", {}).get("order", getattr(result, "order", None))


def _number(order: str) -> int:
    try:
        return int(order)
    except ValueError:
        raise InputError(f"identify: '--order' must be a whole number or '{AUTO}', got '{order}'.") from None
