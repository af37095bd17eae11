"""Whether a loop on a bench is stable, judged by how its own modes grow or decay."""

from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError, UltraquietError, blames_no_law
from ultraquiet.bench import Bench
from ultraquiet.simulate.free_response import VISIBLE, Mode, lasting_hz, ringing
from ultraquiet.simulate.growth.lowered import within_limits
from ultraquiet.simulate.growth.outside import hums_at_rest, hums_of
from ultraquiet.simulate.growth.ramps import ramping
from ultraquiet.simulate.growth.repeated import repeated
from ultraquiet.simulate.growth.sticking import sticking
from ultraquiet.simulate.growth.verdict import (
    CLIPPED_SHARE,
    LIMITED_SHARE,
    LONGER,
    SHORTEST_SAMPLES,
    Seen,
    apart,
    grows,
    judged,
    may_drift,
    rings_by_itself,
    rises,
    told,
)
from ultraquiet.simulate.kick import Burst, FreeResponse, kicked, loudest, near, swings, tones_alone, with_tones
from ultraquiet.simulate.loop import disturb
from ultraquiet.simulate.sweeps.rest import OFFSET
from ultraquiet.values import StateSpace, Status, StatusWord
from ultraquiet.values.controller import Controller
from ultraquiet.values.interconnect import feedback

# The first record, and by how much each next one is longer; the longest, whichever is more.
FIRST_SAMPLES, LONGEST_S, LONGEST_SAMPLES = 4096, 60.0, 1 << 15
# Every record begins with a burst of one part in so many, and of so many samples at least.
BURSTS, SHORTEST_BURST = 16, 4096
# A loop that was seen to decay is watched once more from near its noise, where friction and hysteresis act otherwise.
ABOVE_NOISE, QUIETEST = 100.0, 1e-3
# Noise that a stable loop heaps up grows as the root of the samples: so many times that within few is growth.
HEAPED = 10.0
# What swings so often while it grows is no drift, and not what an offset heaps up behind slow lags.
TURNS = 3.0
# The law's own poles that decay by less than this within a record are given a tone each in the next burst.
SLOW = 10.0


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

    * unstable when one a_i exceeds zero by four standard deviations, or commands stay at their limits; also where that
      is so after loud bursts that end within half of the ranges, tones at the slowest modes among them, and not, in
      proportion, after weaker ones, as where something sticks (`sticking.py`);
    * ok when everything was followed down to the noise, decaying: from a third of the channels' ranges, and where that
      takes longer than the record, again from near the noise;
    * not known when a mode neither grows nor decays beyond doubt in the longest record, as a limit cycle does, noise
      keeps one going that no burst within the limits is heard above, what a loud burst set going rings on, or a command
      still ramps under a law that integrates (`ramps.py`).

    Offsets count for nothing. A tone that the bench holds without the law as well, mains or a drift, is none of the
    loop's where a burst at its frequency stands well above it and dies (`growth/outside.py`).

    A record that does not tell is made four times longer, with a burst at the modes in doubt; the longest is repeated,
    or more shorter ones where noise drives commands to their limits within it, as long as so many could tell, up to
    sixty times on a bench in real time and 400 on a simulated one (`repeated.py`, `together.py`).

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
        InputError: a duration too short to see anything; a law or model that does not fit; an actuator that may not go
            to either side of zero.
        BenchError: the bench failed, came too late or was stopped by hand, which is no fault of the law.
    """
    longest = _longest(bench.rate_hz, duration_s)
    swings("check_stability", bench.actuators)
    disturb(bench, np.zeros((len(bench.actuators), 2)), controller)  # a law that does not fit is refused, not judged
    beside = (None, None) if model is None else _with_model(model, controller)
    try:
        first = min(FIRST_SAMPLES, longest)
        bursts = loudest(bench, controller, _burst_length(first), first, seed)
        seen = _watched(bench, controller, longest, bursts.coloured)
        if seen.word is StatusWord.OK:
            seen = sticking(bench, controller, bursts, seen) or ramping(bench, _linear(controller), seen) or seen
    except UltraquietError as error:
        if blames_no_law(error):
            raise  # a cable, a machine that came too late, an emergency stop: they say nothing of the law
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


def _watched(bench: Bench, law: StateSpace | Controller, longest: int, burst: Burst) -> Seen:
    """Watch ever longer until the record tells, or there is no longer one; there, several times."""
    samples = first = burst.samples
    tones = _slow_poles_hz(law, first, bench.rate_hz)
    before: Seen | None = None
    while True:
        short = replace(burst, length=_burst_length(samples))  # its free response matters little for the level
        burst = replace(with_tones(bench, law, short, tones), samples=samples)
        found = kicked(bench, law, burst)
        if found.limited > LIMITED_SHARE and before is not None and before.word is StatusWord.UNSTABLE:
            return before  # it was seen to grow, and now it grew as far as the limits
        burst, found = within_limits(bench, law, burst, found)
        if found.limited > LIMITED_SHARE:
            held = hums_at_rest(bench, found.response.shape[1])
            burst = replace(burst, hums_hz=(*burst.hums_hz, *held))
            found = replace(found, hums_hz=burst.hums_hz)
            seen = _at_limits(bench, law, burst, found, before)
            if seen.word is not None or (before is None and found.before_limits < SHORTEST_SAMPLES):
                return seen
            return _before_limits(bench, law, burst, seen, before or _so_far(bench, found))
        burst, seen = _told_from_outside(bench, law, burst, found, first)
        enough = seen.word is StatusWord.OK and samples > first
        # growth that something louder drowns may be an overtone of what decays by another rate at every size
        enough |= seen.word is StatusWord.UNSTABLE and not seen.slow and (samples >= longest or rises(found))
        if enough:
            return seen
        if samples >= longest:
            # a shorter record that noise did not drive to the limits tells more, repeated, than one that it did
            clipped = before is not None and seen.record.limited > CLIPPED_SHARE
            doubted = before if clipped and before is not None else seen
            return repeated(bench, law, replace(burst, samples=first), doubted)
        tones = apart((*seen.doubtful_hz, *tones), bench.rate_hz / burst.length)
        before, samples, burst = seen, min(longest, LONGER * samples), replace(burst, samples=first)


def _told_from_outside(
    bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse, first: int
) -> tuple[Burst, Seen]:
    """Return what is heard, once more where tones in doubt come from outside, and the burst that knows them."""
    while True:
        seen = _heard(bench, law, burst, found)
        if seen.word is StatusWord.OK:
            seen = _assured(bench, law, replace(burst, samples=first), seen)
        growing = () if seen.word is not StatusWord.UNSTABLE or seen.mode is None else (seen.mode.f_hz,)
        doubted = (*seen.doubtful_hz, *growing)
        if seen.word is StatusWord.OK or not doubted or seen.record.limited > CLIPPED_SHARE:
            return burst, seen
        new = dict.fromkeys(f for f in doubted if not seen.record.from_outside(f))
        hums, outside = hums_of(bench, law, replace(burst, samples=first), seen.record, new)
        if not outside and all(seen.record.hums_at(f) for f in hums):
            return burst, seen
        known = (*burst.hums_hz, *(f for f in hums if not seen.record.hums_at(f)))
        burst = replace(burst, hums_hz=known, outside_hz=(*burst.outside_hz, *outside))
        found = kicked(bench, law, burst)


def _at_limits(
    bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse, before: Seen | None
) -> Seen:
    """Judge a loop that stands at its limits however weak the burst, as noise alone may drive a stable one.

    It is unstable where it was seen to grow before it first touched its limits, where noise grew to them faster than
    what a stable loop heaps up, and where noise alone does not drive it there but a burst that is heard above it.
    """
    free = found.until(found.before_limits)
    samples = free.response.shape[1]
    growing = next((mode for mode in _modes(bench, free) if grows(mode, free)), None)
    seen = judged(bench, found)
    if growing is not None:
        return replace(seen, word=StatusWord.UNSTABLE, mode=growing, sentence=told(growing))
    alone = kicked(bench, law, replace(burst, levels=0.0 * burst.levels))
    growing = None if found.hums_hz else _growth_from_an_offset(bench, alone)
    if growing is not None:
        return replace(seen, word=StatusWord.UNSTABLE, mode=growing, sentence=told(growing))
    share = _share(free) if samples else np.inf
    # a hum heaps up in proportion to time, so that its rise says nothing of the loop
    grown = alone.rise > HEAPED and not found.hums_hz
    by_itself = grown or (alone.limited <= CLIPPED_SHARE and share > VISIBLE)
    mode = seen.mode if before is None else before.mode
    if by_itself:
        return replace(seen, mode=mode)
    hum = f"A hum at {found.hums_hz[0]:.4g} Hz" if found.hums_hz else ""
    alone_says = f"{hum or _what_drives(bench)} alone drives a {found.what_is_limited} to its limit"
    sentence = f"{alone_says}, where it stays for {found.limited:.0%} of the last quarter."
    return replace(seen, word=None, mode=mode, sentence=sentence)


def _growth_from_an_offset(bench: Bench, alone: FreeResponse) -> Mode | None:
    """Return the mode that offsets set growing without a burst, long before a command stands at its limit.

    Not asked where the bench hums: two hums that are near each other beat, and that looks like growth for a while.
    """
    step = alone.of_offset
    span = step.response.shape[1] / bench.rate_hz

    def is_no_drift(mode: Mode) -> bool:
        return mode.f_hz * span > TURNS or not may_drift(mode, step)

    return next((mode for mode in _modes(bench, step) if grows(mode, step) and is_no_drift(mode)), None)


def _modes(bench: Bench, free: FreeResponse) -> tuple[Mode, ...]:
    """Return the modes of a free response, none where it is too short."""
    enough = free.response.shape[1] >= SHORTEST_SAMPLES
    return ringing(free.response, free.noise, bench.rate_hz).modes if enough else ()


def _what_drives(bench: Bench) -> str:
    """Return what drives a loop without a burst: the offset of the sensor that has the largest beside its noise."""
    y = disturb(bench, np.zeros((len(bench.actuators), SHORTEST_SAMPLES))).outputs
    offset, noise = y.mean(axis=1), y.std(axis=1)
    rounding = np.finfo(float).eps * np.abs(y).max(axis=1) + np.finfo(float).tiny
    k = int(np.argmax(np.abs(offset) / np.maximum(noise, rounding)))
    if not abs(offset[k]) > OFFSET * noise[k]:
        return "Noise"
    sensor = bench.sensors[k]
    return f"The offset of '{sensor.name}', {offset[k]:.3g} {sensor.unit}".rstrip() + ","


def _so_far(bench: Bench, found: FreeResponse) -> Seen:
    """Return what a record showed before a command first touched its limit: at least where to look."""
    seen = judged(bench, found.until(found.before_limits))
    shown = () if seen.mode is None else (seen.mode.f_hz,)
    return replace(seen, word=None, doubtful_hz=seen.doubtful_hz or shown or seen.hidden_hz[:1])


def _before_limits(bench: Bench, law: StateSpace | Controller, burst: Burst, seen: Seen, before: Seen) -> Seen:
    """Return what shorter records say of a loop that noise drives to its limits within the longest.

    They may show growth. That its modes decay as long as it does not touch its limits is told, but does not make ok
    what ends there without a burst.
    """
    again = repeated(bench, law, burst, before)
    if again.word is StatusWord.UNSTABLE:
        return again
    known = "" if again.mode is None else f" Before, {again.sentence[0].lower()}{again.sentence[1:]}"
    return replace(seen, mode=again.mode, sentence=f"{seen.sentence}{known}")


def _assured(bench: Bench, law: StateSpace | Controller, burst: Burst, seen: Seen) -> Seen:
    """Return what is seen after tones where noise may hide a mode: silence alone settles nothing.

    Nor does a tone that is not heard above what noise keeps going there, unless that comes from outside; at 0 Hz
    readings may wander.
    """
    if not seen.hidden_hz:
        return seen
    tones = tones_alone(bench, law, burst, apart(seen.hidden_hz, bench.rate_hz / burst.length))
    other = replace(tones, samples=seen.record.response.shape[1])
    again = judged(bench, within_limits(bench, law, other, kicked(bench, law, other))[1])
    if again.record.limited > LIMITED_SHARE:
        return seen
    if again.word is not StatusWord.OK:
        return again
    record = again.record
    known = (0.0, *record.outside_hz, *(mode.f_hz for mode in again.modes))
    swinging = [f for f in seen.hidden_hz if not near(f, known, record.response.shape[1], bench.rate_hz)]
    left = lasting_hz(record.response, record.noise, swinging, bench.rate_hz)
    return replace(seen, word=None, doubtful_hz=left, sentence=rings_by_itself(left)) if left else seen


def _heard(bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse) -> Seen:
    """Judge what was found after a loud burst, and what still rings after it once more from near the noise."""
    seen = judged(bench, found)
    if seen.word is StatusWord.OK and seen.modes:
        share = max(QUIETEST, min(1.0, ABOVE_NOISE / max(mode.seen for mode in seen.modes)))
        quiet = replace(burst, levels=share * burst.levels, modes_hz=tuple(mode.f_hz for mode in seen.modes))
        softly = judged(bench, within_limits(bench, law, quiet, kicked(bench, law, quiet))[1])
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
    return apart(np.abs(np.angle(slow)) * rate_hz / (2 * np.pi), rate_hz / _burst_length(LONGER * int(samples)))


def _linear(law: StateSpace | Controller) -> StateSpace | None:
    linear = law if isinstance(law, StateSpace) else getattr(law, "law", None)
    return linear if isinstance(linear, StateSpace) else None


def _with_model(model: StateSpace, law: StateSpace | Controller) -> tuple[float | None, float | None]:
    linear = _linear(law)
    if linear is None:
        return None, None
    poles = np.append(feedback(model, linear).poles(), 0.0)  # without states a loop forgets as a pole at zero does
    slowest = poles[np.argmax(np.abs(poles))]
    rate = model.rate_hz or float("nan")
    turned = abs(float(np.angle(slowest))) * rate / (2 * np.pi)
    return float(np.log(max(np.abs(slowest), np.finfo(float).tiny)) * rate), turned


def _check(bench: Bench, seen: Seen, beside: tuple[float | None, float | None]) -> LoopCheck:
    last = seen.record.runs[1]
    rms = [_rms(x[:, -last.samples // 4 :]) for x in (last.outputs, last.inputs)]
    span = seen.record.response.shape[1] / bench.rate_hz
    longest = max(span, seen.longest / bench.rate_hz)
    word = seen.word or StatusWord.NOT_KNOWN
    times = f"{seen.records} times {span:.3g} s" if seen.records > 1 else f"{span:.3g} s"
    opening = {
        StatusWord.OK: f"The loop settles; watched for {times}.",
        StatusWord.UNSTABLE: "The loop is not stable on this bench.",
    }.get(word, f"{times} do not tell whether this loop decays.")
    with_model = "" if beside[0] is None else f"With the model: {beside[0]:.3g} a second at {beside[1]:.4g} Hz."
    hums = ", ".join(f"{f:.4g}" for f in seen.record.outside_hz)
    outside = f"Left out as it comes from outside, heard without the law too: {hums} Hz." if hums else ""
    status = Status(word, " ".join(filter(None, (opening, seen.sentence, outside, with_model))))
    mode = seen.mode or Mode(np.nan, np.nan, np.nan, 0.0)
    return LoopCheck(status, rms[0], rms[1], mode.growth_per_s, mode.growth_std, mode.f_hz, longest, *beside)


def _rms(signal: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(signal**2, axis=1))


@np.errstate(over="ignore")  # of a bench without noise
def _share(free: FreeResponse) -> float:
    """Return how much larger what a burst leaves is than noise, in rms."""
    return float(np.sqrt(np.mean(free.response**2) / max(np.mean(free.noise**2), np.finfo(float).tiny)))
