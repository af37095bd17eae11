"""Which channels of two systems may meet, and what the joined one is called."""

import re
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.values.channel import Channel

NUMBERED = re.compile(r"(in|out)put \d+")
UNSTATED = ("", "V")  # files of version 0.1 gave volts to channels whose unit nobody had stated


def is_numbered(wire: Channel) -> bool:
    """Return whether a channel was numbered because nobody named it: its unit is not known and fits any.

    >>> is_numbered(Channel("input 1")), is_numbered(Channel("strut 1"))
    (True, False)
    """
    return NUMBERED.fullmatch(wire.name) is not None and wire.unit in UNSTATED


def meet(who: str, left: Sequence[Channel], right: Sequence[Channel], how: str) -> tuple[Channel, ...]:
    """Return the channels of two sides that are one, the named before the numbered.

    Raises:
        InputError: unequal numbers, or two units that differ; `how` says what the two sides are.
    """
    if len(left) != len(right):
        raise InputError(f"{who}: {how} do not fit, {len(left)} channels and {len(right)}.")
    out: list[Channel] = []
    for one, other in zip(left, right, strict=True):
        if one.unit != other.unit and not (is_numbered(one) or is_numbered(other)):
            raise InputError(
                f"{who}: {how} differ in unit, '{one.name}' in {one.unit or '1'} and '{other.name}' in "
                f"{other.unit or '1'}; convert one of them with a gain."
            )
        out.append(other if is_numbered(one) else one)
    return tuple(out)


class Wired(Protocol):
    """Anything with channels in and out: a system, a bench."""

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """What goes in."""
        ...

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """What comes out."""
        ...


def unswapped(who: str, law: Wired, loop: Wired, what: str = "plant") -> None:
    """Refuse a law that names its loop's channels at other places: wire by wire it would close another loop.

    Names that the other side does not have say nothing, nor do those that stand twice.

    Args:
        who: opens the sentence of a refusal.
        law: u = K y; what it calls its actuators are readings, its sensors commands.
        loop: the plant or bench that it meets.
        what: `loop` is, in words.

    Raises:
        InputError: with the first channel that is elsewhere.
    """
    for kind, ours, theirs in (("reading", law.actuators, loop.sensors), ("command", law.sensors, loop.actuators)):
        found = moved(ours, theirs)
        if found is not None:
            name, here, there = found
            raise InputError(
                f"{who}: '{name}' is {kind} {here} of the controller and {there} of the {what}, so the loop would run "
                f"with its wires swapped; put the controller's channels in the {what}'s order, "
                f"{', '.join(c.name for c in theirs)} (`pick`)."
            )


def moved(ours: Sequence[Channel], theirs: Sequence[Channel]) -> tuple[str, int, int] | None:
    """Return the first channel that as many others have at another place, and both places from one; None without.

    Channels that were only numbered may be any, and a name that stands twice says nothing.

    >>> moved([Channel("left"), Channel("right")], [Channel("right"), Channel("left")])
    ('left', 1, 2)
    """
    mine, others = [c.name for c in ours], [c.name for c in theirs]
    if mine == others or len(mine) != len(others):
        return None
    for k, name in enumerate(mine):
        if others[k] != name and mine.count(name) == others.count(name) == 1 and not is_numbered(ours[k]):
            return name, k + 1, others.index(name) + 1
    return None


def apart(one: Sequence[Channel], other: Sequence[Channel], word: str) -> tuple[Channel, ...]:
    """Return the channels of two systems side by side, numbered ones numbered through."""
    both = [*one, *other]
    return tuple(Channel(f"{word} {k + 1}") if is_numbered(c) else c for k, c in enumerate(both))


def places(who: str, chosen: Sequence[int | str] | int | str | None, wires: Sequence[Channel]) -> list[int]:
    """Return the indices of channels that are named or counted from 0; one alone stands for a list of one."""
    names = [c.name for c in wires]
    if chosen is None:
        return list(range(len(names)))
    out: list[int] = []
    for each in [chosen] if isinstance(chosen, str) or not isinstance(chosen, Iterable) else chosen:
        known = names.index(each) if isinstance(each, str) and each in names else each
        whole = isinstance(known, int | np.integer) and not isinstance(known, bool)
        if not whole or not -len(names) <= int(known) < len(names):
            kind = "channel" if isinstance(each, str) else "index"
            raise InputError(f"{who}: there is no {kind} {each!r}; there are {', '.join(names)}, counted from 0.")
        out.append(int(known))
    return out
