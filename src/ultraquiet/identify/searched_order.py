"""Orders that a method looks for itself, `"auto"` or None, and those that nobody asked for."""

from typing import Any, Literal

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError

AUTO = "auto"
Auto = Literal["auto"]


class Unasked(int):
    """The number that is taken where nobody gives one: equal to the same number given, and told apart from it.

    >>> Unasked(5) == 5, isinstance(Unasked(5), int), isinstance(5, Unasked)
    (True, True, False)
    """

    __slots__ = ()


class SearchedOrder:
    """What methods share whose `order` may be left to the record.

    The word and None mean one thing, so settings hold None: what is equal has one hash.
    """

    def settle_order(self, highest: int | None = None) -> None:
        """Take `order="auto"` for None; for `__post_init__`, before anything looks at it.

        Raises:
            InputError: the order is neither left to the record nor a whole number from one to `highest`.
        """
        who = type(self).__name__
        if isinstance(self._order, str) and self._order == AUTO:
            object.__setattr__(self, "order", None)
        elif isinstance(self._order, str):
            raise InputError(f"{who}: 'order' must be a whole number or '{AUTO}', got {self._order!r}.")
        elif self._order is not None:
            whole(who, "order", self._order, 1, highest)

    @property
    def given_order(self) -> int | None:
        """The order that was asked for, None where the record is to say."""
        return self._order

    @property
    def _order(self) -> Any:
        return getattr(self, "order")  # noqa: B009 - the field is the method's own
