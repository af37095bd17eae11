"""Open and closed loop of one law over one band: passes that are averaged, and the lines that S asks for."""

import itertools
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.open_loop import LOWER, OpenBand, Runs, inverted, largest, left_open
from ultraquiet.simulate.sensitivity.measured import DEVIATIONS, RESOLVED, size_of
from ultraquiet.simulate.sensitivity.neighbours import with_neighbours
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

# Passes at most; each is louder where the one before was hidden. Lines that were not asked for one by one lie where the
# open loop is heard: another pass is made when more than this share of them is hidden, or one that would be the peak.
PASSES, HIDDEN = 4, 0.25
SURE = 4.0  # deviations above its neighbours, for one of many lines to be a needle
# First lines are apart by this share of their frequency; between two whose worst direction differs by more, there are
# further ones, down to the resolution of a run.
APART, STEP_DB = 0.003, 0.5
# Lines are chosen where the open loop by itself would leave an S of size one this much open.
HEARD = 0.02
ROUNDING = 1e-9  # what is left of a deviation without noise
EDGE = 1.05  # where a sweep fades in and out
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
        self.band, self._law = band, law
        self._quiet, self._length, self._rings = band.quiet(law), 1, False
        self._noise = band.noise_of(self._quiet)
        ny, nu = len(band.bench.sensors), len(band.bench.actuators)
        begin = BEGIN_CLOSED * band.runs.levels
        self._levels = LOWER * band.short.run(law, band.shapes, begin, 2).better
        self._weight, self._by_open = np.zeros((2, band.sweep.lines.size))
        self._S = np.zeros((ny, ny, self._weight.size), dtype=np.complex128)
        self._closed = np.zeros((ny, nu, self._weight.size), dtype=np.complex128)

    def at(self, asked: np.ndarray | None, most_hidden: float = HIDDEN) -> BandLines:
        """Measure, again and louder where noise hides lines, and return these lines or those that S asks for."""
        for _ in range(PASSES - 1):
            found, hidden = self._once(asked)
            few = np.count_nonzero(hidden) <= (0 if asked is not None else most_hidden * hidden.size)
            if few and not decides(hidden, size_of(found.S), found.deviation):
                return found
        return self._once(asked)[0]

    def _once(self, asked: np.ndarray | None) -> tuple[BandLines, np.ndarray]:
        """Measure once more, and return the lines with which of them another pass might resolve."""
        self._measure()
        places = self._dense() if asked is None else asked
        left = np.stack([1 / np.sqrt(self._weight), self._by_open])
        S, (by_closed, by_open) = with_neighbours(self._S, left, places, self.band.sweep.finer)
        size, deviation = size_of(S), np.hypot(by_closed, by_open)
        # no pass resolves a line that the open loop's noise hides by itself
        hidden = (deviation > RESOLVED * size) & (by_open <= RESOLVED * size)
        opened, closed = self.band.response[:, :, places], self._closed[:, :, places]
        rings = self._rings or self.band.runs.lines_open > 0
        return BandLines(self.band.sweep.lines_hz[places], S, deviation, opened, closed, rings), hidden

    @property
    def _deviation(self) -> FloatArray:
        """What noise leaves open: less with each pass but for the open loop's own, the same in all of them."""
        return np.hypot(1 / np.sqrt(self._weight), self._by_open)

    def _measure(self) -> None:
        band = self.band
        closed = band.rested(self._law, self._levels, self._quiet, self._length)
        self._levels, self._length, self._rings = closed.better, closed.length, closed.lines_open > 0
        left = left_open(band.runs, band.noise), left_open(closed, self._noise)
        S, by_closed, by_open, response = _sensitivity(band.runs, closed, *left)
        weight = 1 / np.maximum(by_closed, ROUNDING) ** 2
        total = self._weight + weight
        share = weight / total
        self._S += share * (S - self._S)
        self._by_open += share * (by_open - self._by_open)
        self._closed += share * (response - self._closed)
        self._weight = total

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
            needles = _needles(size, self._deviation, places)
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


def _sensitivity(
    opened: Runs, closed: Runs, left: FloatArray, left_closed: FloatArray
) -> tuple[ComplexArray, FloatArray, FloatArray, ComplexArray]:
    """Return S `(ny, ny, lines)`, how far either loop's noise moves its largest singular value, the closed response.

    Both loops' sweeps differ in level, so the open response is taken to what was sent with the law:
    S = Yc (Yo Do^+ Dc)^+. `left`, `left_closed`: how far their spectra may be off.
    """
    Do, Dc, Yo, Yc = (np.moveaxis(x, 2, 0) for x in (opened.sent, closed.sent, opened.heard, closed.heard))
    turn = inverted(Do) @ Dc
    inverse = inverted(Yo @ turn)
    S = Yc @ inverse
    by_closed = largest(inverse) * left_closed
    by_open = largest(S) * largest(turn @ inverse) * left
    response = Yc @ inverted(Dc)
    return np.moveaxis(S, 0, 2), by_closed, by_open, np.moveaxis(response, 0, 2).astype(np.complex128)
