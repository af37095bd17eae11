"""Whether a loop on a bench is stable, judged by how its own modes grow or decay."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError, InterlockError, UltraquietError
from ultraquiet.bench import Bench
from ultraquiet.simulate.free_response import Mode, ringing
from ultraquiet.simulate.kick import Burst, FreeResponse, kicked, loudest, tones_alone, with_tones
from ultraquiet.simulate.loop import disturb
from ultraquiet.values import StateSpace, Status, StatusWord
from ultraquiet.values.controller import Controller
from ultraquiet.values.interconnect import feedback

# The first record, and by how much each next one is longer; the longest, whichever is more.
FIRST_SAMPLES, LONGER, LONGEST_S, LONGEST_SAMPLES, SHORTEST_SAMPLES = 4096, 4, 60.0, 1 << 15, 128
# Every record begins with a burst of one part in so many, and of so many samples at least.
BURSTS, SHORTEST_BURST = 16, 4096
# A loop that was seen to decay is watched once more from near its noise, where friction and hysteresis act otherwise.
ABOVE_NOISE, QUIETEST = 100.0, 1e-3
# Shares of a free response that a command stands at its limit: a loop that ran away does so for more than the first;
# one that does for more than the second is no longer the linear loop whose modes could be judged.
LIMITED_SHARE, CLIPPED_SHARE = 0.1, 0.01
# Noise that a stable loop heaps up grows as the root of the samples: so many times that within few is growth.
HEAPED = 10.0
# A burst after which commands stay at their limits is lowered to this share, so many times, before the loop is blamed:
# little by little, for a burst far below what the limits allow leaves a slow mode among the noise.
LOWERED_TO, LOWERED = 0.3, 6
# Records of the greatest length that are judged together before nothing is known; all but the first have bursts at the
# modes in doubt alone, so many times as loud as a first one may be: these modes hardly grow within the record.
REPEATS, LOUDER = 10, 2.0
# The law's own poles that decay by less than this within a record are given a tone each in the next burst.
SLOW, MOST_TONES = 10.0, 12
# Noise alone does not grow so much between the second and the last quarter of a run of a loop that is stable.
GROWTH_LIMIT = 3.0


@dataclass(frozen=True)
class LoopCheck:
    """What a closed loop does by itself, and the verdict: `ok`, `unstable` or `not known`.

    Attributes:
        status: the verdict.
        sensor_rms_v, command_rms_v: RMS over the last quarter of the last run, `(ny,)` and `(nu,)`, in the channels'
            units.
        growth_per_s: growth of the slowest mode that was seen, e-folds a second; negative where it decays, NaN where
            the loop ran away before a mode could be told.
        growth_std_per_s: its standard deviation.
        growth_hz: its frequency in Hz.
        duration_s: length of the longest record.
        model_growth_per_s, model_growth_hz: the same of the loop with `model`; None without one.
    """

    status: Status
    sensor_rms_v: FloatArray
    command_rms_v: FloatArray
    growth_per_s: float
    growth_std_per_s: float
    growth_hz: float
    duration_s: float
    model_growth_per_s: float | None = None
    model_growth_hz: float | None = None


@dataclass(frozen=True)
class _Seen:
    """What one record said: a word, or None where it takes a longer one; the slowest mode, and a sentence."""

    word: StatusWord | None
    mode: Mode | None
    sentence: str
    record: FreeResponse
    modes: tuple[Mode, ...]
    doubtful_hz: tuple[float, ...]
    unheard: bool = False
    hidden_hz: tuple[float, ...] = ()
    slow: bool = False


def check_stability(
    bench: Bench,
    controller: StateSpace | Controller,
    duration_s: float | None = None,
    *,
    model: StateSpace | None = None,
    seed: int = 0,
) -> LoopCheck:
    """Set a closed loop ringing and judge it by the growth of every mode that is seen, and how well that is known.

    Two runs with opposite bursts give the free response and, apart from it, the noise. Modes still visible in the
    second half of the record are fitted, y_t = sum c_i exp((a_i + 2 pi i f_i) t). The loop is

    * unstable when one a_i exceeds zero by four standard deviations, or commands stay at their limits;
    * ok when everything was followed down to the noise, decaying: from a third of the channels' ranges, and where that
      takes longer than the record, again from near the noise;
    * not known when a mode neither grows nor decays beyond doubt in the longest record, as a limit cycle does.

    A record that does not tell is made four times longer, with a burst at the modes in doubt.

    Args:
        bench: any bench.
        controller: acts as u = K y.
        duration_s: longest record in seconds; when absent 60 s or 32768 samples, whichever is more. Most loops take a
            few seconds.
        model: of this bench, identified on it: the loop's slowest pole with it is told beside.
        seed: of the burst's signs.

    Returns:
        `LoopCheck`: verdict, growth and frequency of the slowest mode.

    Raises:
        InputError: a duration too short to see anything; a law or model that does not fit.
        InterlockError: a bench in real time came too late, which is no fault of the law.
    """
    longest = _longest(bench.rate_hz, duration_s)
    disturb(bench, np.zeros((len(bench.actuators), 2)), controller)  # a law that does not fit is refused, not judged
    beside = (None, None) if model is None else _with_model(model, controller)
    try:
        seen = _watched(bench, controller, longest, seed)
    except UltraquietError as error:
        if isinstance(error, InterlockError) and error.of_time:
            raise  # a machine that came too late says nothing of the law
        silent = [np.full(len(c), np.nan) for c in (bench.sensors, bench.actuators)]
        status = Status(StatusWord.UNSTABLE, f"The loop runs away on this bench: {error}")
        return LoopCheck(status, silent[0], silent[1], np.nan, np.nan, np.nan, 0.0, *beside)
    return _check(bench, seen, beside)


def _longest(rate_hz: float, duration_s: float | None) -> int:
    if duration_s is None:
        return max(int(LONGEST_S * rate_hz), LONGEST_SAMPLES)
    samples = int(positive("check_stability", "duration_s", duration_s, "s") * rate_hz)
    if samples < SHORTEST_SAMPLES:
        raise InputError(
            f"check_stability: 'duration_s' = {duration_s:g} s holds {samples} samples; it takes {SHORTEST_SAMPLES} "
            f"or more, {SHORTEST_SAMPLES / rate_hz:g} s here."
        )
    return samples


def _watched(bench: Bench, law: StateSpace | Controller, longest: int, seed: int) -> _Seen:
    """Watch ever longer until the record tells, or there is no longer one; there, several times."""
    samples = first = min(FIRST_SAMPLES, longest)
    burst = loudest(bench, law, _burst_length(first), first, seed)
    tones = _slow_poles_hz(law, first, bench.rate_hz)
    before: _Seen | None = None
    while True:
        short = replace(burst, length=_burst_length(samples))  # its free response matters little for the level
        burst = replace(with_tones(bench, law, short, tones), samples=samples)
        found = kicked(bench, law, burst)
        if found.limited > LIMITED_SHARE and before is not None and before.word is StatusWord.UNSTABLE:
            return before  # it was seen to grow, and now it grew as far as the limits
        burst, found = _within_limits(bench, law, burst, found)
        if found.limited > LIMITED_SHARE:
            return _at_limits(bench, law, burst, found, before)
        seen = _heard(bench, law, burst, found)
        if seen.word is StatusWord.OK:
            seen = _assured(bench, law, replace(burst, samples=first), seen)
        enough = seen.word is StatusWord.OK and samples > first
        enough |= seen.word is StatusWord.UNSTABLE and not seen.slow
        if enough:
            return seen
        if samples >= longest:
            # a shorter record that noise did not drive to the limits tells more, repeated, than one that it did
            clipped = before is not None and seen.record.limited > CLIPPED_SHARE
            told = before if clipped and before is not None else seen
            return _repeated(bench, law, replace(burst, samples=first), told)
        tones = _apart((*seen.doubtful_hz, *tones), bench.rate_hz / burst.length)
        before, samples, burst = seen, min(longest, LONGER * samples), replace(burst, samples=first)


def _within_limits(
    bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse
) -> tuple[Burst, FreeResponse]:
    """Lower a burst until what it leaves is no longer clipped: a loop that is stable may stay at limits after one."""
    for _ in range(LOWERED):
        if found.limited <= CLIPPED_SHARE:
            break
        burst = replace(burst, levels=LOWERED_TO * burst.levels)
        found = kicked(bench, law, burst)
    return burst, found


def _at_limits(
    bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse, before: _Seen | None
) -> _Seen:
    """Judge a loop whose commands stand at their limits however weak the burst, as noise alone may drive a stable one.

    It is unstable where noise alone does not drive it there, where it was seen to grow before it first touched its
    limits, and where noise grew to them faster than what a stable loop heaps up.
    """
    free = found.before_limits
    seen = _judged(bench, found.until(free)) if free >= SHORTEST_SAMPLES else None
    if seen is None or seen.word is not StatusWord.UNSTABLE:
        alone = kicked(bench, law, replace(burst, levels=0.0 * burst.levels))
        by_itself = alone.limited <= CLIPPED_SHARE or alone.rise > HEAPED
        seen = replace(_judged(bench, found), word=StatusWord.UNSTABLE if by_itself else None)
    return replace(seen, record=found, mode=seen.mode if before is None else before.mode)


def _assured(bench: Bench, law: StateSpace | Controller, burst: Burst, seen: _Seen) -> _Seen:
    """Return what is seen after tones where noise may hide a mode: silence alone settles nothing."""
    if not seen.hidden_hz:
        return seen
    tones = tones_alone(bench, law, burst, _apart(seen.hidden_hz, bench.rate_hz / burst.length))
    other = replace(tones, samples=seen.record.response.shape[1])
    again = _judged(bench, _within_limits(bench, law, other, kicked(bench, law, other))[1])
    return seen if again.word is StatusWord.OK or again.record.limited > LIMITED_SHARE else again


def _repeated(bench: Bench, law: StateSpace | Controller, burst: Burst, seen: _Seen) -> _Seen:
    """Return what several records say together, where one alone leaves a doubt that more may end.

    Each has a burst of its own, all of it at the modes in doubt, as loud as the limits allow that one: tones of other
    phases reach a mode otherwise. A record that commands spent at their limits says nothing of modes.
    """
    samples = seen.record.response.shape[1]
    for more in range(1, REPEATS):
        # the first says more than its share of all: the burst before it was not at the modes in doubt alone
        worth = more == 1 or seen.unheard or any(mode.may_be_told for mode in seen.modes if not mode.decays)
        if seen.word is not None or not seen.doubtful_hz or not worth:
            break
        tones = _apart(seen.doubtful_hz, bench.rate_hz / burst.length)
        other = tones_alone(bench, law, replace(burst, seed=burst.seed + more), tones)
        other = replace(other, levels=LOUDER * other.levels, samples=samples)
        other, found = _within_limits(bench, law, other, kicked(bench, law, other))
        if found.limited > CLIPPED_SHARE:
            break
        seen = _judged(bench, seen.record.beside(found))
    return seen


def _heard(bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse) -> _Seen:
    """Judge what was found after a loud burst, and what still rings after it once more from near the noise."""
    seen = _judged(bench, found)
    if seen.word is StatusWord.OK and seen.modes:
        share = max(QUIETEST, min(1.0, ABOVE_NOISE / max(mode.seen for mode in seen.modes)))
        quiet = replace(burst, levels=share * burst.levels, modes_hz=tuple(mode.f_hz for mode in seen.modes))
        softly = _judged(bench, _within_limits(bench, law, quiet, kicked(bench, law, quiet))[1])
        return softly if softly.word is not StatusWord.OK else seen
    return seen


def _burst_length(samples: int) -> int:
    return max(samples // BURSTS, min(samples // 2, SHORTEST_BURST))


def _slow_poles_hz(law: StateSpace | Controller, samples: float, rate_hz: float) -> tuple[float, ...]:
    """Return the frequencies of the law's own poles that hardly decay in so many samples, slowest first.

    A law that undoes a mode which this bench has elsewhere keeps a pole that is hardly heard from outside: only a burst
    at its own frequency shows what becomes of it.
    """
    linear = _linear(law)
    if linear is None or not linear.states:
        return ()
    poles = linear.poles()
    poles = poles[np.argsort(-np.abs(poles), kind="stable")]
    slow = poles[np.log(np.maximum(np.abs(poles), np.finfo(float).tiny)) * samples > -SLOW]
    return _apart(np.abs(np.angle(slow)) * rate_hz / (2 * np.pi), rate_hz / _burst_length(LONGER * int(samples)))


def _apart(f_hz: Iterable[float], width_hz: float) -> tuple[float, ...]:
    """Return the first frequencies that lie apart: one tone as wide as its burst is short serves all nearer ones."""
    found: list[float] = []
    for f in f_hz:
        if len(found) < MOST_TONES and all(abs(f - other) > width_hz / 2 for other in found):
            found.append(float(f))
    return tuple(found)


def _linear(law: StateSpace | Controller) -> StateSpace | None:
    linear = law if isinstance(law, StateSpace) else getattr(law, "law", None)
    return linear if isinstance(linear, StateSpace) else None


def _judged(bench: Bench, record: FreeResponse) -> _Seen:
    rate, span = bench.rate_hz, record.response.shape[1] / bench.rate_hz
    heard = ringing(record.response, record.noise, rate)
    modes = heard.modes
    slowest = modes[0] if modes else _slowest_before(record, rate)
    doubtful = (*(mode.f_hz for mode in modes if not mode.decays), *heard.tones_hz)
    said = "" if slowest is None else _told(slowest)
    seen = _Seen(None, slowest, said, record, modes, doubtful, unheard=bool(heard.tones_hz), hidden_hz=heard.hidden_hz)
    growing = next((mode for mode in modes if mode.grows), None)
    grown = _grown(record.noise, len(bench.sensors) + len(bench.actuators))
    doubted = max((m for m in modes if not m.decays), key=lambda m: m.growth_per_s + m.growth_std, default=slowest)
    if record.limited > LIMITED_SHARE:
        sentence = f"A command stood at its limit for {record.limited:.0%} of the last quarter of {span:.3g} s."
        seen = replace(seen, word=StatusWord.UNSTABLE, sentence=sentence)
    elif record.limited > CLIPPED_SHARE:
        sentence = f"Noise alone drove a command to its limit for {record.limited:.1%} of the last quarter."
        seen = replace(seen, sentence=sentence)
    elif growing is not None:
        slow = growing.growth_per_s * span < 1.0
        seen = replace(seen, word=StatusWord.UNSTABLE, mode=growing, sentence=_told(growing), slow=slow)
    elif grown > GROWTH_LIMIT:
        seen = replace(seen, sentence=f"What noise does to it grew {grown:.3g} times within {span:.3g} s.")
    elif heard.tones_hz:
        hz = ", ".join(f"{f:.4g}" for f in heard.tones_hz[:3])
        seen = replace(seen, sentence=f"It rings near {hz} Hz by itself, no burst allowed is heard above that.")
    elif not doubtful:
        seen = replace(seen, word=StatusWord.OK)
    else:
        seen = replace(seen, mode=doubted, sentence="" if doubted is None else _told(doubted))
    return seen


def _slowest_before(record: FreeResponse, rate_hz: float) -> Mode | None:
    """Return the slowest mode of a response that died within its record, from its shorter beginning."""
    samples = record.response.shape[1] // 2
    while samples >= SHORTEST_SAMPLES:
        modes = ringing(record.response[:, :samples], record.noise[:, :samples], rate_hz).modes
        known = next((mode for mode in modes if mode.decays), None)  # what only rises at first is no mode
        if known is not None:
            return known
        samples //= 2
    return None


def _told(mode: Mode) -> str:
    verb = "grows" if mode.growth_per_s > 0 else "decays"
    return f"A mode at {mode.f_hz:.4g} Hz {verb} by {abs(mode.growth_per_s):.3g} +- {mode.growth_std:.1g} a second."


def _grown(noise: FloatArray, channels: int) -> float:
    """Return by how much the noise of a channel grew, the records that stand beside one another taken together."""
    power = noise.reshape(-1, channels, noise.shape[1]) ** 2
    quarter = noise.shape[1] // 4
    early, late = (
        np.sqrt(np.mean(part, axis=(0, 2))) for part in (power[..., quarter : 2 * quarter], power[..., -quarter:])
    )
    heard = late > 0
    return float(np.max(late[heard] / np.maximum(early[heard], np.finfo(float).tiny), initial=0.0))


def _with_model(model: StateSpace, law: StateSpace | Controller) -> tuple[float | None, float | None]:
    linear = _linear(law)
    if linear is None:
        return None, None
    poles = feedback(model, linear).poles()
    slowest = poles[np.argmax(np.abs(poles))]
    rate = model.rate_hz or float("nan")
    turned = abs(float(np.angle(slowest))) * rate / (2 * np.pi)
    return float(np.log(max(np.abs(slowest), np.finfo(float).tiny)) * rate), turned


def _check(bench: Bench, seen: _Seen, beside: tuple[float | None, float | None]) -> LoopCheck:
    last = seen.record.runs[1]
    rms = [_rms(x[:, -last.samples // 4 :]) for x in (last.outputs, last.inputs)]
    span = seen.record.response.shape[1] / bench.rate_hz
    word = seen.word or StatusWord.NOT_KNOWN
    opening = {
        StatusWord.OK: f"The loop settles; watched for {span:.3g} s.",
        StatusWord.UNSTABLE: "The loop is not stable on this bench.",
    }.get(word, f"{span:.3g} s do not tell whether this loop decays.")
    told = "" if beside[0] is None else f" With the model: {beside[0]:.3g} a second at {beside[1]:.4g} Hz."
    status = Status(word, f"{opening} {seen.sentence}{told}".rstrip())
    mode = seen.mode or Mode(np.nan, np.nan, np.nan, 0.0)
    return LoopCheck(status, rms[0], rms[1], mode.growth_per_s, mode.growth_std, mode.f_hz, span, *beside)


def _rms(signal: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(signal**2, axis=1))
