"""Run a loop on a bench and say whether it stays calm."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Bench
from ultraquiet.values import Record, StateSpace, Status, StatusWord
from ultraquiet.values.controller import Controller

# A calm loop ends with the noise it began with. Growth by this factor between the second and the last quarter of an
# undisturbed run, or a command at its limit, is called unstable.
GROWTH_LIMIT = 3.0


@dataclass(frozen=True)
class LoopCheck:
    """What an undisturbed closed loop did: RMS of sensors and commands `(ny,)`, `(nu,)` in volts, and the verdict."""

    status: Status
    sensor_rms_v: FloatArray
    command_rms_v: FloatArray


def disturb(bench: Bench, disturbance: FloatArray, controller: StateSpace | Controller | None = None) -> Record:
    """Run the bench with a disturbance `(nu, n)` in volts at the plant's input and no command of its own."""
    d = np.asarray(disturbance, dtype=np.float64)
    if d.ndim != 2 or d.shape[0] != len(bench.actuators):
        raise InputError(f"simulate: the disturbance must be ({len(bench.actuators)}, n), got shape {d.shape}.")
    return bench.run(np.zeros_like(d), disturbance=d, controller=controller)


def check_stability(bench: Bench, controller: StateSpace | Controller, duration_s: float = 2.0) -> LoopCheck:
    """Close the loop on a bench at rest, give it a kick and watch whether it settles.

    The kick is one volt on every actuator for ten samples; the loop must end no louder than `GROWTH_LIMIT` times what
    it was in the second quarter, without commands at their limits.
    """
    n = int(positive("check_stability", "duration_s", duration_s, "s") * bench.rate_hz)
    kick = np.zeros((len(bench.actuators), n))
    kick[:, :10] = 1.0
    record = disturb(bench, kick, controller)
    quarter = n // 4
    early = _rms(record.outputs[:, quarter : 2 * quarter])
    late = _rms(record.outputs[:, -quarter:])
    commands = _rms(record.inputs[:, -quarter:])
    limits = np.array([max(abs(c.low), abs(c.high)) for c in record.actuators])
    saturated = int(np.count_nonzero(np.abs(record.inputs[:, -quarter:]) >= limits[:, None] * (1 - 1e-9)))
    growth = float(np.max(late / np.maximum(early, np.finfo(float).tiny)))
    if saturated or growth > GROWTH_LIMIT:
        sentence = (
            f"The loop is not stable on this bench: sensors grew {growth:.3g} times between the second and the last "
            f"quarter of {duration_s:g} s and {saturated} commands stood at their limit."
        )
        return LoopCheck(Status(StatusWord.UNSTABLE, sentence), late, commands)
    return LoopCheck(Status(StatusWord.OK, f"The loop settled; sensors end at {late.max():.3g} V RMS."), late, commands)


def _rms(signal: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(signal**2, axis=1))
