"""What a simulation of frames is asked for, and what chance adds to it; nothing here runs anything."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, frozen, one_of, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.frame.times import FrameTimes

JITTERS = ("uniform", "gaussian", "bursts")
# Bursts: a disc, a network driver: this many late interrupts in a row, one such burst in so many frames on average.
BURST_FRAMES, BURST_EVERY = 16, 1000
MOST_FRAMES = 20_000_000  # 40 bytes of result each
# A delay of a whole period would be the next frame's interrupt.
LATEST = 0.999


@dataclass(frozen=True)
class Overload(Shown):
    """`extra_s` seconds more work in each of `frames` frames from number `first` on, between `output` and `update`."""

    first: int
    frames: int
    extra_s: float

    def __post_init__(self) -> None:
        whole("Overload", "first", self.first, 0)
        whole("Overload", "frames", self.frames, 1)
        positive("Overload", "extra_s", self.extra_s, "s")


@dataclass(frozen=True)
class Draws:
    """What chance and overloads add: delays and work in seconds, slow-downs as factors, other interrupts."""

    delay_s: FloatArray
    stretch: FloatArray
    extra_s: FloatArray
    arrival_s: FloatArray


@dataclass(frozen=True)
class FrameSettings:
    """What `Frame` is given, checked; the harness, the clock and the results read it."""

    load: float = 0.5
    jitter_s: float = 0.0
    jitter: str = "uniform"
    contention: float = 0.0
    interrupt_hz: float = 0.0
    interrupt_s: float = 0.0
    overloads: tuple[Overload, ...] = ()
    restart_s: float | None = None

    def __post_init__(self) -> None:
        if between("Frame", "load", self.load, 0.0, np.inf) >= 1.0:
            raise InputError(
                f"Frame: 'load' must lie below 1, got {self.load:g}; the step needs some of the processor."
            )
        between("Frame", "jitter_s", self.jitter_s, 0.0, np.inf, "s")
        one_of("Frame", "jitter", self.jitter, JITTERS)
        between("Frame", "contention", self.contention, 0.0, np.inf)
        between("Frame", "interrupt_hz", self.interrupt_hz, 0.0, np.inf, "Hz")
        between("Frame", "interrupt_s", self.interrupt_s, 0.0, np.inf, "s")
        if self.restart_s is not None:
            positive("Frame", "restart_s", self.restart_s, "s")
        if not isinstance(self.overloads, tuple) or not all(isinstance(load, Overload) for load in self.overloads):
            raise InputError(f"Frame: 'overloads' must be a tuple of Overload, got {self.overloads!r}.")
        if self.load + self.interrupt_hz * self.interrupt_s >= 1.0:
            raise InputError(
                f"Frame: background ({self.load:g}) and interrupts ({self.interrupt_hz * self.interrupt_s:g}) leave"
                " nothing of the processor to the step; lower one of them."
            )

    def require(self, frames: int, period_s: float) -> None:
        """Refuse what no run of so many frames can have.

        Raises:
            InputError: jitter of a period or more, an overload beyond the last frame.
        """
        whole("Frame", "frames", frames, 1, MOST_FRAMES)
        if self.jitter_s >= period_s:
            raise InputError(
                f"Frame: a jitter of {1e6 * self.jitter_s:g} us is not below the frame's {1e6 * period_s:.4g} us."
            )
        for load in self.overloads:
            if load.first >= frames:
                raise InputError(f"Frame: an overload begins at frame {load.first}, the run has only {frames}.")

    def draw(self, frames: int, period_s: float, seed: int) -> Draws:
        """Return the random part of so many frames.

        Raises:
            InputError: as `require`.
        """
        self.require(frames, period_s)
        whole("Frame", "seed", seed, 0)
        rng = np.random.default_rng(seed)
        stretch = 1.0 + self.contention * rng.random(frames)
        extra = np.zeros(frames)
        for load in self.overloads:
            extra[load.first : load.first + load.frames] += load.extra_s
        # Some interrupts more than the run's mean number; overruns of the last frame reach a little beyond its end.
        arrivals = np.zeros(0)
        if self.interrupt_hz * self.interrupt_s > 0:
            span = self.interrupt_hz * frames * period_s
            arrivals = np.cumsum(rng.exponential(1.0 / self.interrupt_hz, round(span + 10.0 * np.sqrt(span) + 50.0)))
        return Draws(*map(frozen, (self._delay(rng, frames, period_s), stretch, extra, arrivals)))

    def _delay(self, rng: np.random.Generator, frames: int, period_s: float) -> FloatArray:
        if self.jitter_s == 0.0:
            return np.zeros(frames)
        if self.jitter == "gaussian":
            return np.minimum(np.abs(rng.standard_normal(frames)) * self.jitter_s, LATEST * period_s)
        delay = rng.random(frames) * self.jitter_s
        if self.jitter == "bursts":
            begins = np.where(rng.random(frames) < 1.0 / BURST_EVERY, np.arange(frames), -BURST_FRAMES)
            delay[np.arange(frames) - np.maximum.accumulate(begins) >= BURST_FRAMES] = 0.0
        return delay


def frame_settings(frame: FrameSettings, times: FrameTimes, rate_hz: float) -> dict[str, Any]:
    """Return the numbers of the loop, in the order of the harness's struct."""
    period = 1.0 / rate_hz
    times.require_room(period)
    parts = ("entry_s", "read_s", "output_s", "write_s", "update_s", "leave_s", "idle_output_s", "idle_update_s")
    restart = 0 if frame.restart_s is None else max(1, round(frame.restart_s * rate_hz))
    return {
        "period_s": period,
        **{name: float(getattr(times, name)) for name in parts},
        "background_s": frame.load * period,
        "service_s": float(frame.interrupt_s),
        "restart": restart,
    }
