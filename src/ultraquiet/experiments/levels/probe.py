"""Levels that nobody named, held against the sensors: a short, faint run says how loud the readings would become.

A tenth of an actuator's swing may fill a sensor's range many times over. Before the first record of such a command its
own signal is sent once, a sixteenth as long and a tenth as loud, at most; where a reading would use more than a fifth
of its room the level is lowered until it does not. A fifth, because what a mode without damping gathers of white noise
or of a chirp rises as the root of the time: fourfold from the probe to the record. What rises further still, a tone on
a resonance, is counted in the record, which says that its readings clipped.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Streaming
from ultraquiet.experiments.plan import Drive, Measurement, sent
from ultraquiet.values import Channel

SHORTER = 16  # a probe than its record
REST = 4  # one part in so many of a probe is silence, which shows offsets and noise
MOST = 0.8 / np.sqrt(SHORTER)  # of a reading's room; a fifth is left for what one draw does and another does not
FAINT = 0.1  # of the level: how loud the first probe is
PROBES = 8  # at most
NEAR = 0.5  # of what is allowed: a probe that came so close is believed


@dataclass(frozen=True)
class Levelled:
    """How loud a measurement may be: `share` of the level it was planned with; the sensor that asks for less."""

    share: float
    sensor: str = ""

    def sentence(self, step: Measurement, actuators: tuple[Channel, ...]) -> str:
        """Say what was lowered, and why."""
        levels = "; ".join(
            f"{self.share * getattr(drive.signal, name):.3g} {actuators[drive.actuator].unit}".rstrip()
            + f" on {actuators[drive.actuator].name}"
            for drive in step.drives
            for name in drive.unnamed[:1]
        )
        return (
            f"'{step.name}': the level is lowered to {levels}, {100 * self.share:.2g} % of the usual one; at more, "
            f"'{self.sensor}' might leave its range. Name a level to have it sent."
        )


def asks(bench: Any, step: Measurement) -> bool:
    """Return whether the level of a measurement is to be found: nobody named it, and a sensor has a range."""
    open_loop = step.controller is None and not step.disturbances
    ranged = any(np.isfinite(c.low) or np.isfinite(c.high) for c in bench.sensors)
    return open_loop and ranged and any(drive.unnamed for drive in step.drives)


def levelled(bench: Any, step: Measurement, run_index: int, stop: Callable[[], bool]) -> Levelled | None:
    """Return the share of its level at which no reading of a measurement uses more than `MOST` of its room.

    None where it was stopped.

    Args:
        bench: at rest.
        step: whose level is to be found.
        run_index: which draw of the bench's noise.
        stop: asked before each block of a bench that streams.
    """
    share, sensor = FAINT, ""
    for _ in range(PROBES):
        y, rest, samples = _probed(bench, lowered(step, share), run_index, stop)
        if y.shape[1] < samples:
            return None
        used = _used(y, rest, bench.sensors)
        worst = int(np.argmax(used))
        allowed = share * MOST / used[worst] if used[worst] > 0 else np.inf
        if allowed >= 1.0:
            return Levelled(1.0)
        sensor = bench.sensors[worst].name
        if NEAR * MOST <= used[worst] <= MOST:
            break
        share = float(allowed)
    return Levelled(share, sensor)


def lowered(step: Measurement, share: float) -> Measurement:
    """Return a measurement with its unnamed levels at a share of what was planned; its hash stays that of the plan."""
    drives = tuple(replace(drive, signal=_at(drive, share)) for drive in step.drives)
    return replace(step, drives=drives, planned=step.hash)


def _at(drive: Drive, share: float) -> Any:
    levels = {name: share * getattr(drive.signal, name) for name in drive.unnamed}
    return replace(drive.signal, **levels) if levels else drive.signal


def _probed(bench: Any, step: Measurement, run_index: int, stop: Callable[[], bool]) -> tuple[FloatArray, int, int]:
    """Return the readings of a short run, `(ny, n)`, how many are before its signal, how many were asked for."""
    samples = max(step.samples // SHORTER, 2 * REST)
    rest = samples // REST
    try:
        u = sent(step.drives, len(bench.actuators), samples - rest, bench.rate_hz)
    except InputError:  # a signal of a length of its own
        u = sent(step.drives, len(bench.actuators), step.samples, bench.rate_hz)[:, : samples - rest]
    actuation, nothing = np.hstack([np.zeros((len(u), rest)), u]), np.zeros((len(bench.sensors), 0))
    if isinstance(bench, Streaming):
        blocks = list(bench.stream(actuation, run_index=run_index, stop=stop))
        return np.concatenate([nothing, *(block.readings for block in blocks)], axis=1), rest, samples
    return bench.run(actuation).outputs, rest, samples


def _used(y: FloatArray, rest: int, sensors: tuple[Channel, ...]) -> FloatArray:
    """Return which part of each reading's room the signal used, `(ny,)`: none where the room is full at rest."""
    low, high = (np.array([getattr(c, end) for c in sensors]) for end in ("low", "high"))
    offset = np.median(y[:, :rest], axis=1)
    ambient = np.abs(y[:, :rest] - offset[:, None]).max(axis=1)
    room = np.minimum(high - offset, offset - low) - ambient
    moved = np.maximum(np.abs(y[:, rest:] - offset[:, None]).max(axis=1) - ambient, 0.0)
    # A reading at its end would have gone further, nobody knows how far.
    beyond = ((y[:, rest:] <= low[:, None]) | (y[:, rest:] >= high[:, None])).any(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(room > 0, moved / room, 0.0)
    return np.where((room > 0) & beyond, np.maximum(used, 1.0 / FAINT), used)
