"""What every design states about its loop beyond being stable: disk margins at both ends of the plant."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite, log10
from typing import Any, ClassVar

import numpy as np

from ultraquiet._base.constraints import between, numbers
from ultraquiet._base.shown.line import hertz
from ultraquiet.analyse.disk import ENDS, ChannelChange, EndMargins, disk_ranges, end_margins
from ultraquiet.values.channel import Channel
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

DISK_MARGIN = 0.2  # 1.7 dB or 11 degrees in every channel at once; several times what calibrated channels drift
UNSTABLE_LAW = "unstable by itself: it runs away where its loop is opened or an actuator saturates for long"
WIDEST = 2.0  # a disk of this size holds every gain from zero to infinity


@dataclass(frozen=True, kw_only=True)
class StatedRobustness:
    """The setting that all designs share.

    Args:
        disk_margin: what a design called `ok` keeps at the plant's input and at its output, all channels of that end at
            once (`analyse.disk_margin`); a stable loop with less is `fragile`. 0 asks for nothing but stability.
    """

    ask_for_more: ClassVar[str] = "give 'band_hz', or weights, for what is to be quiet"

    disk_margin: float = DISK_MARGIN

    def __post_init__(self) -> None:
        who = type(self).__name__
        between(who, "disk_margin", self.disk_margin, 0.0, WIDEST)
        tones = getattr(self, "tones_hz", ())
        found = numbers(who, "tones_hz", tones)
        if not np.ndim(tones):
            object.__setattr__(self, "tones_hz", tuple(found.tolist()))


def both_ends(plant: StateSpace, controller: StateSpace) -> dict[str, EndMargins]:
    """Return the margins at the plant's `output` and `input`."""
    return {side: end_margins(plant, controller, side) for side in reversed(ENDS)}


def weaker_end(margins: Mapping[str, EndMargins]) -> str:
    """Return the end with the smaller disk margin, `input` when both are alike."""
    return min(ENDS, key=lambda side: margins[side].disk_all)


def keeps(margins: Mapping[str, EndMargins], asked: float) -> bool:
    """Return whether both ends keep the disk margin asked for; NaN, which no comparison admits, is no margin."""
    return margins[weaker_end(margins)].disk_all >= asked


def fragility(plant: StateSpace, margins: Mapping[str, EndMargins], asked: float) -> str:
    """Return one sentence on the end that keeps less than asked, and on the channel whose change upsets the loop."""
    side = weaker_end(margins)
    found = margins[side]
    wires, kind = _wires(plant, side)
    _, high, degrees = disk_ranges(found.disk_all)
    near = f", near {hertz(found.disk_all_hz)}" if isfinite(found.disk_all_hz) else ""
    said = (
        f"The loop is stable yet fragile at the plant's {side}: changes of {_db(float(high)):.2g} dB or "
        f"{float(degrees):.2g} degrees in all {kind}s at once may upset it{near} (a disk margin of "
        f"{found.disk_all:.2g} where {asked:g} is asked)"
    )
    change = found.least_change
    return f"{said}." if change is None else f"{said}; {_told(change, kind, wires)}."


def kept(plant: StateSpace, margins: Mapping[str, EndMargins], asked: float, also: str = "") -> Status:
    """Return whether a stable loop keeps the disk margin asked for at both ends: `ok`, or `fragile`.

    Args:
        plant: G.
        margins: of both ends.
        asked: the disk margin.
        also: words on a loop that is ok, before its margins.
    """
    if keeps(margins, asked):
        return Status(StatusWord.OK, f"The loop is stable; {also}{stated(margins)}.")
    return Status(StatusWord.FRAGILE, fragility(plant, margins, asked))


def described(plant: StateSpace, margins: Mapping[str, Any]) -> list[str]:
    """Return one line an end on its disk margin and on the least change of one channel that upsets the loop.

    An unstable loop keeps none, and there is nothing left to upset.
    """
    lines: list[str] = []
    for side in ENDS:
        found = margins.get(side)
        if not isinstance(found, EndMargins):
            continue
        wires, kind = _wires(plant, side)
        change = found.least_change
        if not found.disk_all and change is None:
            lines.append(f"margin at the plant's {side}: none, the loop is unstable")
            continue
        alone = "no change of one channel upsets it" if change is None else _told(change, kind, wires)
        lines.append(f"margin at the plant's {side}: disk {found.disk_all:.3g}, all {kind}s at once; {alone}")
    return lines


def _wires(plant: StateSpace, side: str) -> tuple[tuple[Channel, ...], str]:
    return (plant.actuators, "actuator") if side == "input" else (plant.sensors, "sensor")


def stated(margins: Mapping[str, EndMargins]) -> str:
    """Return the disk margins of both ends in words."""
    sizes = [f"{margins[side].disk_all:.2f} at the plant's {side}" for side in ENDS]
    return f"disk margins, all channels at once, are {' and '.join(sizes)}"


def _told(change: ChannelChange, kind: str, wires: tuple[Channel, ...]) -> str:
    channel = f"{kind} {wires[change.channel].name!r}"
    if change.kind == "phase":
        what = f"{change.amount:.2g} degrees of phase"
    else:
        what = f"{abs(change.amount):.2g} dB {'more' if change.amount > 0 else 'less'} gain"
    return f"alone, {what} of {channel} upsets it, at {hertz(change.f_hz)}"


def _db(factor: float) -> float:
    return 20 * log10(factor) if factor < inf else inf
