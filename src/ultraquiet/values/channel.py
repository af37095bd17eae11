"""A channel: one wire with a name, a unit and limits."""

import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError


@dataclass(frozen=True)
class Channel:
    """One input or output. `low` and `high` are the limits, in `unit`, beyond which the signal saturates.

    A unit that nobody stated is `""`, as that of a plain number is.

    >>> Channel("strut 1", "V", -25.0, 25.0).high
    25.0
    """

    name: str
    unit: str = ""
    low: float = -float("inf")
    high: float = float("inf")

    def __post_init__(self) -> None:
        for text in (self.name, self.unit):
            try:
                text.encode()
            except UnicodeEncodeError:  # half of a pair of UTF-16, which no file can hold
                raise InputError(f"Channel: {text!a} is no text that can be written; rename it.") from None
        if not self.low < self.high:
            raise InputError(f"Channel '{self.name}': low {self.low:g} must be below high {self.in_unit(self.high)}.")

    @property
    def label(self) -> str:
        """The name, with the unit where one was stated.

        >>> Channel("push", "N").label, Channel("input 1").label
        ('push (N)', 'input 1')
        """
        return f"{self.name} ({self.unit})" if self.unit else self.name

    def in_unit(self, value: float, digits: int = 6) -> str:
        """Return a value as a text, with the unit where one was stated.

        >>> Channel("push", "N").in_unit(2.5), Channel("input 1").in_unit(2.5)
        ('2.5 N', '2.5')
        """
        return in_unit(value, self.unit, digits)


def in_unit(value: float, unit: str, digits: int = 6) -> str:
    """Return a value as a text, with its unit where one was stated."""
    return f"{value + 0.0:.{digits}g} {unit}".rstrip()  # minus zero is zero


LEVEL_SHARE = 0.1  # of what an actuator may swing: loud enough for most, far from its limits


def usual_level(wires: Iterable[Channel]) -> float:
    """Return a level for commands around zero that nobody named: a tenth of the smallest swing that the limits allow.

    The swing is the smaller side of a range; without a limit on any wire the level is one.

    >>> usual_level([Channel("push", "N", -40.0, 25.0), Channel("pull", "N")]), usual_level([Channel("pull", "N")])
    (2.5, 1.0)
    """
    swings = [swing for c in wires if 0 < (swing := min(-c.low, c.high)) < float("inf")]
    return LEVEL_SHARE * min(swings) if swings else 1.0


def same_unit(one: str, other: str) -> bool:
    """Return whether two spellings are of one unit: of micro, of powers, with or without brackets around.

    >>> same_unit("m/s²", "(m/s^2)"), same_unit("µm", "um"), same_unit("mm/s", "m/s"), same_unit("mN", "MN")
    (True, True, False, False)
    """
    return _plainly(one) == _plainly(other)


def _plainly(unit: str) -> str:
    plain = unicodedata.normalize("NFKC", unit).replace("\N{GREEK SMALL LETTER MU}", "u")  # NFKC makes U+00B5 one too
    return "".join(letter for letter in plain if letter not in " ^()")


def squared(unit: str) -> str:
    """Return the unit of a square.

    >>> squared("V"), squared("m/s"), squared("")
    ('V²', '(m/s)²', '')
    """
    if not unit:
        return ""
    return f"{unit}²" if unit.isalpha() else f"({unit})²"


def per_root_hz(unit: str) -> str:
    """Return the unit of an amplitude spectral density.

    >>> per_root_hz("V"), per_root_hz("m/s"), per_root_hz("")
    ('V/√Hz', '(m/s)/√Hz', '1/√Hz')
    """
    return ratio(unit, "Hz").removesuffix("Hz") + "√Hz"


def ratio(unit: str, per: str) -> str:
    """Return the unit of a gain.

    >>> ratio("V", "N"), ratio("N", "m/s"), ratio("m/s", ""), ratio("", "")
    ('V/N', 'N/(m/s)', '(m/s)/1', '1')
    """
    if not unit and not per:
        return "1"
    return "/".join(each if each.isalpha() else f"({each})" if each else "1" for each in (unit, per))


def at_limits(samples: FloatArray, wires: Sequence[Channel]) -> NDArray[np.int64]:
    """Return for each channel how many samples of `(channel, sample)` stand at or beyond its limits."""
    return np.count_nonzero(stands_at_limits(samples, wires), axis=1)


def stands_at_limits(samples: FloatArray, wires: Sequence[Channel]) -> NDArray[np.bool_]:
    """Return which samples of `(channel, sample)` stand at or beyond their channel's limits."""
    low, high = (np.array([getattr(c, end) for c in wires])[:, None] for end in ("low", "high"))
    return np.asarray((samples <= low) | (samples >= high))


def channels(who: str, wires: Sequence[Channel | str] | None, count: int, prefix: str) -> tuple[Channel, ...]:
    """Return `count` channels from channels, bare names, or nothing (numbered from one)."""
    if wires is None:
        return tuple(Channel(f"{prefix} {i + 1}") for i in range(count))
    named = tuple(c if isinstance(c, Channel) else Channel(str(c)) for c in wires)
    if len(named) != count:
        raise InputError(f"{who}: {len(named)} {prefix} names were given for {count} channels.")
    return named
