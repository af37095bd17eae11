"""An order that a method looks for itself: `"auto"`, or None."""

from typing import Any, Literal

AUTO = "auto"
Auto = Literal["auto"]


class SearchedOrder:
    """What methods share whose `order` may be left to the record.

    The word and None mean one thing, so settings hold None: what is equal has one hash.
    """

    def settle_order(self) -> None:
        """Take `order="auto"` for None; for `__post_init__`, before anything looks at it."""
        if getattr(self, "order") == AUTO:  # noqa: B009 - the field is the method's own
            object.__setattr__(self, "order", None)

    @property
    def given_order(self) -> int | None:
        """The order that was asked for, None where the record is to say."""
        order: Any = getattr(self, "order")  # noqa: B009 - likewise
        return order
