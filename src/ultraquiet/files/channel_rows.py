"""Channels as rows that JSON can hold: name, unit and limits, which may be absent."""

from collections.abc import Iterable, Sequence
from math import inf, isfinite
from typing import Any

from ultraquiet.values import Channel


def channel_rows(channels: Iterable[Channel]) -> list[list[Any]]:
    """Return each channel as name, unit, lower and upper limit; JSON knows no infinity, an absent limit is null.

    >>> channel_rows([Channel("force", "N", -1.0)])
    [['force', 'N', -1.0, None]]
    """
    return [[c.name, c.unit, *(float(v) if isfinite(v) else None for v in (c.low, c.high))] for c in channels]


def from_rows(rows: Iterable[Sequence[Any]]) -> list[Channel]:
    """Return the channels of which `channel_rows` made rows.

    Raises:
        ValueError: rows that it never makes.
    """
    return [_channel(*row) for row in rows]


def _channel(name: Any, unit: Any, low: Any, high: Any) -> Channel:
    limits = [-inf if low is None else low, inf if high is None else high]
    numbers = all(isinstance(limit, int | float) and not isinstance(limit, bool) for limit in limits)
    if not (isinstance(name, str) and isinstance(unit, str) and numbers):
        raise ValueError("a channel is a name, a unit and two limits, which are numbers or absent")
    try:
        return Channel(name, unit, float(limits[0]), float(limits[1]))
    except OverflowError:  # a whole number beyond all floats
        raise ValueError(f"a limit of channel '{name:.40}' is beyond all numbers") from None
