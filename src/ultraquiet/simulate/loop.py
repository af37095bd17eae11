"""Run a loop on a bench."""

from contextlib import nullcontext

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError, asking
from ultraquiet._base.shown.line import counted
from ultraquiet.bench import Bench
from ultraquiet.values import Record, StateSpace
from ultraquiet.values.controller import Controller


def disturb(bench: Bench, disturbance: FloatArray, controller: StateSpace | Controller | None = None) -> Record:
    """Run the bench with a disturbance `(nu, n)`, in the actuators' units at the plant's input, and no own command.

    What fails without a law is marked as `of_question`.
    """
    d = np.asarray(disturbance, dtype=np.float64)
    if d.ndim != 2 or d.shape[0] != len(bench.actuators):
        raise InputError(f"simulate: the disturbance must be ({len(bench.actuators)}, n), got shape {d.shape}.")
    with nullcontext() if controller is not None else asking():
        return bench.run(np.zeros_like(d), disturbance=d, controller=controller)


def samples_of(who: str, duration_s: float, rate_hz: float, least: int) -> int:
    """Return how many samples a run of `duration_s` has.

    Raises:
        InputError: fewer than `least`.
    """
    samples = int(positive(who, "duration_s", duration_s, "s") * rate_hz)
    if samples < least:
        raise InputError(
            f"{who}: 'duration_s' = {duration_s:g} s holds {counted(samples, 'sample')}; it takes {least} or more, "
            f"{least / rate_hz:g} s here."
        )
    return samples
