"""The open loop of a bench over the range of one sweep: its directions, its noise, and how loud it may be."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InterlockError
from ultraquiet.bench import Bench
from ultraquiet.experiments import real_time
from ultraquiet.simulate.kick import ranges, rooms, swings
from ultraquiet.simulate.loop import disturb
from ultraquiet.simulate.sweeps.clock import SweepClock
from ultraquiet.simulate.sweeps.directions import Directions
from ultraquiet.simulate.sweeps.lines import over
from ultraquiet.simulate.sweeps.rest import Quiet, rest_of, smoothed
from ultraquiet.simulate.sweeps.runs import Runs, deviation_of
from ultraquiet.simulate.sweeps.sharper import sharper
from ultraquiet.values import Channel, Record, StateSpace
from ultraquiet.values.channel import at_limits
from ultraquiet.values.controller import Controller

# Lines at most where what rings for long asks for closer ones; a bench in real time is listened to for so many times a
# run.
MOST_LINES, WAITED = 1 << 17, 4
# A run is made longer while what rings on leaves more lines open than these, and as long as more silence leaves less
# than this of it; simulated ones up to so many samples.
OPEN_LINES, LESS, LONGEST = 4, 0.98, 1 << 20
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
# Lines are heard where the open loop's noise leaves less of an S of size one open, and their directions are known where
# it leaves less than that. Runs are made anew in sharper directions, so many times at most, while one of those may be
# this much louder at a line that is not heard.
HEARD, KNOWN, SHARPENED, LOUDER = 0.02, 0.3, 3, 1.5


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
        other.__dict__.update({"short": self.short, "first": self.directions})
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
    def first(self) -> Directions:
        """Directions of the disturbance at the grid, `nu`: each moves one direction of sensors, or none.

        Columns of the response's pseudo-inverse in ranges of actuators, so that the weak directions are driven as much
        stronger as they are weaker; each of size one, and in phase with its neighbour. With more actuators than sensors
        the others are those that no sensor hears: no few directions would do for both loops, as a sweep that grows and
        falls is not of one direction alone.
        """
        nu, grid = len(self.bench.actuators), self.grid_hz
        one_by_one = Directions(grid, np.repeat(np.diag(self.scale)[:, :, None], grid.size, axis=2).astype(complex))
        level = np.full((nu, grid.size), BEGIN)
        runs = self.short.run(None, one_by_one, level, LEVELLINGS, quiet=self.short.resting)
        f = self.short.sweep.lines_hz
        at = np.searchsorted(f, grid).clip(0, f.size - 1)
        return self._of_ranges(Directions.of(grid, self._in_ranges(over(runs.heard, runs.sent)[:, :, at])))

    def _in_ranges(self, G: ComplexArray) -> ComplexArray:
        """Return responses `(ny, nu, points)` with every channel in its range."""
        return G * self.scale[:, None] / self.units[:, None, None]

    def _of_ranges(self, shares: Directions) -> Directions:
        """Return directions that are given in ranges of actuators in their units."""
        return replace(shares, vectors=self.scale[:, None, None] * shares.vectors)

    @cached_property
    def _made(self) -> tuple[Directions, Runs]:
        """The directions and the runs in them, as loud as the ranges allow in every direction at every frequency."""
        level = np.full((len(self.first), self.grid_hz.size), BEGIN)
        levels = self.short.run(None, self.first, level, LEVELLINGS).better
        made = self.first, self.rested(None, self.first, levels, self.resting)
        deviation = deviation_of(made[1], self.noise)
        best, fewest = made, np.count_nonzero(deviation >= HEARD)
        for _ in range(SHARPENED):
            if (better := self._sharper(made[1], deviation)) is None:
                break
            made = better, self.rested(None, better, made[1].better, self.resting)
            deviation = deviation_of(made[1], self.noise)
            if (hidden := np.count_nonzero(deviation >= HEARD)) < fewest:
                best, fewest = made, hidden
        return best

    def _sharper(self, runs: Runs, deviation: FloatArray) -> Directions | None:
        """Return sharper directions, where these may be driven louder at lines that a run did not hear, or None."""
        own = slice(None, None, self.sweep.finer)  # lines of a run
        f_hz, deviation = self.sweep.lines_hz[own], deviation[own]
        G = self._in_ranges(over(runs.heard, runs.sent)[:, :, own])
        faint = (deviation >= HEARD) & (deviation < KNOWN)
        if np.count_nonzero(faint) <= OPEN_LINES:
            return None
        most = Directions.of(f_hz[faint], G[:, :, faint]).loudest(G[:, :, faint], USED_RANGE, USED_DRIVE)
        at, grid = np.log(f_hz[faint]), np.log(self.grid_hz)
        levels = np.exp([np.interp(at, grid, np.log(level)) for level in runs.levels])
        louder = np.any(most > LOUDER * levels, axis=0)
        if np.count_nonzero(louder) <= OPEN_LINES:
            return None
        return self._of_ranges(sharper(f_hz, G, deviation < KNOWN))

    @property
    def directions(self) -> Directions:
        """In which the disturbance is swept."""
        return self._made[0]

    @property
    def runs(self) -> Runs:
        """The open loop in these directions."""
        return self._made[1]

    def rested(
        self,
        law: StateSpace | Controller | None,
        ways: Directions,
        levels: FloatArray,
        quiet: Quiet,
        length: int = 1,
    ) -> Runs:
        """Return runs that end at rest, as far as more silence brings them there; lower ones where limits were met.

        `quiet`: a run in which nothing is sent; `length`: of the first ones, in runs.
        """
        runs = self.run(law, ways, levels, 1, length, quiet)
        for _ in range(LOWERED):
            if not runs.clipped:
                break
            levels = np.minimum(levels, LOWER * runs.better)
            runs = self.run(law, ways, levels, 1, length, quiet)
        most = WAITED if real_time(self.bench) else max(WAITED, LONGEST // self.sweep.samples)
        while runs.lines_open > OPEN_LINES and runs.length < most:
            longer = self.run(law, ways, levels, 1, min(most, 2 * runs.length), quiet)
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
        return deviation_of(self.runs, self.noise)

    def run(
        self,
        law: StateSpace | Controller | None,
        ways: Directions,
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
        made = [self._levelled(law, ways, k, levels[k], levellings, silence) for k in range(len(ways))]
        found = [(self.sweep.transform(d), *self._heard(record.outputs, quiet), *more) for d, record, *more in made]
        sent, heard, left, rounded, level, better, clipped = zip(*found, strict=True)
        spectra = np.stack(sent, axis=1), np.stack(heard, axis=1)
        moving = np.stack(left, axis=1), np.stack(rounded, axis=1)
        return Runs(*spectra, np.stack(level), np.stack(better), sum(clipped), length, *moving)

    def _levelled(
        self,
        law: StateSpace | Controller | None,
        ways: Directions,
        k: int,
        level: FloatArray,
        times: int,
        silence: int,
    ) -> tuple[FloatArray, Record, FloatArray, FloatArray, int]:
        tripped = 0
        while True:
            d = self.sweep.signal(ways, k, self.grid_hz, level)
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


def _channels(record: Record) -> tuple[tuple[FloatArray, tuple[Channel, ...]], ...]:
    return (record.outputs, record.sensors), (record.inputs, record.actuators)
