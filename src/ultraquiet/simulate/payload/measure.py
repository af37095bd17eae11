"""What the payload feels, measured by its own sensors with the law and without it."""

from copy import copy, deepcopy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet.bench import Bench
from ultraquiet.simulate.noise import band_noise
from ultraquiet.simulate.payload.reduction import Heard, PayloadReduction
from ultraquiet.simulate.payload.setup import WHO, PayloadSetup, repeated
from ultraquiet.simulate.payload.spectrum import PeriodSpectrum
from ultraquiet.simulate.payload.wires import instrumented, on_all_channels, place_of
from ultraquiet.values import StateSpace
from ultraquiet.values.channel import at_limits
from ultraquiet.values.controller import Controller

QUIETER, QUIETEST = 0.5, 1e-3  # a level that brings a reading to its limit is halved, down to this share


@dataclass(frozen=True, eq=False)
class Shaken:
    """One disturbance, the same in every run: `sent` `(samples,)` on one actuator, and what was heard without a law.

    `silent` is a run without any disturbance: what the sensors say by themselves.
    """

    actuator: int
    level: float
    sent: FloatArray
    opened: Heard
    silent: Heard


class OpenPayload:
    """A bench whose payload was listened to without a law; each law is then measured beside the same runs.

    Args:
        bench: any bench with the named channels, or one that offers them by `instrumented()`.
        setup: what shakes and what listens.

    Raises:
        InputError: a channel that is not there, sensors of several units, a band or a tone beyond half the rate.
    """

    def __init__(self, bench: Bench, setup: PayloadSetup) -> None:
        self.own, self.setup = bench, setup
        self.bench = instrumented(bench, setup.names, WHO)
        self._payload = setup.listened(self.bench, setup.sensors)
        self._base = setup.listened(self.bench, setup.base) if setup.base else []
        if setup.base and self.bench.sensors[self._base[0]].unit != self.bench.sensors[self._payload[0]].unit:
            raise InputError(f"{WHO}: 'base' and 'sensors' have different units; their ratio would be none.")
        self._period, self._samples = setup.periods(self.bench.rate_hz)
        self._lines = setup.tone_lines(self.bench.rate_hz)

    @cached_property
    def noise(self) -> Shaken:
        """The shaker's noise."""
        low, high = self.setup.band_hz
        noise = band_noise(WHO, 1, self._period, self.bench.rate_hz, (low, high), self.setup.seed, even=True)
        return self._opened(self.setup.shaker, noise[0])

    @cached_property
    def tones(self) -> Shaken | None:
        """The shaker's tones, all at once; None where none are asked for."""
        if not self._lines:
            return None
        cycles = np.arange(self._period) / self._period
        period = np.sum([np.sin(2 * np.pi * k * cycles) for k in self._lines], axis=0) / len(self._lines)
        return self._opened(self.setup.shaker, period)

    def tones_db(self, tones: PayloadReduction) -> dict[float, float]:
        """Return the reduction of each tone, at the line it was sent at."""
        line_hz = self.bench.rate_hz / self._period
        lines = zip(self.setup.tones_hz, self._lines, strict=True)
        return {float(f): tones.line_db(line * line_hz) for f, line in lines}

    @cached_property
    def force(self) -> Shaken | None:
        """The noise of the actuator on the payload; None where none is named."""
        if self.setup.force is None:
            return None
        noise = band_noise(WHO, 1, self._period, self.bench.rate_hz, self.setup.band_hz, self.setup.seed + 1, even=True)
        return self._opened(self.setup.force, noise[0])

    def under(self, shaken: Shaken, law: StateSpace | Controller) -> PayloadReduction:
        """Return what a law does under one of the disturbances."""
        apart = self.setup.names
        acting = on_all_channels(law, self.own, self.bench, apart, WHO, self.setup.reads)
        return PayloadReduction(
            source=self.bench.actuators[shaken.actuator].name,
            level=shaken.level,
            band_hz=self.setup.band_hz,
            unit=self.bench.sensors[self._payload[0]].unit,
            sensors=self.setup.sensors,
            opened=shaken.opened,
            closed=self._run(shaken.actuator, shaken.sent, acting),
            silent=shaken.silent,
        )

    def apart(self) -> "OpenPayload":
        """Return this payload, listened to, on a copy of its bench as it stands then.

        A bench draws its noise by the number of the run: on a copy of its own no law's figures hang on which other laws
        ran before. What cannot be copied, a process or hardware, stays what it is.
        """
        for name in ("noise", "tones", "force"):
            getattr(self, name)
        try:
            bench = deepcopy(self.bench)
        except (TypeError, ValueError):
            return self
        alone = copy(self)
        alone.bench = bench
        return alone

    @cached_property
    def _silent(self) -> Heard:
        return self._run(0, np.zeros(self._samples), None)

    def _opened(self, name: str, period: FloatArray) -> Shaken:
        """Send a period of RMS one, or of tones, as loud as every reading allows."""
        actuator = place_of(name, self.bench.actuators, WHO, "actuator")
        level, full = (self.setup.sent_level(self.bench, actuator),) * 2
        while True:
            sent = level * repeated(period, self._samples)
            try:
                return Shaken(actuator, level, sent, self._run(actuator, sent, None, strict=True), self._silent)
            except _ClippedError:
                level *= QUIETER
                if level < QUIETEST * full:
                    raise InputError(
                        f"{WHO}: with {name} at {level:g} readings still meet their limits; shake less by 'level'."
                    ) from None

    def _run(self, actuator: int, sent: FloatArray, law: StateSpace | Controller | None, strict: bool = False) -> Heard:
        u = np.zeros((len(self.bench.actuators), self._samples))
        u[actuator] = sent
        record = self.bench.run(u, controller=law)
        last, rate = record.outputs[:, -self._period :], self.bench.rate_hz
        if strict and np.any(at_limits(record.outputs, record.sensors)[[*self._payload, *self._base]]):
            raise _ClippedError
        base = PeriodSpectrum.of(last[self._base], rate) if self._base else None
        largest = np.abs(record.inputs[:, -self._period :]).max(axis=1)
        return Heard(PeriodSpectrum.of(last[self._payload], rate), base, largest)


class _ClippedError(Exception):
    """A reading met its limit."""


@dataclass(frozen=True, eq=False)
class PayloadVibration:
    """What a law does for the payload: base shaken by noise and by tones, and a force on the payload itself."""

    noise: PayloadReduction
    tones: PayloadReduction | None
    tones_db: dict[float, float]
    force: PayloadReduction | None


def measure_payload(
    bench: Bench, controller: StateSpace | Controller, setup: PayloadSetup, *, opened: OpenPayload | None = None
) -> PayloadVibration:
    """Shake the base with the bench's own shaker and listen to the payload, with the law and without it.

    Each run sends the same period of noise, first until the plant has settled and then once more, measured: its lines
    have no leakage, and what two runs differ by is the law. Power is that of all the payload's sensors together.

    Args:
        bench: any bench with the named channels, or one that offers them by a method `instrumented()`; nothing of it is
            used but its `run`.
        controller: u = K y, of the bench's own channels; a model or anything that steps, compiled code too.
        setup: what shakes, what listens, over which band.
        opened: the same bench listened to before; its runs are made once for all laws.

    Returns:
        `PayloadVibration`; its `noise.reduction_db()` is the figure that counts.

    Raises:
        InputError: a channel that is not there, sensors of several units, a law of other channels.

    >>> import ultraquiet as uq
    >>> wires = "base proof mass", ("payload x", "payload y", "payload z")
    >>> setup = PayloadSetup(*wires, band_hz=(5.0, 100.0), seconds=1.0, settle_s=0.5)
    >>> idle = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((6, 0)), np.zeros((6, 6)), rate_hz=3500.0)
    >>> round(abs(measure_payload(uq.bench.Hexapod(linear=True), idle, setup).noise.reduction_db()), 6)
    0.0
    """
    listened = OpenPayload(bench, setup) if opened is None else opened
    with task("payload on the bench", 1 + bool(setup.tones_hz) + (setup.force is not None)) as progress:
        noise = listened.under(listened.noise, controller)
        progress.advance(note=f"{setup.shaker}, noise")
        tones = None if listened.tones is None else listened.under(listened.tones, controller)
        progress.advance(int(tones is not None), note=f"{setup.shaker}, tones")
        force = None if listened.force is None else listened.under(listened.force, controller)
        progress.advance(int(force is not None), note=f"{setup.force}, noise")
    each = {} if tones is None else listened.tones_db(tones)
    return PayloadVibration(noise, tones, each, force)
