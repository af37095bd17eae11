"""Commands that ramp: a law that integrates what its loop does not feel, an offset behind a plant that blocks it.

Such a pole stays on the stability boundary whatever the loop does; no burst rings it, and the command only runs away in
proportion to time, so that modes that grow and decay do not show it.
"""

from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench import Bench
from ultraquiet.simulate.growth.verdict import Seen
from ultraquiet.simulate.kick import ranges
from ultraquiet.values import StateSpace, StatusWord

BLOCKS = 16  # means of a record, from one to the next of which a ramp rises
SURE = 8.0  # deviations of the mean rise; noise that is integrated rises and falls
LASTS = 0.5  # share of its first rises that a ramp keeps to the end; what settles does not
HORIZON = 1000.0  # records within which the limits would be met


def ramping(bench: Bench, law: StateSpace | None, seen: Seen) -> Seen | None:
    """Return `not known` for a loop whose commands still ramp under a law that integrates, or None."""
    if law is None or not _integrates(law, seen.record.response.shape[1]):
        return None
    samples = seen.record.response.shape[1] // BLOCKS * BLOCKS
    rest = np.mean([run.inputs[:, -samples:] for run in seen.record.runs], axis=0)  # bursts cancel
    rises = np.diff(rest.reshape(len(rest), BLOCKS, -1).mean(axis=2), axis=1)
    a_second = rises.mean(axis=1) * BLOCKS * bench.rate_hz / samples
    with np.errstate(over="ignore"):  # of a command that stands still
        left_s = (ranges(bench.actuators) - np.abs(rest[:, -1])) / np.maximum(np.abs(a_second), np.finfo(float).tiny)
    steady = _steady(rises) & (left_s < HORIZON * samples / bench.rate_hz)
    if not steady.any():
        return None
    k = int(np.argmin(np.where(steady, left_s, np.inf)))
    actuator = bench.actuators[k]
    speed = f"{abs(a_second[k]):.3g} {actuator.unit}".rstrip()
    sentence = (
        f"The command of '{actuator.name}' ramps by {speed} a second and meets its limit {left_s[k]:.3g} s later: "
        "the law integrates what the loop does not take away."
    )
    return replace(seen, word=StatusWord.NOT_KNOWN, sentence=sentence)


def _integrates(law: StateSpace, samples: int) -> bool:
    """Return whether the law has a pole at rest that decays by less than an e-fold within a record."""
    return bool(law.states and np.any(np.abs(law.poles() - 1.0) * samples < 1.0))


def _steady(rises: FloatArray) -> np.ndarray:
    """Return which commands rise from one block to the next, beyond noise and to the end, `(nu,)`."""
    mean, spread = rises.mean(axis=1), rises.std(axis=1, ddof=1) / np.sqrt(rises.shape[1])
    quarter = rises.shape[1] // 4
    first, last = rises[:, :quarter].mean(axis=1), rises[:, -quarter:].mean(axis=1)
    return (np.abs(mean) > SURE * spread) & (np.abs(last) > LASTS * np.abs(first)) & (first * last > 0)
