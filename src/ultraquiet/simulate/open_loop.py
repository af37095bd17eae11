"""What a bench does without a law, measured once for all laws: its directions, its noise, and how loud it may be."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InterlockError
from ultraquiet.bench import Bench
from ultraquiet.experiments import real_time
from ultraquiet.simulate.kick import ranges, rooms, swings
from ultraquiet.simulate.loop import disturb
from ultraquiet.simulate.sweeps.clock import SweepClock
from ultraquiet.simulate.sweeps.directions import directions
from ultraquiet.simulate.sweeps.lines import inverted, largest, over
from ultraquiet.simulate.sweeps.rest import NOISE_LINES, Quiet, rest_of, smoothed
from ultraquiet.values import Channel, Record, StateSpace
from ultraquiet.values.channel import at_limits
from ultraquiet.values.controller import Controller

# Length of a run: seconds, and the least and most samples to which it is doubled or halved.
RUN_S, FEWEST, MOST = 16.0, 1 << 13, 1 << 17
# Periods of the lowest line in a run; the highest as a share of the Nyquist frequency; where the two bands meet, as a
# share of the octaves; by how much the runs of the faster one are shorter.
LOWEST_PERIODS, HIGHEST, SPLIT, FASTER = 64.0, 0.96, 0.33, 4
# Lines between those of a run, in either band, and lines at most where what rings for long asks for closer ones; a
# bench in real time is listened to for so many times a run.
FINER, FINER_FAST, MOST_LINES, WAITED = 4, 4, 1 << 17, 4
# A run is made longer while what rings on leaves more than this share of a line open, in more lines than these, and as
# long as more silence leaves less than this of it; simulated ones up to so many samples.
OPEN, OPEN_LINES, LESS, LONGEST = 0.02, 4, 0.98, 1 << 20
OVERLAP = 1.1  # of the bands, where each fades
EDGE = 1.05  # where a sweep fades in and out
BELOW = 0.7  # where a band below begins, over where the one above does
FEWEST_PERIODS = 20.0  # of its lowest line in a run: fewer, and the short runs do not tell the lines of a band apart
PER_DECADE = 60  # frequencies at which directions and levels are held
SHORTER = 4  # the runs that find directions and levels are so much shorter
# Shares of the channels' ranges: where the first run begins, and what a run may use; then what it may use with a law,
# whose amplification is not known yet.
BEGIN, USED_RANGE, USED_DRIVE = 1e-3, 0.5, 0.9
# Where nothing limits a channel, readings are made this much larger than their noise.
LOUD = 1e3
LEVELLINGS, LEVELLED = 4, 3.0
# Runs that meet limits are made again, so much lower, so many times.
LOWER, LOWERED = 0.7, 4
# Likewise where an interlock ended one; a loop that trips it however weak the sweep is runs away.
WEAKER, WEAKENED = 0.5, 5
# Points of the grid to either side that a level heeds: a resonance just passed still rings; the most it is raised by.
REACH, RAISED_BY = 2, 30.0


@dataclass(frozen=True, eq=False)
class Runs:
    """Sweeps in `k` directions: what was sent `(nu, k, lines)` and what came back `(ny, k, lines)`, as spectra.

    `levels` `(k, grid)`: how loud each was; `better`: how loud it may be. `clipped`: points at which a limit was met.
    `length`: how long they were, in runs. `open`: what is not known of `heard` as it still moved at the end; `rounded`:
    power that converters add to it, `(ny, k)`.
    """

    sent: ComplexArray
    heard: ComplexArray
    levels: FloatArray
    better: FloatArray
    clipped: int
    length: int
    open: FloatArray
    rounded: FloatArray

    @property
    def is_open(self) -> np.ndarray:
        """Which spectra of a line are left open, `(ny, k, lines)`."""
        return np.asarray(self.open > OPEN * np.abs(self.heard))

    @property
    def lines_open(self) -> int:
        """How many are."""
        return int(np.count_nonzero(self.is_open))


@dataclass(frozen=True, eq=False)
class OpenBand:
    """The open loop over the range of one sweep; runs are made when they are first asked for."""

    bench: Bench
    sweep: SweepClock

    def as_fine_as_it_rings(self) -> "OpenBand":
        """Return this band with lines as close as its runs had to be long: S is as sharp as the open loop rings."""
        return self.as_fine_as(self.runs.length)

    def as_fine_as(self, length: int) -> "OpenBand":
        """Return this band with lines for what rings for runs of a length, itself where they are as close already."""
        finer = min(2 * length, 2 * MOST_LINES // self.sweep.samples)
        if length == 1 or finer <= self.sweep.finer:
            return self
        other = OpenBand(self.bench, replace(self.sweep, finer=finer))
        other.__dict__.update({"short": self.short, "shapes": self.shapes})
        return other

    @cached_property
    def short(self) -> "OpenBand":
        """The same range, swept in less time: for directions and levels."""
        return OpenBand(self.bench, replace(self.sweep, samples=self.sweep.samples // SHORTER, finer=1))

    @cached_property
    def grid_hz(self) -> FloatArray:
        """Frequencies at which directions and levels are held."""
        low, high = self.sweep.low_hz, self.sweep.high_hz
        return np.geomspace(low, high, max(4, int(PER_DECADE * np.log10(high / low))))

    @cached_property
    def noise(self) -> FloatArray:
        """Size of the noise in the spectrum of one run, `(ny, lines)`."""
        return self.noise_of(self.resting)

    def quiet(self, law: StateSpace | Controller | None) -> Quiet:
        """Return a run in which nothing is sent."""
        silence = np.zeros((len(self.bench.actuators), self.sweep.samples))
        return Quiet(self.sweep, disturb(self.bench, silence, law).outputs)

    @cached_property
    def resting(self) -> Quiet:
        """The run without a law in which nothing is sent."""
        return self.quiet(None)

    def noise_of(self, quiet: Quiet) -> FloatArray:
        """Return the size of the noise in the spectrum of one run, `(ny, lines)`, from a run that was quiet."""
        alone = quiet.alone
        power = np.abs(self.sweep.transform(alone - alone.mean(axis=1, keepdims=True))) ** 2
        return np.sqrt(smoothed(power))

    @cached_property
    def scale(self) -> FloatArray:
        """Range of each actuator; one where nothing limits any, `(nu,)`."""
        own = swings("measure_sensitivity", self.bench.actuators)
        finite = np.isfinite(own)
        return np.where(finite, own, own[finite].min() if finite.any() else 1.0)

    @cached_property
    def quiet_rms(self) -> FloatArray:
        """Size of the noise of each sensor, `(ny,)`."""
        return np.sqrt(np.mean(self.resting.alone**2, axis=1))

    @cached_property
    def units(self) -> FloatArray:
        """Range of each sensor; where nothing limits it, so many times its noise, or one."""
        own = self._rooms[1]
        loud = LOUD * self.quiet_rms
        return np.where(np.isfinite(own), own, np.where(loud > 0, loud, 1.0))

    @property
    def centre(self) -> FloatArray:
        """Where readings are counted from: zero, or where one rests whose range does not lie about zero, `(ny,)`."""
        return self._rooms[0]

    @cached_property
    def _rooms(self) -> tuple[FloatArray, FloatArray]:
        return rooms(self.bench.sensors, self.resting.readings.mean(axis=1))

    @cached_property
    def shapes(self) -> ComplexArray:
        """Directions of the disturbance at the grid, `(nu, nu, grid)`: each moves one direction of sensors, or none.

        Columns of the response's pseudo-inverse in ranges of actuators, so that the weak directions are driven as much
        stronger as they are weaker; each of size one, and in phase with its neighbour. With more actuators than sensors
        the others are those that no sensor hears: no few directions would do for both loops, as a sweep that grows and
        falls is not of one direction alone.
        """
        nu, points = len(self.bench.actuators), self.grid_hz.size
        one_by_one = np.zeros((nu, nu, points), dtype=np.complex128)
        one_by_one[range(nu), range(nu)] = self.scale[:, None]
        runs = self.short.run(None, one_by_one, np.full((nu, points), BEGIN), LEVELLINGS, quiet=self.short.resting)
        f = self.short.sweep.lines_hz
        at = np.searchsorted(f, self.grid_hz).clip(0, f.size - 1)
        G = np.moveaxis(over(runs.heard, runs.sent)[:, :, at], 2, 0) * self.scale / self.units[:, None]
        return self.scale[:, None, None] * np.moveaxis(directions(G), 0, 2)

    @cached_property
    def runs(self) -> Runs:
        """The open loop, as loud as the ranges allow in every direction at every frequency."""
        level = np.full((self.shapes.shape[1], self.grid_hz.size), BEGIN)
        levels = self.short.run(None, self.shapes, level, LEVELLINGS).better
        return self.rested(None, levels, self.resting)

    def rested(self, law: StateSpace | Controller | None, levels: FloatArray, quiet: Quiet, length: int = 1) -> Runs:
        """Return runs that end at rest, as far as more silence brings them there; lower ones where limits were met.

        `quiet`: a run in which nothing is sent; `length`: of the first ones, in runs.
        """
        runs = self.run(law, self.shapes, levels, 1, length, quiet)
        for _ in range(LOWERED):
            if not runs.clipped:
                break
            levels = np.minimum(levels, LOWER * runs.better)
            runs = self.run(law, self.shapes, levels, 1, length, quiet)
        most = WAITED if real_time(self.bench) else max(WAITED, LONGEST // self.sweep.samples)
        while runs.lines_open > OPEN_LINES and runs.length < most:
            longer = self.run(law, self.shapes, levels, 1, min(most, 2 * runs.length), quiet)
            # the median, for near what rings on nothing is known until it is gone; of what was open, for much never was
            was = runs.is_open
            if not np.median(longer.open[was]) < LESS * np.median(runs.open[was]):
                return longer if longer.lines_open < runs.lines_open else runs
            runs = longer
        return runs

    @cached_property
    def response(self) -> ComplexArray:
        """Sensors over actuators, `(ny, nu, lines)`."""
        return over(self.runs.heard, self.runs.sent)

    @cached_property
    def deviation(self) -> FloatArray:
        """What the open loop's noise leaves open of an S of size one, `(lines,)`, each the median of its neighbours."""
        inverse = inverted(np.moveaxis(self.runs.heard, 2, 0))
        left = np.hypot(np.linalg.norm(noise_rows(self.runs, self.noise), axis=0), still_moving(self.runs))
        deviation = largest(inverse) * left
        padded = np.pad(deviation, NOISE_LINES, mode="reflect")
        return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NOISE_LINES + 1), axis=1)

    def run(
        self,
        law: StateSpace | Controller | None,
        shapes: ComplexArray,
        levels: FloatArray,
        levellings: int = 1,
        length: int = 1,
        quiet: Quiet | None = None,
    ) -> Runs:
        """Run one sweep in each direction; anew at better levels until they fit, or so many times.

        `length`: of each with the silence behind it, in runs; `quiet`: one in which nothing is sent, absent where only
        levels are looked for.
        """
        silence = (length - 1) * self.sweep.samples
        made = [self._levelled(law, shapes[:, k], levels[k], levellings, silence) for k in range(shapes.shape[1])]
        found = [(self.sweep.transform(d), *self._heard(record.outputs, quiet), *more) for d, record, *more in made]
        sent, heard, left, rounded, level, better, clipped = zip(*found, strict=True)
        spectra = np.stack(sent, axis=1), np.stack(heard, axis=1)
        moving = np.stack(left, axis=1), np.stack(rounded, axis=1)
        return Runs(*spectra, np.stack(level), np.stack(better), sum(clipped), length, *moving)

    def _levelled(
        self, law: StateSpace | Controller | None, shape: ComplexArray, level: FloatArray, times: int, silence: int
    ) -> tuple[FloatArray, Record, FloatArray, FloatArray, int]:
        tripped = 0
        while True:
            d = self.sweep.signal(self.grid_hz, shape, level)
            beyond = self._beyond(d)
            d, level = d / beyond, level / beyond
            try:
                record = disturb(self.bench, np.pad(d, ((0, 0), (0, silence))), law)
            except InterlockError as error:
                # what other benches cut off ends the run of one that is guarded: the next is weaker, and begins at rest
                tripped += 1
                if not error.of_level or tripped > WEAKENED:
                    raise
                level = WEAKER * level
                self.quiet(None)
                continue
            change = self._change(d, record, law is not None)
            clipped = int(sum(at_limits(*x).sum() for x in _channels(record)))
            times -= 1
            if not times or (not clipped and np.median(np.abs(np.log(change))) < np.log(LEVELLED)):
                return d, record, level, level * change, clipped
            level = level * change

    def _beyond(self, d: FloatArray) -> float:
        """Return how many times the ranges of the actuators a signal needs, one where it fits: a guard refuses it."""
        own = ranges(self.bench.actuators)
        return float(np.max(np.abs(d).max(axis=1)[own > 0] / own[own > 0], initial=1.0))

    def _heard(self, y: FloatArray, quiet: Quiet | None) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """Return spectra `(ny, lines)` of what came back, what is not known of them, and the power of rounding."""
        if quiet is not None:
            return *quiet.spectra(y), quiet.rounding(y)
        heard = self.sweep.transform(y)
        return heard, np.zeros(heard.shape), np.zeros(len(y))

    def _change(self, d: FloatArray, record: Record, closed: bool) -> FloatArray:
        """Return by how much the level may be raised at the grid, `(grid,)`."""
        drive = USED_RANGE / USED_DRIVE
        rest = rest_of(record.outputs)
        rest = np.zeros(len(self.units)) if rest is None else rest
        limited = np.isfinite(ranges(self.bench.sensors))
        reached = [(record.outputs - rest[:, None], self.units), (drive * d, self.scale)]
        reached += [(drive * record.inputs, self.scale)] if closed else []
        used = [
            self.sweep.envelope(row / size, self.grid_hz)
            for x, unit in reached
            for row, size in zip(x, unit, strict=True)
        ]
        for k in np.flatnonzero(limited):
            used[k] = used[k] + abs(rest[k] - self.centre[k]) / self.units[k]  # an offset uses up the range
        padded = np.pad(np.max(used, axis=0), REACH, mode="edge")
        around = np.max(np.lib.stride_tricks.sliding_window_view(padded, 2 * REACH + 1), axis=1)
        return np.clip(USED_RANGE / np.maximum(around, 1e-12), 1 / RAISED_BY, RAISED_BY)


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """A bench in open loop; runs are made when they are first asked for. Give one object to all laws of a bench.

    Slow and fast frequencies are swept by themselves: fast ones die soon, and noise is heard for less long.

    Args:
        bench: as it will be closed.
        seconds: length of each run; 16 s when absent, more or less where the rate asks for it.
    """

    bench: Bench
    seconds: float | None = None
    _below: dict[tuple[float, int], OpenBand] = field(default_factory=dict[Any, Any], init=False, repr=False)

    @cached_property
    def bands(self) -> tuple[OpenBand, OpenBand]:
        """The slower and the faster half."""
        seconds, rate = self.seconds or RUN_S, self.bench.rate_hz
        while self.seconds is None and seconds * rate < FEWEST:
            seconds *= 2
        while self.seconds is None and seconds * rate > MOST:
            seconds /= 2
        low, high = LOWEST_PERIODS / seconds, HIGHEST * rate / 2
        between = low * (high / low) ** SPLIT
        slow = SweepClock(round(seconds * rate), rate, low, OVERLAP * between, FINER, even=False)
        fast = SweepClock(round(seconds * rate / FASTER), rate, between / OVERLAP, high, FINER_FAST)
        return OpenBand(self.bench, slow).as_fine_as_it_rings(), OpenBand(self.bench, fast).as_fine_as_it_rings()

    def downwards(self, to_hz: float | None = None) -> Iterator[OpenBand]:
        """Bands below, one after the other: runs for few frequencies, for loops that amplify most down there.

        They end where a run is too short; runs that lines at `to_hz` need are longer, up to those of other benches.
        """
        band, sweep = self.bands[0], self.bands[0].sweep
        while True:
            low_hz, samples = band.sweep.low_hz, sweep.samples
            fewest = FEWEST_PERIODS * band.sweep.rate_hz / (BELOW * low_hz)
            while to_hz is not None and to_hz < EDGE * low_hz and samples < fewest and 2 * samples <= MOST:
                samples *= 2
            if samples < fewest:
                return
            key, limits = (low_hz, samples), {"low_hz": BELOW * low_hz, "high_hz": OVERLAP * low_hz}
            if key not in self._below:
                self._below[key] = OpenBand(self.bench, replace(sweep, samples=samples, **limits)).as_fine_as_it_rings()
            yield (band := self._below[key])

    def apart(self) -> "OpenLoop":
        """Return this open loop, measured, on a copy of its bench as it stands then.

        A bench draws its noise by the number of the run: on a copy of its own no law's figures hang on which other laws
        ran before. What cannot be copied, a process or hardware, stays what it is.
        """
        for band in self.bands:
            _ = band.response, band.deviation, band.units, band.noise
        try:
            bench = deepcopy(self.bench)
        except (TypeError, ValueError):
            return self
        alone = OpenLoop(bench, self.seconds)
        alone.__dict__["bands"] = tuple(_on(band, bench) for band in self.bands)
        return alone


def _on(band: OpenBand, bench: Bench) -> OpenBand:
    """Return a band with what was measured of it, on another bench."""
    other = OpenBand(bench, band.sweep)
    other.__dict__.update({key: value for key, value in band.__dict__.items() if key not in ("bench", "sweep")})
    if "short" in band.__dict__:
        other.__dict__["short"] = _on(band.short, bench)
    return other


def _channels(record: Record) -> tuple[tuple[FloatArray, tuple[Channel, ...]], ...]:
    return (record.outputs, record.sensors), (record.inputs, record.actuators)


def noise_rows(runs: Runs, noise: FloatArray) -> FloatArray:
    """Return the noise in spectra of runs, `(ny, lines)`: `noise` of a run `(ny, lines)`, and what converters round."""
    return np.sqrt(runs.length * noise**2 + runs.rounded.max(axis=1)[:, None])


def still_moving(runs: Runs) -> FloatArray:
    """Return how far spectra of runs may be off, `(lines,)`, as they still moved when they ended."""
    return np.sqrt(np.sum(runs.open.max(axis=1) ** 2, axis=0))
