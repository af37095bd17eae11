"""What one record of a loop's free response says of its stability."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench import Bench
from ultraquiet.simulate.free_response import ROUNDING, Mode, ringing
from ultraquiet.simulate.growth.coincident import ABOVE_DRIFT
from ultraquiet.simulate.growth.together import powers, rise
from ultraquiet.simulate.kick import FreeResponse, near
from ultraquiet.values import StatusWord

# A record shorter than this shows nothing; each next one is so many times longer.
SHORTEST_SAMPLES, LONGER = 128, 4
# Shares of a free response that a command stands at its limit: a loop that ran away does so for more than the first;
# one that does for more than the second is no longer the linear loop whose modes could be judged.
LIMITED_SHARE, CLIPPED_SHARE = 0.1, 0.01
# Noise alone does not grow so much between the second and the last quarter of a run of a loop that is stable.
GROWTH_LIMIT = 3.0
# A hum at the frequency of a mode rings it up in proportion to time: that adds to one so much louder than the hum no
# more than one over that in e-folds within a record, and to one that was at rest two, by least squares. What drifts
# does as it likes.
ADDED, RUNG_UP = 20.0, 4.0
# Readings may wander, and what wanders looks like growth at 0 Hz: within one record that is believed from so many
# e-folds on, well above the noise, which wanders too; less is left to several records together.
UNDRIFTED = 6.0
# Tones of one burst at most.
MOST_TONES = 12


@dataclass(frozen=True)
class Seen:
    """What one record said: a word, or None where it takes a longer one; the slowest mode, and a sentence."""

    word: StatusWord | None
    mode: Mode | None
    sentence: str
    record: FreeResponse
    modes: tuple[Mode, ...]
    doubtful_hz: tuple[float, ...]
    hidden_hz: tuple[float, ...] = ()
    slow: bool = False
    records: int = 1
    longest: int = 0


def judged(bench: Bench, record: FreeResponse) -> Seen:
    """Return what one record says: growth, decay, limits met, or what is in doubt."""
    rate, span = bench.rate_hz, record.response.shape[1] / bench.rate_hz
    heard = ringing(record.response, record.noise, rate)
    modes = heard.modes
    slowest = modes[0] if modes else slowest_before(record, rate)
    tones = tuple(f for f in heard.tones_hz if not record.from_outside(f))
    doubtful = (*(mode.f_hz for mode in modes if not mode.decays), *tones)
    said = "" if slowest is None else told(slowest)
    seen = Seen(None, slowest, said, record, modes, doubtful, hidden_hz=heard.hidden_hz)
    growing = next((mode for mode in modes if grows(mode, record) and not may_drift(mode, record)), None)
    grown = rise(powers(record.noise))
    doubted = max((m for m in modes if not m.decays), key=lambda m: m.growth_per_s + m.growth_std, default=slowest)
    if record.limited > LIMITED_SHARE:
        stood = f"A {record.what_is_limited} stood at its limit for {record.limited:.0%}"
        sentence = f"{stood} of the last quarter of {span:.3g} s."
        seen = replace(seen, word=StatusWord.UNSTABLE, sentence=sentence)
    elif record.limited > CLIPPED_SHARE:
        what = record.what_is_limited
        sentence = f"Without a burst a {what} stood at its limit for {record.limited:.1%} of the last quarter."
        seen = replace(seen, sentence=sentence)
    elif growing is not None:
        slow = growing.growth_per_s * span < 1.0
        seen = replace(seen, word=StatusWord.UNSTABLE, mode=growing, sentence=told(growing), slow=slow)
    elif grown > GROWTH_LIMIT:
        # where every mode decays, more records show whether that was chance
        seen = replace(seen, sentence=risen(grown), doubtful_hz=doubtful or _loudest_hz(slowest, heard.hidden_hz))
    elif tones:
        seen = replace(seen, sentence=rings_by_itself(tones))
    elif not doubtful:
        seen = replace(seen, word=StatusWord.OK)
    else:
        seen = replace(seen, mode=doubted, sentence="" if doubted is None else told(doubted))
    return seen


def grows(mode: Mode, record: FreeResponse) -> bool:
    """Return whether a mode grows, and not perhaps what a hum from outside rings up from the beginning of a run."""
    efolds = _efolds(mode, record)
    too_fast = efolds > RUNG_UP and not at_rest(mode, record)
    return mode.grows and (mode.seen * efolds > ADDED or too_fast or not record.hums_at(mode.f_hz))


def rises(record: FreeResponse) -> bool:
    """Return whether a response becomes louder towards its end."""
    before, last = loudness(record, 4)[2:]
    return bool(last > before)


def loudness(record: FreeResponse, parts: int) -> FloatArray:
    """Return the rms of a response over its noise in every equal part of the record, `(parts,)`."""
    powers = np.array([np.mean(part**2, axis=1) for part in np.array_split(record.response, parts, axis=1)])
    heard = powers.max(axis=0) > 0
    unit = np.maximum(np.mean(record.noise**2, axis=1), ROUNDING * powers.max(axis=0))
    return np.sqrt(np.sum(powers[:, heard] / unit[heard], axis=1) / max(len(unit), 1))


def may_drift(mode: Mode, record: FreeResponse) -> bool:
    """Return whether readings that wander may look like a mode's growth in one record."""
    return at_rest(mode, record) and (_efolds(mode, record) < UNDRIFTED or mode.seen < ABOVE_DRIFT)


def at_rest(mode: Mode, record: FreeResponse) -> bool:
    """Return whether a record so long does not tell a mode's frequency from 0 Hz."""
    return near(mode.f_hz, (0.0,), record.response.shape[1], record.runs[0].rate_hz)


def _efolds(mode: Mode, record: FreeResponse) -> float:
    return mode.growth_per_s * record.response.shape[1] / record.runs[0].rate_hz


def slowest_before(record: FreeResponse, rate_hz: float) -> Mode | None:
    """Return the slowest mode of a response that died within its record, from its shorter beginning."""
    return next(decaying_before(record, rate_hz), None)


def decaying_before(record: FreeResponse, rate_hz: float) -> Iterator[Mode]:
    """Yield the modes that decay within ever shorter beginnings of a record, the slowest of each first."""
    samples = record.response.shape[1] // 2
    while samples >= SHORTEST_SAMPLES:
        modes = ringing(record.response[:, :samples], record.noise[:, :samples], rate_hz).modes
        yield from (mode for mode in modes if mode.decays)  # what only rises at first is no mode
        samples //= 2


def told(mode: Mode) -> str:
    """Return a sentence on a mode."""
    verb = "grows" if mode.growth_per_s > 0 else "decays"
    return f"A mode at {mode.f_hz:.4g} Hz {verb} by {abs(mode.growth_per_s):.3g} +- {mode.growth_std:.1g} a second."


def rings_by_itself(f_hz: Sequence[float]) -> str:
    """Return a sentence on what rings without a burst."""
    hz = ", ".join(f"{f:.4g}" for f in f_hz[:3])
    return f"It rings near {hz} Hz by itself, no burst allowed is heard above that."


def risen(times: float) -> str:
    """Return a sentence on noise that grew."""
    return f"What noise does to it grew {times:.3g} times within the record."


def _loudest_hz(slowest: Mode | None, hidden_hz: tuple[float, ...]) -> tuple[float, ...]:
    return hidden_hz[:1] if slowest is None else (slowest.f_hz,)


def apart(f_hz: Iterable[float], width_hz: float) -> tuple[float, ...]:
    """Return the first frequencies that lie apart: one tone as wide as its burst is short serves all nearer ones."""
    found: list[float] = []
    for f in f_hz:
        if len(found) < MOST_TONES and all(abs(f - other) > width_hz / 2 for other in found):
            found.append(float(f))
    return tuple(found)
