"""Attenuation of tones, measured on the bench by its sensors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, positive, tone_below_nyquist
from ultraquiet._base.errors import InputError, InterlockError, asking
from ultraquiet._base.progress import Task, task
from ultraquiet.bench import Bench
from ultraquiet.simulate.loop import disturb, samples_of
from ultraquiet.values import Record, StateSpace
from ultraquiet.values.channel import at_limits
from ultraquiet.values.controller import Controller

# The part of the run that is measured; before it the loop settles.
MEASURED_SHARE = 0.5
LEAST = 5  # samples of a run: what is measured of fewer holds no whole period of any tone below Nyquist
# A run in which the tone has not settled is made again, this many times longer, as often as this.
LONGER, LENGTHENED = 4, 2
# It has settled where it changes by no more than half a dB until the longest run's end, or so many deviations of noise.
SETTLED_DB, DEVIATIONS = 0.5, 5.0


@dataclass(frozen=True)
class Attenuation:
    """Attenuation of tones, one row a tone, one column a sensor; positive is quieter.

    `reduction_db` = -20 log10(|y closed| / |y open|): what closing the loop does. This is the number that counts.
    `paper_db` = -20 log10(|y closed| / |d|): what the paper quotes; it counts the plant's own gain as well.
    `open_v`, `closed_v`: amplitudes of the tone at the sensors, `floor_v` the amplitude that noise alone would show.
    `settled`: whether a tone's amplitude stood still while it was measured, one per tone; where it did not, the longest
    run was too short for the loop, and the reduction is that of the second half of it.
    """

    tones_hz: tuple[float, ...]
    reduction_db: FloatArray
    paper_db: FloatArray
    open_v: FloatArray
    closed_v: FloatArray
    floor_v: FloatArray
    opened: tuple[Record, ...]
    closed: tuple[Record, ...]
    settled: tuple[bool, ...]

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
    sensor is fitted by least squares over the second half of the run, with the mean removed. Where the two halves of
    what was measured differ, a slow mode still rings: both runs are made again four times longer, and once more.

    Args:
        bench: any bench; nothing of it is used but its `run`.
        controller: acts as u = K y.
        tones_hz: frequencies of the tones in Hz, those that disturb this bench.
        amplitude_v: amplitude d of each tone in units of the actuators.
        duration_s: length of each run in seconds, of the first pair where the loop needs longer ones.

    Returns:
        Attenuation with rows per tone and columns per sensor, and the records of both runs of each tone.

    Raises:
        InputError: no tone, one not below the Nyquist frequency or slower than the measured half of the run, no
            amplitude; a run too short for any tone.
    """
    with asking():
        n = samples_of("attenuation", duration_s, bench.rate_hz, LEAST)
        positive("attenuation", "amplitude_v", amplitude_v)
        if np.ndim(tones_hz) != 1 or not len(tones_hz):
            raise InputError(f"attenuation: 'tones_hz' must be a list of tones, got {tones_hz!r}.")
        tones = tuple(tone_below_nyquist("attenuation", "tones_hz", tone_hz, bench.rate_hz) for tone_hz in tones_hz)
        for f in tones:
            between("attenuation", "tones_hz", f, slowest_tone_hz(duration_s), bench.rate_hz / 2, "Hz")
    rows: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    runs: list[tuple[Record, Record]] = []
    with task("closed loop", 2 * len(tones_hz)) as progress:
        for f in tones:
            opened, closed = _settled_runs(bench, controller, f, amplitude_v, n, progress)
            rows.append((*_tone(closed, f), _tone(opened, f)[0]))
            runs.append((opened, closed))
    closed_v, floor_v, open_v = (np.array(column) for column in zip(*rows, strict=True))
    return Attenuation(
        tones_hz=tones,
        reduction_db=20 * np.log10(open_v / closed_v),
        paper_db=20 * np.log10(amplitude_v / closed_v),
        open_v=open_v,
        closed_v=closed_v,
        floor_v=floor_v,
        opened=tuple(o for o, _ in runs),
        closed=tuple(c for _, c in runs),
        settled=tuple(all(_has_settled(run, f) for run in both) for both, f in zip(runs, tones, strict=True)),
    )


def slowest_tone_hz(duration_s: float) -> float:
    """Return the slowest tone in Hz that runs of so many seconds measure: a period of it fills the measured part."""
    return 1.0 / (MEASURED_SHARE * duration_s)


def shortest_run_s(tone_hz: float) -> float:
    """Return the length in seconds of the shortest run that measures a tone; see `slowest_tone_hz`."""
    return 1.0 / (MEASURED_SHARE * tone_hz)


def _settled_runs(
    bench: Bench, controller: StateSpace | Controller, f_hz: float, amplitude: float, samples: int, progress: Task
) -> tuple[Record, Record]:
    """Return a run without and one with the loop, long enough for the tone to settle in both if the longest is.

    A bench whose own limit of time ends a longer run has shown what it can: the runs before stand.
    """

    def both(samples: int, step: int) -> tuple[Record, Record]:
        d = amplitude * np.sin(2 * np.pi * f_hz * np.arange(samples) / bench.rate_hz)
        d = np.tile(d, (len(bench.actuators), 1))
        opened = disturb(bench, d)
        progress.advance(step, note=f"{f_hz:g} Hz open")
        closed = disturb(bench, d, controller)
        progress.advance(step, note=f"{f_hz:g} Hz closed")
        return opened, closed

    runs = both(samples, 1)
    for _ in range(LENGTHENED):
        if all(_has_settled(run, f_hz) for run in runs):
            break
        samples *= LONGER
        try:
            runs = both(samples, 0)
        except InputError:  # one that is too long for the bench is refused beforehand
            break
        except InterlockError as error:
            if error.of_time:
                break
            raise
    return runs


def _has_settled(record: Record, f_hz: float) -> bool:
    """Return whether the tone is the same, in amplitude and phase, in both halves of what is measured.

    What changes slowly has far to go: at the pace seen it must stay within half a dB to the longest run's end. Both
    halves hold whole periods, so that harmonics of the tone move neither; less than a period a half says nothing.
    """
    start = int(record.samples * (1 - MEASURED_SHARE))
    period = record.rate_hz / f_hz
    length = round(int((record.samples - start) / 2 / period) * period)
    if not length:
        return True
    middle, end = record.samples - length, record.samples
    (before, noise), (after, later) = (_fitted(record, f_hz, stop - length, stop) for stop in (middle, end))
    pace = np.abs(after - before) / length * record.samples * LONGER**LENGTHENED
    allowed = (10 ** (SETTLED_DB / 20) - 1) * np.maximum(np.abs(before), np.abs(after))
    return bool(np.all((pace <= allowed) | (np.abs(after - before) <= DEVIATIONS * np.hypot(noise, later))))


def _tone(record: Record, f_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return the amplitude of a tone at each sensor and the amplitude that the rest of the signal would feign."""
    phasor, floor = _fitted(record, f_hz, int(record.samples * (1 - MEASURED_SHARE)), None)
    return np.maximum(np.abs(phasor), np.finfo(float).tiny), floor


def _fitted(record: Record, f_hz: float, start: int, stop: int | None) -> tuple[ComplexArray, FloatArray]:
    """Return a tone's complex amplitude at each sensor, and the deviation that the rest of the signal gives it."""
    y = record.outputs[:, start:stop]
    angle = 2 * np.pi * f_hz * np.arange(start, start + y.shape[1]) / record.rate_hz
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, y.T, rcond=None)
    rest = y.T - basis @ fitted
    # Standard deviation of a least-squares amplitude in white noise: sigma sqrt(2 / n).
    return fitted[0] - 1j * fitted[1], rest.std(axis=0) * np.sqrt(2.0 / y.shape[1])
