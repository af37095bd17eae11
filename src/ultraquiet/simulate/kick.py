"""What sets a loop ringing: a short burst on all actuators, its level and colour from the bench's limits and noise."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Bench
from ultraquiet.simulate.frames import Frames
from ultraquiet.simulate.loop import disturb
from ultraquiet.values import Channel, Record, StateSpace
from ultraquiet.values.channel import stands_at_limits
from ultraquiet.values.controller import Controller

USED_RANGE, AT_MOST = 0.3, 0.5  # shares of every channel's range that a burst uses, and may use
# A burst begins with this share of the actuators' ranges; its colour evens out what the loop makes of it, so far.
BEGIN, LEAST_COLOUR = 1e-3, 1e-3
# Where the limits leave it open, a burst is loud enough when readings reach so many times their noise.
LOUD = 1e4
RAISES, RAISED_BY, NEAR = 8, 30.0, 1.5
COLOURS_PER_OCTAVE = 3
# A range of which less lies to one side of zero is counted from where a reading rests; what is left of it at least.
ASIDE, LEAST_ROOM = 0.25, 1e-3
KAISER = 14.0  # of the mean of what rings yet: little of a tone that decays is left in it
AT_FIRST = 8  # samples in which noise has driven commands and the loop has not grown yet
FROM_NOISE = 0.2  # of a command at its limit, that noise has there where it is what drives it
HALF = 0.45  # of what commands reach, that half the time before is less where they grow


@dataclass(frozen=True, eq=False)
class Burst:
    """Random signs on all actuators, coloured, and tones at `modes_hz`.

    Args:
        levels: peak on each actuator, `(nu,)`.
        length: of the burst in samples.
        samples: of the free response that follows.
        rate_hz: samples per second.
        modes_hz: where it is to be louder.
        random_share, tone_share: the peaks of both parts when there are tones, in `levels`.
        colour: amplitudes at `colour_hz`; white when empty.
        seed: of the signs.
        hums_hz: tones that the bench holds without a law too.
        outside_hz: those of them that are known to be no modes of the loop.
        ends: sample of the burst from which on it is silent; None where it lasts for its length.
    """

    levels: FloatArray
    length: int
    samples: int
    rate_hz: float
    modes_hz: tuple[float, ...] = ()
    random_share: float = 0.5
    tone_share: float = 0.5
    colour_hz: tuple[float, ...] = ()
    colour: tuple[float, ...] = ()
    seed: int = 0
    hums_hz: tuple[float, ...] = ()
    outside_hz: tuple[float, ...] = ()
    ends: int | None = None

    @property
    def lasts(self) -> int:
        """Samples for which it is not silent."""
        return self.length if self.ends is None else self.ends

    def signal(self) -> FloatArray:
        """Return the disturbance `(nu, length + samples)`."""
        d = np.zeros((len(self.levels), self.length + self.samples))
        rng = np.random.default_rng(self.seed)
        shape = rng.choice([-1.0, 1.0], (len(self.levels), self.length))
        if self.colour:
            f = np.fft.rfftfreq(self.length, 1 / self.rate_hz)
            gain = np.interp(np.log(np.maximum(f, f[1])), np.log(self.colour_hz), self.colour)
            shape = _peak_one(np.fft.irfft(np.fft.rfft(shape, axis=1) * gain, self.length, axis=1))
        if self.modes_hz:
            angle = 2 * np.pi * np.array(self.modes_hz)[:, None] * np.arange(self.length) / self.rate_hz
            phases = rng.uniform(0, 2 * np.pi, (len(self.levels), len(self.modes_hz), 1))
            tones = _peak_one(np.sin(angle + phases).sum(axis=1))
            shape = self.random_share * shape + self.tone_share * tones
        d[:, : self.lasts] = self.levels[:, None] * shape[:, : self.lasts]
        return d


def _peak_one(signal: FloatArray) -> FloatArray:
    return signal / np.maximum(np.abs(signal).max(axis=1, keepdims=True), np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class FreeResponse:
    """Two runs with opposite bursts: half their difference is the response, half their sum the noise.

    Readings and commands `(ny + nu, samples)` after the burst. What does not turn with the burst is counted as noise;
    both have half the power of the noise of one run. Where the loop comes to rest, the mean of the later half, is left
    out of it: an offset of the sensors is the same in both runs, and nothing hides behind it. A hum may begin anew with
    every run and stand in the response as well: where there are `hums_hz`, the noise is that of a whole run without a
    burst, which no such hum exceeds.
    """

    response: FloatArray
    noise: FloatArray
    runs: tuple[Record, Record]
    hums_hz: tuple[float, ...] = ()
    outside_hz: tuple[float, ...] = ()

    @property
    def limited(self) -> float:
        """Largest share of the last quarter that a command stood at its limit, or a reading."""
        return max(self._limited)

    @property
    def what_is_limited(self) -> str:
        """What stood there longest, a command or a reading."""
        commands, readings = self._limited
        return "command" if commands >= readings else "reading"

    @cached_property
    def _limited(self) -> tuple[float, float]:
        late = self.response.shape[1] // 4
        stood = [np.count_nonzero(used(run)[:, -late:] >= 1.0, axis=1) for run in self.runs]
        nu = len(self.runs[0].actuators)
        return tuple(max(float(each[part].max()) / late for each in stood) for part in (slice(nu), slice(nu, None)))

    @property
    def rise(self) -> float:
        """By how much noise in the commands grew from the first samples until one stands at its limit, over root time.

        Of two runs without a burst. What an offset heaps up is the same in both and no growth, however much it is; nor
        is what noise does where half the way there it is half as large or more.
        """
        rises = [0.0]
        noise = (self.runs[0].inputs - self.runs[1].inputs) / 2
        begun = np.sqrt(np.mean(noise[:, :AT_FIRST] ** 2, axis=1))
        for run in self.runs:
            first = np.flatnonzero(stands_at_limits(run.inputs, run.actuators).any(axis=0))
            if first.size and first[0] > AT_FIRST:
                there = np.abs(noise[:, first[0]])
                halfway = first[0] // 2 + np.arange(-AT_FIRST // 2, AT_FIRST // 2)
                by_then = np.sqrt(np.mean(noise[:, halfway] ** 2, axis=1))
                heard = (begun > 0) & (by_then < HALF * there) & (there > FROM_NOISE * np.abs(run.inputs[:, first[0]]))
                rises += list(there[heard] / begun[heard] / np.sqrt(first[0] / AT_FIRST))
        return float(max(rises))

    @property
    def before_limits(self) -> int:
        """How many samples pass before a command or a reading first stands at its limit, in either run."""
        return self.before(1.0)

    def before(self, share: float) -> int:
        """Return how many samples pass before a channel first uses this share of its range, in either run."""
        samples = self.response.shape[1]
        first = np.flatnonzero(np.any([(used(run)[:, -samples:] >= share).any(axis=0) for run in self.runs], axis=0))
        return int(first[0]) if first.size else samples

    def until(self, samples: int) -> "FreeResponse":
        """Return its first samples; `runs` stay as they are."""
        return replace(self, response=self.response[:, :samples], noise=self.noise[:, :samples])

    @property
    def of_offset(self) -> "FreeResponse":
        """Return what both runs have in common from their first sample until a command first stands at its limit.

        Without a burst that is what an offset sets going: it is there all at once, a step that the loop answers as it
        answers a burst. The mean of the first half, about which it swings, is left out.
        """
        a, b = (_after(run, 0) for run in self.runs)
        whole = replace(self, response=(a + b) / 2, noise=(a - b) / 2)
        free = whole.until(whole.before_limits)
        early = whole.response[:, : free.response.shape[1] // 2 + 1]  # one sample where it stands there at once
        return replace(free, response=free.response - early.mean(axis=1, keepdims=True))

    def hums_at(self, f_hz: float) -> bool:
        """Return whether the bench hums at a frequency without a law too, as far as the record tells two apart."""
        return near(f_hz, self.hums_hz, self.response.shape[1], self.runs[0].rate_hz)

    def from_outside(self, f_hz: float) -> bool:
        """Return whether what is heard at a frequency is known to be no mode of the loop."""
        return near(f_hz, self.outside_hz, self.response.shape[1], self.runs[0].rate_hz)


def near(f_hz: float, others_hz: Iterable[float], samples: int, rate_hz: float) -> bool:
    """Return whether one of the others is within a line of a record so long."""
    return any(abs(f_hz - other) <= Frames(samples, rate_hz).line_hz(1) for other in others_hz)


def used(run: Record) -> FloatArray:
    """Return which share of its range each command and reading uses, `(nu + ny, samples)`, one at a limit or beyond.

    A command's is counted from zero, a reading's from where it begins; one that begins at its limit uses nothing, as
    it shows nothing.
    """
    return np.vstack([_shares(run.inputs, run.actuators, 0.0), _shares(run.outputs, run.sensors, run.outputs[:, :1])])


@np.errstate(divide="ignore", invalid="ignore")
def _shares(signals: FloatArray, wires: Sequence[Channel], begun: FloatArray | float) -> FloatArray:
    low, high = _ends(wires)
    away = signals - begun
    shares = np.where(away > 0, away / (high - begun), away / (low - begun))
    return np.where((begun > low) & (begun < high), shares, 0.0)


def _ends(wires: Sequence[Channel]) -> tuple[FloatArray, FloatArray]:
    low, high = (np.array([getattr(c, end) for c in wires], dtype=np.float64)[:, None] for end in ("low", "high"))
    return low, high


def ranges(channels: Sequence[Channel]) -> FloatArray:
    """Return how far each channel may go to either side of zero, infinite where nothing limits it."""
    return np.array([max(0.0, min(-c.low, c.high)) for c in channels])


def swings(who: str, actuators: Sequence[Channel]) -> FloatArray:
    """Return the ranges of actuators.

    Raises:
        InputError: one of them cannot go to either side of zero, about which a law's commands swing.
    """
    own = ranges(actuators)
    for wire, reach in zip(actuators, own, strict=True):
        if not reach > 0:
            raise InputError(
                f"{who}: '{wire.name}' may be sent {wire.low:g} to {wire.in_unit(wire.high)}, which leaves commands no "
                f"room about zero; count them from the point it works at, and give limits to either side of that."
            )
    return own


def rooms(sensors: Sequence[Channel], rest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return from where each reading is counted and how far it may go to either side of that, `(ny,)` each.

    That is where it rests, `rest`; of a range about zero it is zero: where it rests says little of where it will swing
    about.
    """
    own, (low, high) = ranges(sensors), (end[:, 0] for end in _ends(sensors))
    aside = own < ASIDE * (high - low)
    span = np.where(np.isfinite(high - low), high - low, 1.0)
    room = np.maximum(np.minimum(high - rest, rest - low), LEAST_ROOM * span)
    return np.where(aside, rest, 0.0), np.where(aside, room, own)


def kicked(bench: Bench, law: StateSpace | Controller, burst: Burst) -> FreeResponse:
    """Return the loop's free response to a burst."""
    d = burst.signal()
    plus, minus = (disturb(bench, sign * d, law) for sign in (1.0, -1.0))
    a, b = (_after(run, burst.length) for run in (plus, minus))
    both = _after(disturb(bench, 0.0 * d, law), burst.length) if burst.hums_hz else (a + b) / 2
    later = both[:, both.shape[1] // 2 :]
    weights = np.ones(later.shape[1]) if burst.hums_hz else np.kaiser(later.shape[1], KAISER)
    rest = (later @ weights / weights.sum())[:, None]
    return FreeResponse((a - b) / 2, both - rest, (plus, minus), burst.hums_hz, burst.outside_hz)


def _after(run: Record, samples: int) -> FloatArray:
    return np.vstack([run.outputs, run.inputs])[:, samples:]


@dataclass(frozen=True, eq=False)
class Bursts:
    """The loudest bursts that a loop is given: equal at every hertz, and evened out by what the loop makes of that."""

    white: Burst
    coloured: Burst


def loudest(bench: Bench, law: StateSpace | Controller, length: int, samples: int, seed: int = 0) -> Bursts:
    """Return bursts that fill a share of the ranges of readings, commands and actuators; one in every octave alike.

    Begins at a thousandth of the actuators' ranges (one where nothing limits them), is coloured by what the loop made
    of it, and rises; the loop is taken to answer in proportion. Where neither end is limited, it rises until the
    readings stand far above their noise.
    """
    limits = ranges(bench.actuators)
    finite = np.isfinite(limits)
    level = np.where(finite, limits, limits[finite].min()) * BEGIN if finite.any() else np.ones(len(limits))
    white = _raised(bench, law, Burst(level, length, samples, bench.rate_hz, seed=seed))
    found = kicked(bench, law, white)
    return Bursts(white, _raised(bench, law, _coloured(white, found, bench)))


def louder(bench: Bench, law: StateSpace | Controller, burst: Burst) -> tuple[Burst, FreeResponse]:
    """Return a burst that was raised to the share of the ranges that it may use at most, and its response.

    Where the loop makes little of that, or sticks, each next one is twice as loud, as long as commands leave their
    limits again.
    """
    burst = replace(burst, levels=AT_MOST / USED_RANGE * burst.levels)
    found = kicked(bench, law, burst)
    for _ in range(RAISES):
        if found.limited > 0 or _rise(bench, found, burst.levels) * AT_MOST < 2 * USED_RANGE:
            break
        burst = replace(burst, levels=2 * burst.levels)
        found = kicked(bench, law, burst)
    return burst, found


def ended_early(burst: Burst, runs: Iterable[Record]) -> Burst:
    """Return the burst that is silent from where, in one of its runs, a channel uses more than it may at most."""
    over = np.any([(used(run)[:, : burst.lasts] > AT_MOST).any(axis=0) for run in runs], axis=0)
    return replace(burst, ends=int(np.argmax(over))) if over.any() else burst


def with_tones(bench: Bench, law: StateSpace | Controller, burst: Burst, modes_hz: tuple[float, ...]) -> Burst:
    """Return the burst with tones, raised by themselves to what the ranges allow; then both parts are halved."""
    if not modes_hz:
        return replace(burst, modes_hz=())
    alone = tones_alone(bench, law, burst, modes_hz)
    share = float(alone.levels[0] / burst.levels[0]) if burst.levels[0] else 1.0
    return replace(burst, modes_hz=modes_hz, random_share=0.5, tone_share=0.5 * share)


def tones_alone(bench: Bench, law: StateSpace | Controller, burst: Burst, modes_hz: tuple[float, ...]) -> Burst:
    """Return tones in place of the burst, as loud as the ranges allow."""
    return _raised(bench, law, replace(burst, modes_hz=modes_hz, random_share=0.0, tone_share=1.0))


def _raised(bench: Bench, law: StateSpace | Controller, burst: Burst) -> Burst:
    """Return the burst at the level that the ranges allow."""
    for _ in range(RAISES):
        found = kicked(bench, law, burst)
        rise = _rise(bench, found, burst.levels)
        burst = replace(burst, levels=burst.levels * float(np.clip(rise, 1 / RAISED_BY, RAISED_BY)))
        if 1 / NEAR <= rise <= NEAR:  # noise has its share in what was reached, so that one step may be too short
            break
    return burst


def _rise(bench: Bench, found: FreeResponse, levels: FloatArray) -> float:
    """Return by how much the burst may be raised; what is below the noise yet may rise as far as one step goes."""
    a, b = (_after(run, 0) for run in found.runs)
    total = a + b
    noise, size = (np.abs(x).max(axis=1) / 2 for x in (total - total.mean(axis=1, keepdims=True), a - b))
    rest = total[: len(bench.sensors)].mean(axis=1) / 2
    own = rooms(bench.sensors, rest)[1], ranges(bench.actuators), ranges(bench.actuators)
    allowed = USED_RANGE * np.concatenate(own)
    # what may hide in the noise is taken to be half of it: a burst raised as if it were nothing ends at the limits
    hidden = np.minimum(noise / 2, allowed[: noise.size] / NEAR)
    reached = np.concatenate([np.maximum(np.sqrt(np.maximum(size**2 - noise**2, 0.0)), hidden), levels])
    if np.isfinite(allowed).any():
        return 1.0 / max(float(np.max(reached / allowed)), 0.1 / RAISED_BY)
    heard = noise > 0
    heard[len(bench.sensors) :] = False
    return float(np.max(LOUD * noise[heard] / np.maximum(size, noise)[heard])) if heard.any() else 1.0


def _coloured(burst: Burst, found: FreeResponse, bench: Bench) -> Burst:
    """Return the burst weaker where the loop answers strongly, so that no resonance uses up the range alone."""
    y = np.vstack([np.subtract(*(getattr(run, end) for run in found.runs)) / 2 for end in ("outputs", "inputs")])
    y = y[:, : 2 * burst.length]  # later, what rings longest would count most, and be driven least
    rest = np.mean([run.outputs.mean(axis=1) for run in found.runs], axis=0)
    unit = np.concatenate([rooms(bench.sensors, rest)[1], ranges(bench.actuators)])
    own = np.abs(y).max(axis=1)
    unit = np.where(np.isfinite(unit), unit, np.maximum(own, np.finfo(float).tiny))
    size = np.abs(np.fft.rfft(y / unit[:, None], axis=1)).max(axis=0)[1:]
    f = np.fft.rfftfreq(y.shape[1], 1 / bench.rate_hz)[1:]
    octave = np.floor(COLOURS_PER_OCTAVE * np.log2(f / f[0])).astype(int)
    parts = [octave == k for k in np.unique(octave)]
    centres = tuple(float(np.sqrt(f[part].min() * f[part].max())) for part in parts)
    # Equal in every octave: noise that is equal at every hertz has next to nothing where structures are slow.
    answer = np.array([size[part].max() for part in parts]) * np.sqrt(centres)
    weakest = LEAST_COLOUR * answer.max()
    if not weakest > 0:
        return burst
    colour = weakest / np.maximum(answer, weakest)
    return replace(burst, colour_hz=centres, colour=tuple(colour.tolist()))
