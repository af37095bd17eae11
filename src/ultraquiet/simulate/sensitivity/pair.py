"""Open and closed loop of one law over one band: passes that are averaged, and the lines that S asks for."""

import itertools
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.open_loop import EDGE
from ultraquiet.simulate.sensitivity.measured import DEVIATIONS, RESOLVED, size_of
from ultraquiet.simulate.sensitivity.neighbours import LinesOfS, together
from ultraquiet.simulate.sensitivity.one_pass import ROUNDING, LeftOpen, OnePass
from ultraquiet.simulate.sweeps.band import HEARD, LOWER, OpenBand
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

# Passes at most; each is louder where the one before was hidden. Lines that were not asked for one by one lie where the
# open loop is heard: another pass is made when more than this share of them is hidden, or one that would be the peak.
PASSES, HIDDEN = 4, 0.25
SURE = 4.0  # deviations above its neighbours, for one of many lines to be a needle
# First lines are apart by this share of their frequency; between two whose worst direction differs by more, there are
# further ones, down to the resolution of a run.
APART, STEP_DB = 0.003, 0.5
# A law's first, short sweeps are so much lower than those of the open loop.
BEGIN_CLOSED = 0.3


@dataclass(frozen=True, eq=False)
class BandLines:
    """What one band gave: lines in Hz, S, its deviation, both responses."""

    f_hz: FloatArray
    S: ComplexArray
    deviation: FloatArray
    opened: ComplexArray
    closed: ComplexArray
    rings: bool


class LoopPair:
    """Open and closed loop of one law over one band; passes are averaged, each with the weight that noise leaves it."""

    def __init__(self, band: OpenBand, law: StateSpace | Controller) -> None:
        self._law, self._length = law, 1
        begin = BEGIN_CLOSED * band.runs.levels
        self._levels = LOWER * band.short.run(law, band.directions, begin, 2).better
        self._on(band)

    def _on(self, band: OpenBand) -> None:
        """Begin with the lines of a band."""
        self.band, self._quiet, self._rings = band, band.quiet(self._law), False
        self._noise = band.noise_of(self._quiet)
        ny, nu, lines = len(band.bench.sensors), len(band.bench.actuators), band.sweep.lines.size
        self._weight = np.zeros(lines)
        self._S = np.zeros((ny, ny, lines), dtype=np.complex128)
        self._closed = np.zeros((ny, nu, lines), dtype=np.complex128)
        self._left = LeftOpen(*np.zeros((4, lines)))

    def at(self, asked: np.ndarray | None, most_hidden: float = HIDDEN) -> BandLines:
        """Measure, again and louder where noise hides lines, and return these lines or those that S asks for.

        A loop that rings for longer than the open one has an S that is sharper than the lines which that one has: they
        are chosen from closer ones.
        """
        for _ in range(PASSES - 1):
            found, hidden = self._once(asked)
            few = np.count_nonzero(hidden) <= (0 if asked is not None else most_hidden * hidden.size)
            if few and not decides(hidden, size_of(found.S), found.deviation):
                return found
        return self._once(asked)[0]

    def _once(self, asked: np.ndarray | None) -> tuple[BandLines, np.ndarray]:
        """Measure once more, and return the lines with which of them another pass might resolve."""
        self._measure()
        if asked is None and (sharper := self.band.as_fine_as(self._length)) is not self.band:
            self._on(sharper)
            self._measure()
        places = self._dense() if asked is None else asked
        S, noise, moving = self._lines().with_neighbours(places)
        size, deviation = size_of(S), together(noise, moving)
        # no pass resolves a line that the open loop hides by itself
        by_open = np.hypot(noise[1], self._left.opened_moving[places])
        hidden = (deviation > RESOLVED * size) & (by_open <= RESOLVED * size)
        opened, closed = self.band.response[:, :, places], self._closed[:, :, places]
        rings = self._rings or self.band.runs.lines_open > 0
        return BandLines(self.band.sweep.lines_hz[places], S, deviation, opened, closed, rings), hidden

    def _measure(self) -> None:
        band = self.band
        closed = band.rested(self._law, band.directions, self._levels, self._quiet, self._length)
        self._levels, self._length, self._rings = closed.better, closed.length, closed.lines_open > 0
        one = OnePass(band, closed, self._noise)
        weight = 1 / np.maximum(np.hypot(one.left.closed, one.left.moving), ROUNDING) ** 2
        self._weight += weight
        share = weight / self._weight
        self._S += share * (np.moveaxis(one.S, 0, 2) - self._S)
        self._closed += share * (one.response - self._closed)
        self._left = self._left.averaged(one.left, share)
        self._last = one

    def _lines(self) -> LinesOfS:
        """Return S of all passes, with what is left open of it."""
        left, last = self._left, self._last
        fewer = left.closed / np.maximum(last.left.closed, np.finfo(float).tiny)
        rows = np.sqrt((fewer * last.closed_rows) ** 2 + last.opened_rows**2)
        return LinesOfS(self._S, left.noise, left.all_moving, rows, last.answers, self.band.sweep.finer)

    def _dense(self) -> np.ndarray:
        """Return the places of the lines that S asks for, where the open loop is heard."""
        f, sweep = self.band.sweep.lines_hz, self.band.sweep
        heard = np.flatnonzero((self.band.deviation < HEARD) & (f > EDGE * sweep.low_hz) & (f < sweep.high_hz / EDGE))
        if not heard.size:
            return heard
        first, last = f[heard[0]], f[heard[-1]]
        wanted = np.geomspace(first, last, max(2, int(np.log(last / first) / APART)))
        places = np.unique(np.searchsorted(f, wanted).clip(heard[0], heard[-1]))
        size = size_of(self._S)
        level = 20 * np.log10(size)
        while True:
            steep = (np.abs(np.diff(level[places])) > STEP_DB) & (np.diff(places) > 1)
            between = (places[:-1] + places[1:])[steep] // 2
            needles = _needles(size, self._left.deviation, places)
            if not between.size and not needles.size:
                return places
            places = np.unique(np.concatenate([places, between, needles]))


def decides(hidden: np.ndarray, size: FloatArray, deviation: FloatArray) -> bool:
    """Return whether the bound of a hidden line would be read as the peak, by more than a step above what is heard."""
    heard = size[~hidden].max(initial=0.0)
    return bool((size + DEVIATIONS * deviation)[hidden].max(initial=0.0) > heard * 10 ** (STEP_DB / 20))


def _needles(size: FloatArray, deviation: FloatArray, places: np.ndarray) -> np.ndarray:
    """Return the largest line between two, where it stands above both by a step that is no noise."""
    found = []
    for first, last in itertools.pairwise(places):
        k = first + int(np.argmax(size[first : last + 1]))
        beside = max(size[first], size[last])
        if size[k] > beside * 10 ** (STEP_DB / 20) and size[k] - beside > SURE * deviation[k]:
            found.append(k)
    return np.array(found, dtype=int)
