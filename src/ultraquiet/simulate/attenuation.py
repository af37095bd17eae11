"""Attenuation of tones, measured on the bench by its sensors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet.bench import Bench
from ultraquiet.simulate.loop import disturb
from ultraquiet.values import Record, StateSpace
from ultraquiet.values.channel import at_limits
from ultraquiet.values.controller import Controller

# The part of the run that is measured; before it the loop settles.
MEASURED_SHARE = 0.5


@dataclass(frozen=True)
class Attenuation:
    """Attenuation of tones, one row a tone, one column a sensor; positive is quieter.

    `reduction_db` = -20 log10(|y closed| / |y open|): what closing the loop does. This is the number that counts.
    `paper_db` = -20 log10(|y closed| / |d|): what the paper quotes; it counts the plant's own gain as well.
    `open_v`, `closed_v`: amplitudes of the tone at the sensors, `floor_v` the amplitude that noise alone would show.
    """

    tones_hz: tuple[float, ...]
    reduction_db: FloatArray
    paper_db: FloatArray
    open_v: FloatArray
    closed_v: FloatArray
    floor_v: FloatArray
    opened: tuple[Record, ...]
    closed: tuple[Record, ...]

    @property
    def cut(self) -> tuple[tuple[str, ...], ...]:
        """Names of the sensors that stood at an end of their range, open or closed, one tuple per tone.

        What they show of a tone is not what it was.
        """
        pairs = [
            np.add(*(at_limits(run.outputs, run.sensors) for run in both))
            for both in zip(self.opened, self.closed, strict=True)
        ]
        sensors = self.opened[0].sensors
        return tuple(tuple(c.name for c, n in zip(sensors, counts, strict=True) if n) for counts in pairs)

    @property
    def worst_reduction_db(self) -> FloatArray:
        """Smallest `reduction_db` over the channels, one per tone."""
        return self.reduction_db.min(axis=1)

    @property
    def worst_paper_db(self) -> FloatArray:
        """Smallest `paper_db` over the channels, one per tone."""
        return self.paper_db.min(axis=1)


def attenuation(
    bench: Bench,
    controller: StateSpace | Controller,
    tones_hz: Sequence[float],
    amplitude_v: float = 1.0,
    duration_s: float = 2.0,
) -> Attenuation:
    """Disturb all actuators with a tone, open and closed loop, and compare the sensors.

    The tone enters at the plant's input on all channels at once, as in the paper's section 4.2; its amplitude at each
    sensor is fitted by least squares over the second half of the run, with the mean removed.

    Args:
        bench: any bench; nothing of it is used but its `run`.
        controller: acts as u = K y.
        tones_hz: frequencies of the tones in Hz, those that disturb this bench.
        amplitude_v: amplitude d of each tone in units of the actuators.
        duration_s: length of each run in seconds.

    Returns:
        Attenuation with rows per tone and columns per sensor, and the records of both runs of each tone.

    Raises:
        InputError: no tone, one above the Nyquist frequency or slower than the measured half of the run, no amplitude.
    """
    rate, n = bench.rate_hz, int(positive("attenuation", "duration_s", duration_s, "s") * bench.rate_hz)
    lowest = 1.0 / (MEASURED_SHARE * duration_s)
    positive("attenuation", "amplitude_v", amplitude_v)
    if np.ndim(tones_hz) != 1 or not len(tones_hz):
        raise InputError(f"attenuation: 'tones_hz' must be a list of tones, got {tones_hz!r}.")
    rows: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    runs: list[tuple[Record, Record]] = []
    with task("closed loop", 2 * len(tones_hz)) as progress:
        for tone_hz in tones_hz:
            f = between("attenuation", "tones_hz", tone_hz, lowest, rate / 2, "Hz")
            d = np.tile(amplitude_v * np.sin(2 * np.pi * f * np.arange(n) / rate), (len(bench.actuators), 1))
            opened = disturb(bench, d)
            progress.advance(note=f"{f:g} Hz open")
            closed = disturb(bench, d, controller)
            progress.advance(note=f"{f:g} Hz closed")
            rows.append((*_tone(closed, f), _tone(opened, f)[0]))
            runs.append((opened, closed))
    closed_v, floor_v, open_v = (np.array(column) for column in zip(*rows, strict=True))
    return Attenuation(
        tones_hz=tuple(float(f) for f in tones_hz),
        reduction_db=20 * np.log10(open_v / closed_v),
        paper_db=20 * np.log10(amplitude_v / closed_v),
        open_v=open_v,
        closed_v=closed_v,
        floor_v=floor_v,
        opened=tuple(o for o, _ in runs),
        closed=tuple(c for _, c in runs),
    )


def _tone(record: Record, f_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return the amplitude of a tone at each sensor and the amplitude that the rest of the signal would feign."""
    start = int(record.samples * (1 - MEASURED_SHARE))
    y = record.outputs[:, start:]
    angle = 2 * np.pi * f_hz * np.arange(start, record.samples) / record.rate_hz
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, y.T, rcond=None)
    rest = y.T - basis @ fitted
    amplitude = np.hypot(fitted[0], fitted[1])
    # Standard deviation of a least-squares amplitude in white noise: sigma sqrt(2 / n).
    return np.maximum(amplitude, np.finfo(float).tiny), rest.std(axis=0) * np.sqrt(2.0 / y.shape[1])
