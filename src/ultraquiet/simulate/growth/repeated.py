"""Several records of a loop, where one alone leaves a doubt that more may end."""

from dataclasses import replace

import numpy as np

from ultraquiet.bench import Bench
from ultraquiet.experiments import real_time
from ultraquiet.simulate.frames import Frames
from ultraquiet.simulate.free_response import CERTAIN
from ultraquiet.simulate.growth.together import Together
from ultraquiet.simulate.growth.verdict import (
    CLIPPED_SHARE,
    GROWTH_LIMIT,
    LONGER,
    Seen,
    apart,
    at_rest,
    grows,
    risen,
    told,
)
from ultraquiet.simulate.kick import Burst, FreeResponse, kicked, tones_alone
from ultraquiet.values import StateSpace, StatusWord
from ultraquiet.values.controller import Controller

# Records of the greatest length that are judged together before nothing is known, as long as so many could tell, or
# more shorter ones: an hour of a bench that takes its time, more where time is computed; the share of them after which
# nothing that lasts must be heard.
REPEATS_WAITED, REPEATS_COMPUTED, UNHEARD = 60, 400, 0.25
# Bursts of so many phases, in turn: all at the modes in doubt alone, so many times as loud as a first one may be, for
# these modes hardly grow within the record; where that touches the limits, no louder, then less.
PHASES, LOUDER = 4, (2.0, 1.0, 0.5)
# Records that touched a limit, one and this share of all. What went before is used; the last steps toward a limit are
# lost with the window that reaches it, which makes decay of growth: by less than a third of a deviation up to here.
TOUCHED = 0.05
# They are judged each time that they are so much more, and one.
LATER = 0.125
# A tone was chance where nothing lasts in so many records; so many tell a mode at 0 Hz from readings that wander.
QUIET = 10
# Whether more could tell is asked of the largest growth or decay within so many deviations of what was seen.
PLAUSIBLE = 2.0


def repeated(bench: Bench, law: StateSpace | Controller, burst: Burst, seen: Seen) -> Seen:
    """Return what several records say together, where one alone leaves a doubt that more may end.

    Records in which noise drives a command to its limit say little of modes, and to leave them out would make growth
    look like decay: where they are more than a few, all are made anew, with quieter bursts, then shorter and more of
    them, as noise needs time to heap up.

    Args:
        bench: any bench.
        law: what closes the loop.
        burst: its `samples` are those of the shortest record.
        seen: what the longest record said.
    """
    if seen.word is not None or not seen.doubtful_hz:
        return seen
    repeats = REPEATS_WAITED if real_time(bench) else REPEATS_COMPUTED
    samples = longest = seen.record.response.shape[1]
    seen = replace(seen, longest=longest)
    while samples:
        for louder in LOUDER:
            found = _so_often(bench, law, replace(burst, samples=samples), seen, repeats * longest // samples, louder)
            if found is not None:
                return _as_far_as_looked(seen, found, bench.rate_hz / burst.length)
        # the shortest is tried too, be it more or less than this share
        samples = max(samples // LONGER, burst.samples) if samples > burst.samples else 0
    return seen


def _as_far_as_looked(doubted: Seen, found: Seen, width_hz: float) -> Seen:
    """Return what was found; no `ok` where more was in doubt than was looked at, or commands met their limits alone."""
    looked = apart(doubted.doubtful_hz, width_hz)
    left = [f for f in doubted.doubtful_hz if all(abs(f - other) > width_hz for other in looked)]
    if found.word is not StatusWord.OK or not (left or doubted.record.limited > CLIPPED_SHARE):
        return found
    more = f"More tones are in doubt than the {len(looked)} that were looked at." if left else doubted.sentence
    return replace(found, word=None, sentence=more)


def _so_often(
    bench: Bench, law: StateSpace | Controller, burst: Burst, seen: Seen, most: int, louder: float
) -> Seen | None:
    """Return what up to so many records of the burst's length say together; None where too many touched a limit."""
    tones = apart(seen.doubtful_hz, bench.rate_hz / burst.length)
    known = Together(Frames(burst.samples, bench.rate_hz), tones)
    if seen.record.response.shape[1] == burst.samples == seen.record.before_limits:
        known = known.beside(seen.record)
    bursts: list[Burst] = []
    short = replace(burst, samples=min(burst.samples, burst.length))  # its free response matters little for the level
    # the second says more than its share of all: the burst before it was not at the modes in doubt alone
    looked = 2
    while known.records < most:
        if len(bursts) < PHASES:
            other = replace(short, seed=burst.seed + 1 + len(bursts))
            bursts.append(tones_alone(bench, law, other, tones))
        other = bursts[known.records % len(bursts)]
        found = kicked(bench, law, replace(other, levels=louder * other.levels, samples=burst.samples))
        known = known.beside(found)
        if known.touched > 1 + TOUCHED * known.records:
            return None
        if known.records < min(looked, most):
            continue
        looked = known.records + 1 + int(LATER * known.records)
        seen = _together(replace(seen, record=found), known)
        if seen.word is not None or not _may_be_told(known, most, found):
            break
    return seen


def _may_be_told(known: Together, most: int, record: FreeResponse) -> bool:
    """Whether the most records that there may be could tell what is in doubt: deviations fall with their root.

    However many there are, none tells what a hum at its frequency may ring up by itself.
    """
    left = np.sqrt(known.records / most)
    for modes in known.modes():
        if modes is None and known.records >= UNHEARD * most:
            return False
        for mode in modes or ():
            if mode.grows and not grows(mode, record):
                return False
            if CERTAIN * left * mode.growth_std > abs(mode.growth_per_s) + PLAUSIBLE * mode.growth_std:
                return False
    return True


def _together(seen: Seen, known: Together) -> Seen:
    """Judge the modes in doubt by all records."""
    bands = known.modes()
    modes = sorted((mode for band in bands for mode in band or ()), key=lambda mode: -mode.growth_per_s)
    few = known.records < QUIET
    drifts = few and any(at_rest(mode, seen.record) for mode in modes)
    growing = next((m for m in modes if grows(m, seen.record) and not (few and at_rest(m, seen.record))), None)
    doubted = max((m for m in modes if not m.decays), key=lambda m: m.growth_per_s + m.growth_std, default=None)
    shown = doubted or (modes[0] if modes else None)
    seen = replace(
        seen, records=known.records, mode=shown or seen.mode, sentence=told(shown) if shown else seen.sentence
    )
    if growing is not None:
        return replace(seen, word=StatusWord.UNSTABLE, mode=growing, sentence=told(growing))
    # a tone of a long record may be too quiet to be heard in shorter ones
    unheard = () in bands and (few or seen.record.response.shape[1] < seen.longest)
    if doubted is not None or drifts or None in bands or unheard:
        return seen
    if known.rise > GROWTH_LIMIT:
        return replace(seen, sentence=risen(known.rise))
    if shown is None:  # what was in doubt was chance, and is nothing to tell
        slowest = next((mode for mode in seen.modes if mode.decays), None)
        seen = replace(seen, mode=slowest, sentence=told(slowest) if slowest else "")
    return replace(seen, word=StatusWord.OK)
