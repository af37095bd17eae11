"""What can be seen while a list runs: levels, clipped samples, late frames, time left; and whom to show it to."""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.experiments.plan import Measurement
from ultraquiet.values import Channel

# A reading that stays below this part of its range uses less than six of twelve bits: most of it is rounding and noise.
LOW_LEVEL = 0.01


class Levels:
    """How loud a measurement is, sensor by sensor, from its first block to the last one taken.

    >>> from ultraquiet.bench import Block
    >>> levels = Levels([Channel("u")], [Channel("y", "V", -10.0, 10.0)])
    >>> levels.take(Block(np.zeros((1, 2)), np.array([[3.0, -4.0]]), np.array([0]), np.array([0])))
    >>> float(levels.peak[0]), float(levels.share[0]), round(float(levels.rms[0]), 3)
    (4.0, 0.4, 3.536)
    """

    def __init__(self, actuators: Sequence[Channel], sensors: Sequence[Channel]) -> None:
        self.actuators, self.sensors = tuple(actuators), tuple(sensors)
        self.samples = 0
        self.overruns = 0
        self.clipped = np.zeros(len(self.sensors), dtype=np.int64)
        self.limited = np.zeros(len(self.actuators), dtype=np.int64)
        self.further: dict[str, Any] = {}
        self.peak: FloatArray = np.zeros(len(self.sensors))
        self.share: FloatArray = np.zeros(len(self.sensors))
        self.last_rms: FloatArray = np.zeros(len(self.sensors))
        self._squares: FloatArray = np.zeros(len(self.sensors))
        self._low = np.array([c.low for c in self.sensors])
        self._high = np.array([c.high for c in self.sensors])

    def take(self, block: Any) -> None:
        """Count one block of a run."""
        y = np.asarray(block.readings)
        if not y.shape[1]:
            return
        least, most = y.min(axis=1), y.max(axis=1)
        self.peak = np.maximum(self.peak, np.abs(y).max(axis=1))
        self.share = np.maximum(self.share, np.maximum(_part(most, self._high), _part(least, self._low)))
        squares = np.square(y).sum(axis=1)
        self.last_rms = np.sqrt(squares / y.shape[1])
        self._squares = self._squares + squares
        self.samples += y.shape[1]
        self.clipped += block.limited_readings
        self.limited += block.limited_commands
        self.overruns += int(block.overruns)
        for name, counts in block.further.items():
            self.further[name] = self.further.get(name, 0) + counts

    @property
    def rms(self) -> FloatArray:
        """Root of the mean square of all samples so far, `(ny,)`, in the sensors' units."""
        return np.sqrt(self._squares / max(self.samples, 1))

    def warnings(self, excited: bool) -> Iterator[str]:
        """Yield a sentence for everything that makes the measurement worth less than it could be."""
        if self.clipped.any():
            yield f"readings clipped: {_counted(self.sensors, self.clipped)} of {self.samples} samples"
        if self.limited.any():
            yield f"commands met their limits: {_counted(self.actuators, self.limited)} of {self.samples} samples"
        for name, counts in self.further.items():
            if counts.any():
                counted = ", ".join(f"{k} in {n}" for k, n in enumerate(counts, start=1) if n)
                what = name.removeprefix("limited_").replace("_", " ")
                yield f"{what} met their limits: {counted} of {self.samples} samples"
        if self.overruns:
            yield f"{self.overruns} frames came too late"
        ranged = np.isfinite(self._low) & np.isfinite(self._high)
        if excited and ranged.any() and self.share[ranged].max() < LOW_LEVEL:
            loudest = int(np.argmax(np.where(ranged, self.share, -1.0)))
            name, percent = self.sensors[loudest].name, 100 * self.share[loudest]
            yield f"the level is low: the loudest reading, '{name}', uses {percent:.2g} % of its range"


def _part(value: FloatArray, limit: FloatArray) -> FloatArray:
    """Return which part of the way to a limit each value has gone; none when it goes the other way or has no limit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(limit == 0.0, 0.0, np.maximum(value / limit, 0.0))


def _counted(channels: Sequence[Channel], counts: Any) -> str:
    return ", ".join(f"{channel.name} in {n}" for channel, n in zip(channels, counts, strict=True) if n)


class Course:
    """How far a list has come, in seconds on the bench, and how long it will still take on the wall."""

    def __init__(self, total_s: float, in_real_time: bool) -> None:
        self.total_s = total_s
        self.done_s = 0.0
        self._real = in_real_time
        self._began = time.monotonic()

    def advance(self, seconds: float) -> None:
        """Note that so much of the list lies behind."""
        self.done_s += seconds

    @property
    def left_s(self) -> float:
        """Seconds on the wall until the end; a simulated bench goes on at the pace it has shown so far."""
        bench_s = max(self.total_s - self.done_s, 0.0)
        if self._real or not self.done_s:
            return bench_s
        return bench_s * (time.monotonic() - self._began) / self.done_s


class Onlooker:
    """Is told what happens while a list runs; this one says nothing. Override what should be shown."""

    def begins(self, steps: Sequence[Measurement], finished: Sequence[str], course: Course) -> None:
        """Say that a list begins; the records called `finished` are there already."""

    def measures(self, step: Measurement, levels: Levels) -> None:
        """Say that a measurement begins; `levels` will follow it."""

    def lowers(self, sentence: str) -> None:
        """Say that a level which nobody named is lowered, and why."""

    def advances(self, step: Measurement, levels: Levels) -> None:
        """Say that a block has been measured."""

    def ends(self, step: Measurement, levels: Levels, status: str, warnings: Sequence[str]) -> None:
        """Say that a measurement is over."""

    def waits(self, seconds: float, skipped: bool) -> None:
        """Say that a pause begins, or that it is skipped because the bench is at rest at once."""

    def reads(self, name: str, temperature_c: float) -> None:
        """Say what the thermometer says."""
