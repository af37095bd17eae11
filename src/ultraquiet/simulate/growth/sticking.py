"""Loops that die after a weak burst because something in the bench sticks, and run to their limits after a louder one.

Behind friction, a dead zone or a coarse converter an unstable loop comes to rest where it no longer moves. A linear
loop, stable or not, answers in proportion for as long as no channel stands at its limit; so what reaches the limits
after one burst, and was nowhere near them at the same time after one a little weaker, grows by itself in between.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from ultraquiet._base.errors import InterlockError, of_the_loop
from ultraquiet.bench import Bench
from ultraquiet.simulate.free_response import VISIBLE, Mode
from ultraquiet.simulate.growth.lowered import within_limits
from ultraquiet.simulate.growth.repeated import repeated
from ultraquiet.simulate.growth.verdict import CLIPPED_SHARE, LONGER, Seen, apart, decaying_before, judged, loudness
from ultraquiet.simulate.kick import Burst, Bursts, FreeResponse, ended_early, kicked, louder, tones_alone, used
from ultraquiet.values import Record, StateSpace, StatusWord
from ultraquiet.values.controller import Controller

# Both bursts differ by less than this in the end, after so many in between; out of proportion is so many times more.
NEAR, BETWEEN, OUT_OF_PROPORTION = 1.3, 6, 3.0
# Modes that are given a tone of their own; they decay by less than this in e-folds within a burst.
MOST_ALONE, RINGS = 6, 100.0
DIRECTIONS = 4  # in which a burst is to show that the loop grows by itself, before it is held not to
JUST_BEFORE = 16  # samples before a channel first stands at its limit
# Of what a burst set going, nothing to speak of; of what it was three eighths of a record before, less.
DEAD, FALLING = 0.01, 0.5
WIDTHS = 4.0  # of a record's lines, within which two modes are taken for one
_Heard = tuple[Burst, FreeResponse]


def sticking(bench: Bench, law: StateSpace | Controller, bursts: Bursts, seen: Seen) -> Seen | None:
    """Return the verdict on a loop that was `seen` to decay and yet grows after a louder burst, or None.

    `bursts` are those that fill their share of the ranges; each is raised further where the loop, sticking, made it
    small. After them comes a tone at each of the slowest modes: of a broadband burst little stays in a mode that rings
    for longer than the burst, perhaps less than what sticks. One that a guard ends says nothing.

    A loud burst may also raise a mode above the noise that was not heard before. Where it neither grows nor decays
    beyond doubt within the record, more records are asked: that all else has died says nothing of it.
    """
    outside = {"hums_hz": seen.record.hums_hz, "outside_hz": seen.record.outside_hz}
    doubts: list[float] = []
    for burst in (bursts.white, bursts.coloured, *_tones(bench, bursts.white, seen)):
        known = replace(burst, **outside)
        try:
            begun = tones_alone(bench, law, known, known.modes_hz) if known.modes_hz else known
            grown = _grown(bench, law, louder(bench, law, begun), seen, doubts)
        except InterlockError as error:
            if not of_the_loop(error):
                raise
            continue
        if grown is not None:
            return grown
    if not doubts:
        return None
    again = repeated(
        bench, law, replace(bursts.coloured, **outside), replace(seen, word=None, doubtful_hz=tuple(doubts))
    )
    return None if again.word is StatusWord.OK else again


def _grown(bench: Bench, law: StateSpace | Controller, loud: _Heard, seen: Seen, doubts: list[float]) -> Seen | None:
    """Return what a loud burst sets going that does not die, None where it dies.

    What decays by another rate at every size looks like other modes that grow, for a while: growth is believed where
    ever longer records show it, up to the one in which the loop was `seen` to decay, or where it ends at the limits.
    """
    burst, found = loud
    while found.limited <= CLIPPED_SHARE:
        again = judged(bench, found)
        if again.word is StatusWord.OK:
            return None
        at_length = burst.samples >= _longest(seen)
        if at_length:
            doubts += _unheard(again, seen, doubts)
        if _dies(found):
            return None
        if at_length:
            grows = again.word is StatusWord.UNSTABLE and not again.slow
            asked = again.mode is not None and again.mode.f_hz in doubts  # more records are to tell, and its own
            falls = _falls(found, seen.mode) or (asked and _is_slow(again.mode, found))
            return again if grows else None if falls else _rings_on(bench, burst, again)
        burst, found = _watched_longer(bench, law, burst, seen)
    grown = _at_limits(bench, law, (burst, found), seen)
    in_time = burst if burst.ends is not None else ended_early(burst, found.runs)
    if grown is not None or in_time is burst:
        return grown
    return _grown(bench, law, (in_time, kicked(bench, law, in_time)), seen, doubts)


def _unheard(again: Seen, seen: Seen, known: list[float]) -> list[float]:
    """Return where the longest record after a loud burst leaves a mode in doubt that no record before has heard."""
    width_hz = WIDTHS * again.record.runs[0].rate_hz / _longest(seen)
    heard = [*(mode.f_hz for mode in seen.modes), *known]
    return [
        mode.f_hz
        for mode in again.modes
        if not (mode.decays or seen.record.from_outside(mode.f_hz) or any(abs(mode.f_hz - f) < width_hz for f in heard))
    ]


def _longest(seen: Seen) -> int:
    return seen.record.response.shape[1]


def _watched_longer(bench: Bench, law: StateSpace | Controller, burst: Burst, seen: Seen) -> _Heard:
    longer = replace(burst, samples=min(_longest(seen), LONGER * burst.samples))
    return longer, kicked(bench, law, longer)


def _dies(found: FreeResponse) -> bool:
    """Return whether a response is down to its noise, or to little of its beginning and falling still."""
    eighths = loudness(found, 8)
    return bool(eighths[-1] <= max(VISIBLE, DEAD * eighths[0] * (eighths[-1] < FALLING * eighths[4])))


def _falls(found: FreeResponse, slowest: Mode | None) -> bool:
    """Return whether a response falls in the later half of its record, or has a mode too slow for that."""
    eighths = loudness(found, 8)
    return _is_slow(slowest, found) or bool(eighths[-1] < FALLING * eighths[4])


def _is_slow(mode: Mode | None, found: FreeResponse) -> bool:
    later_s = 3 / 8 * found.response.shape[1] / found.runs[0].rate_hz
    return mode is not None and -mode.growth_per_s * later_s < -math.log(FALLING)


def _rings_on(bench: Bench, burst: Burst, again: Seen) -> Seen:
    sentence = f"After a burst of {_size(bench, burst)} it rings on, and hardly falls in the later half of the record."
    return replace(again, word=None, sentence=sentence)


def _tones(bench: Bench, burst: Burst, seen: Seen) -> list[Burst]:
    """Return a burst for each of the slowest modes that ring for about as long as a burst, or longer."""
    rate = bench.rate_hz
    heard = chain(seen.modes, decaying_before(seen.record, rate))
    slow = (mode.f_hz for mode in heard if -mode.growth_per_s * burst.length < RINGS * rate)
    return [replace(burst, modes_hz=(f,)) for f in apart(slow, rate / burst.length)[:MOST_ALONE]]


def _at_limits(bench: Bench, law: StateSpace | Controller, loud: _Heard, seen: Seen) -> Seen | None:
    """Return growth of what stays at its limits out of proportion to a burst a little weaker, which dies.

    A loop that grows slowly takes longer to its limits the nearer its burst is to the weakest that sets it going.
    """
    while loud[1].limited > CLIPPED_SHARE:
        weak = within_limits(bench, law, *loud)
        if weak[1].limited > CLIPPED_SHARE:
            return None
        near, weak = _nearer(bench, law, loud, weak)
        times = OUT_OF_PROPORTION * _ratio(near, weak)
        disproportionate = any(
            _out_of_proportion(*runs, times) for runs in zip(near[1].runs, weak[1].runs, strict=True)
        )
        if disproportionate and (grown := _by_itself(bench, law, near, loud)):
            after = f"After a burst of {_size(bench, grown[0])} {grown[1].what_is_limited}s stay at their limits"
            sentence = (
                f"{after}, out of proportion to one of {_size(bench, weak[0])}, after which it dies: the bench does "
                "more for a loud command, as where something sticks until it gives way, and there the loop grows."
            )
            return replace(seen, word=StatusWord.UNSTABLE, mode=None, sentence=sentence, record=grown[1])
        if near[0].samples >= _longest(seen):
            break
        loud = _watched_longer(bench, law, near[0], seen)
    return None  # a stable loop may stay at its limits once it is there


def _by_itself(bench: Bench, law: StateSpace | Controller, *bursts: _Heard) -> _Heard | None:
    """Return the first of the bursts after which channels stay at their limits, were it but within its share of them.

    A tone that hardly overcomes what sticks does so much more than one that does not, and may drive a stable loop to
    limits that hold it there. Where a burst that ends in time dies, others are tried, which throw the loop elsewhere.
    """
    for burst, heard in chain(bursts, _others(bench, law, bursts)):
        free = kicked(bench, law, ended_early(burst, heard.runs))
        if free.limited > CLIPPED_SHARE:
            return burst, free
    return None


def _others(bench: Bench, law: StateSpace | Controller, bursts: Iterable[_Heard]) -> Iterator[_Heard]:
    for burst, _ in bursts:
        for more in range(1, DIRECTIONS):
            other = replace(burst, seed=burst.seed + more)
            yield other, kicked(bench, law, other)


def _nearer(bench: Bench, law: StateSpace | Controller, loud: _Heard, weak: _Heard) -> tuple[_Heard, _Heard]:
    """Return both bursts nearer to each other, one after which commands stay at their limits and one that dies."""
    for _ in range(BETWEEN):
        if _ratio(loud, weak) < NEAR:
            break
        between = replace(loud[0], levels=np.sqrt(loud[0].levels * weak[0].levels))
        heard = kicked(bench, law, between)
        if heard.limited > CLIPPED_SHARE:
            loud = between, heard
        else:
            weak = between, heard
    return loud, weak


@np.errstate(over="ignore")  # over nothing at all
def _ratio(loud: _Heard, weak: _Heard) -> float:
    return float(np.max(loud[0].levels / np.maximum(weak[0].levels, np.finfo(float).tiny)))


def _out_of_proportion(loud: Record, weak: Record, times: float) -> bool:
    """Return whether channels just before one meets its limit use so many times what they do after the weaker burst."""
    shares = used(loud)
    first = np.flatnonzero((shares >= 1.0).any(axis=0))
    if not first.size:
        return False
    window = slice(max(0, first[0] - JUST_BEFORE), first[0])
    there = (float(each[:, window].max(initial=0.0)) for each in (shares, used(weak)))
    return next(there) > times * next(there)


def _size(bench: Bench, burst: Burst) -> str:
    """Return the peak of a burst in words, on the actuator that gets most of it."""
    k = int(np.argmax(burst.levels))
    return f"{burst.levels[k]:.3g} {bench.actuators[k].unit}".rstrip()
