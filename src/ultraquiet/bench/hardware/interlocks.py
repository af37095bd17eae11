"""Interlocks: what may be sent to hardware and what may come back, and who watches it in every sample."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, whole
from ultraquiet._base.errors import InputError, InterlockError
from ultraquiet._base.registry import formerly
from ultraquiet._base.shown.one_line import described
from ultraquiet.bench._abstract import limits
from ultraquiet.values import Channel

Level = float | tuple[float, ...]
# A difference of two samples that stands exactly at the limit may round to a little above it.
ROUNDING = 1e-9
FRAME_S, FRAMES = 0.5, 3.0  # longest time between two frames where nobody states one
LARGEST = 1e150  # its square is a number yet


@formerly(amplitude_v="amplitude", slew_v_per_s="slew_per_s", reading_v="reading", rms_v="rms")
@dataclass(frozen=True)
class Interlocks:
    """Limits that end a run when they are met. A level is one number for all channels, or one for each.

    Args:
        amplitude: largest magnitude sent to an actuator, command and disturbance together, in its unit; the actuators'
            own range holds in any case.
        slew_per_s: fastest change sent to an actuator, in its unit per second; the ramps to zero keep to it as well.
        duration_s: longest run.
        reading: largest magnitude of a reading, in its unit.
        rms: largest RMS value of a reading, measured with the time constant `rms_window_s` (first order).
        rms_window_s: see `rms`.
        late_frames: how many frames in a row may come too late.
        frame_s: longest time between two frames: a driver that hangs for longer is not to be trusted. When absent half
            a second, or three frames where these take longer.
        stop: emergency stop, asked in every sample; True ends the run.
        ramp_s: shortest time in which the actuators are brought to zero.

    Raises:
        InputError: a limit that is not above zero.

    >>> Interlocks(amplitude=10.0, slew_per_s=2000.0, duration_s=60.0).ramp_s
    0.1
    """

    amplitude: Level | None = None
    slew_per_s: Level | None = None
    duration_s: float | None = None
    reading: Level | None = None
    rms: Level | None = None
    rms_window_s: float = 0.1
    late_frames: int = 10
    frame_s: float | None = None
    stop: Callable[[], bool] | None = None
    ramp_s: float = 0.1

    def __post_init__(self) -> None:
        for name in ("amplitude", "slew_per_s", "duration_s", "reading", "rms"):
            level = getattr(self, name)
            for value in level if isinstance(level, tuple) else (level,):
                if value is not None:
                    positive("Interlocks", name, value)
        for name in ("rms_window_s", "frame_s", "ramp_s"):
            if getattr(self, name) is not None:
                positive("Interlocks", name, getattr(self, name), "s")
        whole("Interlocks", "late_frames", self.late_frames, 0)
        if self.stop is not None and not callable(self.stop):
            raise InputError(f"Interlocks: 'stop' must be a function, got {type(self.stop).__name__}.")


class Guard:
    """The interlocks of one bench, per channel and per sample."""

    def __init__(
        self, interlocks: Interlocks, rate_hz: float, actuators: tuple[Channel, ...], sensors: tuple[Channel, ...]
    ) -> None:
        self.interlocks, self.rate_hz, self.actuators, self.sensors = interlocks, rate_hz, actuators, sensors
        low, high = limits(actuators)
        amplitude = _levels("amplitude", interlocks.amplitude, actuators)
        self.low, self.high = np.maximum(low, -amplitude), np.minimum(high, amplitude)
        self.step = _levels("slew_per_s", interlocks.slew_per_s, actuators) / rate_hz
        self._reading = _levels("reading", interlocks.reading, sensors)
        self._rms = _levels("rms", interlocks.rms, sensors)
        self.frame_s = _longest_frame(interlocks.frame_s, rate_hz)
        self._forget = -np.expm1(-1.0 / (interlocks.rms_window_s * rate_hz))
        self.reset()
        for c, least, most in zip(actuators, self.low, self.high, strict=True):
            if not (np.isfinite(least) and np.isfinite(most) and least <= 0.0 <= most):
                raise InputError(
                    f"Hardware: '{c.name}' may be sent {least:g} to {c.in_unit(most)}; it needs finite limits about "
                    "zero, its own or the interlock 'amplitude'."
                )

    def reset(self) -> None:
        """Forget the last run."""
        self._square = np.zeros(len(self.sensors))
        self._late = 0

    def ramp_samples(self, value: FloatArray, least: int) -> int:
        """Return in how many samples `value` comes to zero, `least` or what the slew limit needs."""
        return max(least, 1, int(np.ceil(np.max(np.abs(value) / self.step) * (1 + ROUNDING))))

    def foresee(self, sent: FloatArray) -> None:
        """Refuse a run whose values `(nu, n)` are known to trip an interlock before it begins."""
        longest = self.interlocks.duration_s
        if longest is not None and sent.shape[1] > longest * self.rate_hz * (1 + ROUNDING):
            takes = sent.shape[1] / self.rate_hz
            raise InputError(
                f"Hardware: a run of {takes:g} s is longer than the interlock 'duration' allows, {longest:g} s; "
                "nothing was moved."
            )
        before = np.concatenate([np.zeros((len(sent), 1)), sent[:, :-1]], axis=1)
        over = (sent < self.low[:, None]) | (sent > self.high[:, None])
        fast = np.abs(sent - before) > self.step[:, None] * (1 + ROUNDING)
        bad = np.flatnonzero((over | fast).any(axis=0))
        if bad.size:
            k = int(bad[0])
            name, description, _ = self._outgoing(sent[:, k], before[:, k])
            raise InputError(f"Hardware: at sample {k} {description} by the interlock '{name}'; nothing was moved.")

    def out(self, value: FloatArray, before: FloatArray, k: int) -> None:
        """Check what is about to be sent at sample `k` after `before`."""
        if (pressed := self._pressed()) is not None:
            raise self._tripped("stop", k, 1.0, pressed)
        inside = (value >= self.low) & (value <= self.high)  # not a number is not inside either
        if not (inside & (np.abs(value - before) <= self.step * (1 + ROUNDING))).all():
            name, description, number = self._outgoing(value, before)
            raise self._tripped(name, k, number, description)

    def _pressed(self) -> str | None:
        """Return what is said where the emergency stop is pressed, or cannot tell."""
        try:
            pressed = self.interlocks.stop is not None and bool(self.interlocks.stop())
        except Exception as error:
            return f"the emergency stop does not tell whether it was pressed ({described(error)})"
        return "the emergency stop was pressed" if pressed else None

    def back(self, y: FloatArray, k: int) -> None:
        """Check what was read at sample `k`."""
        self._square += self._forget * (np.minimum(np.abs(y), LARGEST) ** 2 - self._square)
        rms = np.sqrt(self._square)
        if (np.abs(y) <= self._reading).all() and (rms <= self._rms).all():
            return
        for name, values, most in (("reading", np.abs(y), self._reading), ("rms", rms, self._rms)):
            for c, value, limit in zip(self.sensors, values, most, strict=True):
                if not value <= limit:
                    raise self._tripped(name, k, value, f"'{c.name}' has {c.in_unit(value)}, {limit:g} are allowed")

    def frame(self, late: int, elapsed_s: float, since_s: float, k: int) -> None:
        """Check the time: frames missed now, seconds since the frame before and since the start of the run."""
        self._late = self._late + late if late else 0
        if self._late > self.interlocks.late_frames:
            description = f"{self._late} frames in a row came too late, {self.interlocks.late_frames} are allowed"
            raise self._tripped("late frames", k, self._late, description)
        if elapsed_s > self.frame_s:
            description = f"the frame before took {elapsed_s:.3g} s, {self.frame_s:g} s are allowed"
            raise self._tripped("frame", k, elapsed_s, description)
        # The run itself is as long as was foreseen; only a clock that is slow makes it longer.
        if self.interlocks.duration_s is not None and since_s > self.interlocks.duration_s + self.frame_s:
            raise self._tripped("duration", k, since_s, f"the run has taken {since_s:.3g} s already")

    def _outgoing(self, value: FloatArray, before: FloatArray) -> tuple[str, str, float]:
        """Return interlock, description and value of the first channel that must not be sent."""
        for i, c in enumerate(self.actuators):
            v, jump = float(value[i]), float(abs(value[i] - before[i]) * self.rate_hz)
            if not self.low[i] <= v <= self.high[i]:
                allowed = f"{self.low[i]:g} to {c.in_unit(self.high[i])} are allowed"
                return "amplitude", f"'{c.name}' was to be sent {c.in_unit(v)}, {allowed}", v
            if not jump <= self.step[i] * self.rate_hz * (1 + ROUNDING):
                allowed = f"{self.step[i] * self.rate_hz:g} {c.unit}/s are allowed"
                return "slew", f"'{c.name}' was to change by {jump:g} {c.unit}/s, {allowed}", jump
        raise AssertionError("asked about values that are within all limits")

    def _tripped(self, interlock: str, k: int, value: float, description: str) -> InterlockError:
        sentence = f"Hardware: the interlock '{interlock}' ended the run at sample {k}: {description}."
        return InterlockError(sentence, interlock, k, float(value))


def _longest_frame(frame_s: float | None, rate_hz: float) -> float:
    """Return the longest time between two frames in seconds; one that every frame exceeds is refused."""
    if frame_s is None:
        return max(FRAME_S, FRAMES / rate_hz)
    if frame_s * rate_hz <= 1.0:
        raise InputError(
            f"Hardware: at {rate_hz:g} Hz a frame takes {1 / rate_hz:g} s and the interlock 'frame_s' allows "
            f"{frame_s:g} s; allow a few frames, {FRAMES / rate_hz:g} s, or leave it away."
        )
    return frame_s


def _levels(name: str, level: Level | None, channels: tuple[Channel, ...]) -> FloatArray:
    if isinstance(level, tuple) and len(level) != len(channels):
        raise InputError(f"Interlocks: '{name}' must be one number or {len(channels)}, got {len(level)}.")
    return np.broadcast_to(np.inf if level is None else np.asarray(level, dtype=np.float64), len(channels)).copy()
