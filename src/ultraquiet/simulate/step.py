"""What a loop makes of a step at each actuator, measured on the bench by its sensors."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.progress import task
from ultraquiet.bench import Bench
from ultraquiet.simulate.loop import disturb, samples_of
from ultraquiet.values import Record, StateSpace
from ultraquiet.values.controller import Controller

WHO = "step_reduction"
SETTLED = 0.02  # of the largest excursion: within it a reading has settled
ABOVE_NOISE = 4.0  # deviations of what a reading does before the step
LEAST = 2  # samples of a run: one before the step, one after it
REST_SHARE, END_SHARE = 0.1, 0.1  # of a run, before the step, and at its end: where a reading comes to


@dataclass(frozen=True, eq=False)
class StepReduction:
    """A step of `amplitude` at each actuator, one at a time; arrays are `(sensor, actuator)`.

    `open_peak`, `closed_peak`: largest excursion from rest, in the sensor's unit. `open_settling_s`,
    `closed_settling_s`: when the reading stays within 2 % of that excursion (or within its noise) about where it comes
    to; infinite where it does not within the run. `open_final`, `closed_final`: where it comes to.
    """

    amplitude: float
    open_peak: FloatArray
    closed_peak: FloatArray
    open_settling_s: FloatArray
    closed_settling_s: FloatArray
    open_final: FloatArray
    closed_final: FloatArray


def step_reduction(
    bench: Bench, controller: StateSpace | Controller, amplitude: float = 1.0, duration_s: float = 2.0
) -> StepReduction:
    """Disturb the actuators one after another with a step, open and closed loop, and compare the sensors.

    Args:
        bench: any bench; nothing of it is used but its `run`.
        controller: acts as u = K y.
        amplitude: of the step, in the actuator's unit; it begins after a tenth of the run.
        duration_s: length of each run in seconds.

    Returns:
        `StepReduction`.

    Raises:
        InputError: no amplitude, a duration too short for a step.
    """
    n = samples_of(WHO, duration_s, bench.rate_hz, LEAST)
    before = max(1, int(REST_SHARE * n))
    positive(WHO, "amplitude", amplitude)
    nu = len(bench.actuators)
    columns: list[list[tuple[FloatArray, FloatArray, FloatArray]]] = []
    with task("steps", 2 * nu) as progress:
        for k, actuator in enumerate(bench.actuators):
            d = np.zeros((nu, n))
            d[k, before:] = amplitude
            pair: list[tuple[FloatArray, FloatArray, FloatArray]] = []
            for law, word in ((None, "open"), (controller, "closed")):
                pair.append(_excursion(disturb(bench, d, law), before))
                progress.advance(note=f"{actuator.name} {word}")
            columns.append(pair)
    tables = np.moveaxis(np.array(columns), 0, -1)  # (open or closed, figure, sensor, actuator)
    (open_peak, open_settling, open_final), (closed_peak, closed_settling, closed_final) = tables
    return StepReduction(amplitude, open_peak, closed_peak, open_settling, closed_settling, open_final, closed_final)


def _excursion(record: Record, before: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return peak, settling time in seconds and final value of every reading, `(ny,)` each, from what was before."""
    n = record.samples
    rest, moved = record.outputs[:, :before], record.outputs[:, before:]
    moved = moved - rest.mean(axis=1, keepdims=True)
    peak = np.abs(moved).max(axis=1)
    final = moved[:, -max(1, int(END_SHARE * n)) :].mean(axis=1)
    tolerance = np.maximum(SETTLED * peak, ABOVE_NOISE * rest.std(axis=1))
    outside = np.abs(moved - final[:, None]) > tolerance[:, None]
    last = np.where(outside.any(axis=1), moved.shape[1] - np.argmax(outside[:, ::-1], axis=1), 0)
    # near the end of the run a reading that rings may lie within the tolerance by chance
    settled = last <= moved.shape[1] - END_SHARE / 2 * n
    return peak, np.where(settled, last / record.rate_hz, np.inf), final
