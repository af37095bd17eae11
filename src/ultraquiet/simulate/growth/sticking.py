"""Loops that die after a weak burst because something in the bench sticks, and run to their limits after a louder one.

Behind friction, a dead zone or a coarse converter an unstable loop comes to rest where it no longer moves. A linear
loop, stable or not, answers in proportion for as long as no channel stands at its limit; so what reaches the limits
after one burst, and was nowhere near them at the same time after one a little weaker, grows by itself in between.
"""

from dataclasses import replace

import numpy as np

from ultraquiet._base.errors import InterlockError
from ultraquiet.bench import Bench
from ultraquiet.simulate.growth.lowered import within_limits
from ultraquiet.simulate.growth.verdict import CLIPPED_SHARE, Seen, judged
from ultraquiet.simulate.kick import Burst, Bursts, FreeResponse, kicked, louder, ranges
from ultraquiet.values import Record, StateSpace, StatusWord
from ultraquiet.values.channel import stands_at_limits
from ultraquiet.values.controller import Controller

# Both bursts differ by less than this in the end, after so many in between; out of proportion is so many times more.
NEAR, BETWEEN, OUT_OF_PROPORTION = 1.3, 6, 3.0
JUST_BEFORE = 16  # samples before a command first stands at its limit
_Heard = tuple[Burst, FreeResponse]


def sticking(bench: Bench, law: StateSpace | Controller, bursts: Bursts, seen: Seen) -> Seen | None:
    """Return the verdict on a loop that was `seen` to decay and yet grows after a louder burst, or None.

    `bursts` are those that fill their share of the ranges; each is raised further where the loop, sticking, made it
    small. One that a guard ends says nothing.
    """
    for burst in (bursts.white, bursts.coloured):
        known = replace(burst, hums_hz=seen.record.hums_hz, outside_hz=seen.record.outside_hz)
        try:
            loud = louder(bench, law, known)
        except InterlockError as error:
            if error.of_time:
                raise
            continue
        again = judged(bench, loud[1])
        if loud[1].limited > CLIPPED_SHARE:
            again = _at_limits(bench, law, loud, again)
        if again is not None and again.word is StatusWord.UNSTABLE and not again.slow:
            return again
    return None


def _at_limits(bench: Bench, law: StateSpace | Controller, loud: _Heard, seen: Seen) -> Seen | None:
    """Return growth of what stays at its limits out of proportion to a burst a little weaker, which dies."""
    weak = within_limits(bench, law, *loud)
    if weak[1].limited > CLIPPED_SHARE:
        return None
    for _ in range(BETWEEN):
        if _ratio(loud, weak) < NEAR:
            break
        between = replace(loud[0], levels=np.sqrt(loud[0].levels * weak[0].levels))
        heard = kicked(bench, law, between)
        if heard.limited > CLIPPED_SHARE:
            loud = between, heard
        else:
            weak = between, heard
    times = OUT_OF_PROPORTION * _ratio(loud, weak)
    if not any(_out_of_proportion(*runs, times) for runs in zip(loud[1].runs, weak[1].runs, strict=True)):
        return None  # a stable loop may stay at its limits once it is there
    sentence = (
        f"After a burst of {_size(bench, loud[0])} commands stay at their limits, out of proportion to one of "
        f"{_size(bench, weak[0])}, after which it dies: something sticks, and the loop grows where that gives way."
    )
    return replace(seen, word=StatusWord.UNSTABLE, mode=None, sentence=sentence)


@np.errstate(over="ignore")  # over nothing at all
def _ratio(loud: _Heard, weak: _Heard) -> float:
    return float(np.max(loud[0].levels / np.maximum(weak[0].levels, np.finfo(float).tiny)))


def _out_of_proportion(loud: Record, weak: Record, times: float) -> bool:
    """Return whether commands just before they meet their limits are so many times those of the weaker burst."""
    first = np.flatnonzero(stands_at_limits(loud.inputs, loud.actuators).any(axis=0))
    if not first.size:
        return False
    window = slice(max(0, first[0] - JUST_BEFORE), first[0])
    reach = ranges(loud.actuators)[:, None]
    there = (float((np.abs(run.inputs[:, window]) / reach).max(initial=0.0)) for run in (loud, weak))
    return next(there) > times * next(there)


def _size(bench: Bench, burst: Burst) -> str:
    """Return the peak of a burst in words, on the actuator that gets most of it."""
    k = int(np.argmax(burst.levels))
    return f"{burst.levels[k]:.3g} {bench.actuators[k].unit}".rstrip()
