"""A list without its bench moving: what would be sent, how long it would take, what it would leave on the disk."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.experiments.clock import real_time
from ultraquiet.experiments.folder import needed_bytes
from ultraquiet.experiments.listed import NO_BENCH, ExperimentList
from ultraquiet.experiments.plan import Drive, Measurement, Pause, Step, duration_s
from ultraquiet.values import Channel

# The band of a signal is where it has all but this part of its power, half of the rest on either side.
LEFT_OUT = 0.01


@dataclass(frozen=True)
class Sent:
    """One signal on one actuator as it would really be sent: `band_hz` holds 99 % of its power."""

    what: str
    actuator: str
    unit: str
    peak: float
    rms: float
    band_hz: tuple[float, float]


@dataclass(frozen=True)
class DryStep:
    """One step of a list: what it is, on which line it stands, when it would begin and how long it would take.

    `controller` is the file of the law that closes the loop, empty in open loop. What a controller adds to the
    commands is not known before the bench moves; `excitation` and `disturbance` are what the list itself sends.
    """

    line: int
    do: str
    name: str
    begins_s: float
    lasts_s: float
    samples: int
    excitation: tuple[Sent, ...]
    disturbance: tuple[Sent, ...]
    controller: str


@dataclass(frozen=True)
class DryRun:
    """A list as it would run: its steps, its time on the bench, and the disk it needs at most.

    `waits_s` are the pauses within `duration_s`; on a simulated bench (`real_time` False) they cost no time, and the
    rest takes as long as the simulation does.
    """

    steps: tuple[DryStep, ...]
    duration_s: float
    waits_s: float
    real_time: bool
    disk_bytes: int


def dry_run(listed: ExperimentList) -> DryRun:
    r"""Return what a checked list would do on its bench; nothing moves.

    Raises:
        InputError: the list knows no bench; plan it for one with `listed.on(bench)`.

    >>> from ultraquiet.experiments import parse
    >>> text = '[bench]\nmethod = "hexapod"\n[[commands]]\ndo = "excite"\nname = "sine"\nactuator = "strut 2"\n'
    >>> planned = dry_run(parse(text + 'signal = { method = "tone", frequency_hz = 60.0, amplitude = 10.0 }'))
    >>> step = planned.steps[0]
    >>> step.name, round(step.lasts_s, 2), step.excitation[0].actuator, round(step.excitation[0].rms, 2)
    ('sine', 1.17, 'strut 2', 7.07)
    """
    if listed.bench is None:
        raise InputError(f"{listed.name}: {NO_BENCH}")
    rate_hz = float(listed.bench.rate_hz)
    waits_s = float(sum(step.seconds for step in listed.steps if isinstance(step, Pause)))
    return DryRun(
        tuple(_steps(listed.steps, tuple(listed.bench.actuators), rate_hz)),
        duration_s(listed.steps, rate_hz),
        waits_s,
        real_time(listed.bench),
        needed_bytes(listed),
    )


def _steps(steps: tuple[Step, ...], actuators: tuple[Channel, ...], rate_hz: float) -> Iterator[DryStep]:
    at_s = 0.0
    for step in steps:
        lasts_s = duration_s([step], rate_hz)
        if isinstance(step, Measurement):
            sent = [
                tuple(_sent(drive, actuators, step.samples, rate_hz) for drive in drives)
                for drives in (step.drives, step.disturbances)
            ]
            do = "excite" if step.drives else "record"
            yield DryStep(step.line, do, step.name, at_s, lasts_s, step.samples, sent[0], sent[1], step.controller_file)
        elif isinstance(step, Pause):
            yield DryStep(step.line, "wait", "", at_s, lasts_s, 0, (), (), "")
        else:
            yield DryStep(step.line, "temperature", step.name, at_s, lasts_s, 0, (), (), "")
        at_s += lasts_s


def _sent(drive: Drive, actuators: tuple[Channel, ...], samples: int, rate_hz: float) -> Sent:
    u = drive.signal.generate(samples=samples, rate_hz=rate_hz, seed=drive.seed)
    channel = actuators[drive.actuator]
    peak, rms = float(np.abs(u).max()), float(np.sqrt(np.mean(np.square(u))))
    return Sent(drive.method, channel.name, channel.unit, peak, rms, band_hz(u, rate_hz))


def band_hz(u: FloatArray, rate_hz: float) -> tuple[float, float]:
    """Return the band in Hz that holds 99 % of a signal's power, `(0, 0)` of a silent one.

    >>> t = np.arange(1000) / 1000.0
    >>> band_hz(np.sin(2 * np.pi * 50.0 * t) + np.sin(2 * np.pi * 80.0 * t), 1000.0)
    (50.0, 80.0)
    """
    power = np.square(np.abs(np.fft.rfft(u)))
    total = np.cumsum(power)
    if total[-1] == 0.0:
        return 0.0, 0.0
    low, high = np.searchsorted(total, [total[-1] * LEFT_OUT / 2, total[-1] * (1 - LEFT_OUT / 2)])
    return float(low * rate_hz / u.size), float(high * rate_hz / u.size)
