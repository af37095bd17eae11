"""How a payload is shaken and listened to."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, numbers, positive, rising_band, tone_below_nyquist, whole
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Bench
from ultraquiet.simulate.payload.wires import place_of

WHO = "measure_payload"
LEVEL_SHARE = 0.25  # RMS of noise against the range of its actuator: one sample in sixteen thousand meets the limit


@dataclass(frozen=True)
class PayloadSetup:
    """Which actuator shakes, which sensors listen, over which band.

    Args:
        shaker: name of the actuator that shakes what the payload stands on.
        sensors: names of the sensors on the payload, all of one unit.
        band_hz: (low, high) in Hz of the noise that is sent.
        base: names of sensors of the same unit on what is shaken; transmissibility is payload over base, and over the
            shaker's command where there are none.
        force: name of an actuator that pushes the payload itself, a second disturbance by itself.
        tones_hz: tones that the shaker sends besides, together, in a run of their own.
        level: RMS of the noise and peak of the tones' sum, in the actuator's unit; a quarter of its range when absent,
            and less where a reading would meet its limit.
        seconds: length of the period that is measured, at the end of each run.
        settle_s: what runs before it, with the same period.
        seed: of the noise.
        reads: names of the sensors that the law reads, where those are not the bench's own: sensors on the payload, for
            a law that is to answer a force there.
    """

    shaker: str
    sensors: tuple[str, ...]
    band_hz: tuple[float, float]
    base: tuple[str, ...] = ()
    force: str | None = None
    tones_hz: tuple[float, ...] = ()
    level: float | None = None
    seconds: float = 8.0
    settle_s: float = 4.0
    seed: int = 0
    reads: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        positive(WHO, "seconds", self.seconds, "s")
        positive(WHO, "settle_s", self.settle_s, "s")
        whole(WHO, "seed", self.seed, 0)
        rising_band(WHO, self.band_hz)
        for f in numbers(WHO, "tones_hz", self.tones_hz) if len(self.tones_hz) else ():
            positive(WHO, "tones_hz", f, "Hz")
        if self.level is not None:
            positive(WHO, "level", self.level)
        if not self.sensors:
            raise InputError(f"{WHO}: 'sensors' must name at least one sensor of the payload.")

    @property
    def names(self) -> tuple[str, ...]:
        """Every channel that is needed."""
        return (self.shaker, *self.sensors, *self.base, *(() if self.force is None else (self.force,)), *self.reads)

    def listened(self, bench: Bench, names: tuple[str, ...]) -> list[int]:
        """Return the places of named sensors, of one unit.

        Raises:
            InputError: an unknown sensor, units that differ.
        """
        places = [place_of(name, bench.sensors, WHO, "sensor") for name in names]
        units = list(dict.fromkeys(bench.sensors[k].unit for k in places))
        if len(units) > 1:
            raise InputError(f"{WHO}: the sensors {', '.join(names)} have units {', '.join(units)}; take those of one.")
        return places

    def sent_level(self, bench: Bench, actuator: int) -> float:
        """Return the level of an actuator."""
        if self.level is not None:
            return self.level
        channel = bench.actuators[actuator]
        reach = min(abs(channel.low), abs(channel.high))
        return LEVEL_SHARE * reach if np.isfinite(reach) and reach > 0 else 1.0

    def periods(self, rate_hz: float) -> tuple[int, int]:
        """Return samples of a period and of a run, which ends with a whole one."""
        period = round(self.seconds * rate_hz)
        if period < 2 * rate_hz / self.band_hz[0]:
            raise InputError(f"{WHO}: {self.seconds:g} s hold fewer than two periods of {self.band_hz[0]:g} Hz.")
        rising_band(WHO, self.band_hz, rate_hz)
        return period, period + round(self.settle_s * rate_hz)

    def tone_lines(self, rate_hz: float) -> list[int]:
        """Return the line of the period that each tone is sent at, the nearest one, counted in whole periods.

        Raises:
            InputError: a tone that is none at this rate, or slower than the period that is measured.
        """
        period, lines = self.periods(rate_hz)[0], list[int]()
        for f in self.tones_hz:
            line = round(tone_below_nyquist(WHO, "tones_hz", f, rate_hz) * period / rate_hz)
            if not 0 < line < period / 2:
                where = "are less than a period of" if not line else "do not tell from Nyquist's frequency"
                raise InputError(f"{WHO}: {self.seconds:g} s {where} the tone of {f:g} Hz; make 'seconds' longer.")
            lines.append(line)
        return lines


def repeated(period: FloatArray, samples: int) -> FloatArray:
    """Return a period `(n,)` repeated so that a run of `samples` ends with a whole one."""
    return period[(np.arange(samples) - samples) % period.size]
