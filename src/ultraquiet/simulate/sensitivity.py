"""The sensitivity matrix as the bench shows it, from which every direction and band can be read."""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array
from ultraquiet._base.errors import InputError, UnheardError
from ultraquiet._base.progress import task
from ultraquiet._base.shown.line import counted
from ultraquiet.bench import Bench
from ultraquiet.linalg.response import principal_gains
from ultraquiet.simulate.kick import ranges
from ultraquiet.simulate.open_loop import LOUD, LOWER, OpenBand, OpenLoop, Runs, inverted, largest, left_open
from ultraquiet.values import FrequencyResponse, StateSpace
from ultraquiet.values.controller import Controller

# A line is resolved when noise moves its largest singular value by less than this share: 0.4 dB. One that is not is
# counted with so many deviations of the noise on top.
RESOLVED, DEVIATIONS = 0.05, 2.0
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
UNHEARD = 1.25  # of the range of the sweeps that has no line
EDGE = 1.05  # where a sweep fades in and out
# A law's first, short sweeps are so much lower than those of the open loop.
BEGIN_CLOSED = 0.3
# A loop that amplifies by more than this at its lowest lines, and there nearly as much as anywhere else, may amplify
# most below: it is measured further down, as long as it does, the open loop is heard and a run is long enough. So many
# lines count that noise in one of them cannot hide a peak: those up to so much above the lowest.
AMPLIFIES, NEARLY, LOWEST = 1.06, 0.9, 1.1


@dataclass(frozen=True)
class MeasuredSensitivity:
    """S = Y closed Y open^-1 at each line, `(ny, ny, nf)`, and the responses from disturbance to sensors behind it.

    The largest singular value of S is the amplification in the worst direction, whatever direction the disturbance
    takes; S is measured with as many runs as there are directions. With fewer actuators than sensors S is that of the
    directions which the actuators reach, zero in the others: there nothing can be done and nothing is claimed.

    Attributes:
        S: at every line that was asked for.
        opened, closed: from disturbance to sensors, `(ny, nu, nf)`.
        deviation: of the largest singular value, from noise, `(nf,)`.
        reach: sentence on directions the actuators do not reach; empty where they reach all.
        below: sentence on what S may do under the lowest line; empty where it falls there, or lines were asked for.
        unheard: sentence on the range of the sweeps in which there are no lines, as the open loop is not heard there;
            empty where there are, or lines were asked for.
        rings: whether a run ended before it had come to rest; what that leaves open counts as noise does.
    """

    S: FrequencyResponse
    opened: ComplexArray
    closed: ComplexArray
    deviation: FloatArray
    reach: str = ""
    below: str = ""
    unheard: str = ""
    rings: bool = False

    @property
    def f_hz(self) -> FloatArray:
        """Lines in Hz: all that were asked for."""
        return self.S.f_hz

    @property
    def hidden(self) -> np.ndarray:
        """Whether noise hides the worst direction of a line, `(nf,)`: what is counted there is a bound."""
        return self.deviation > RESOLVED * self._size

    @property
    def lines_missing(self) -> int:
        """Lines asked for that were not measured: none, ever; those that noise hides are counted at its bound."""
        return int(np.count_nonzero(~np.isfinite(self._size)))

    def worst_direction_db(self) -> FloatArray:
        """Reduction in dB of the worst direction at each line, `(nf,)`; negative where it is amplified."""
        return -20 * np.log10(self._size)

    @property
    def bound_db(self) -> FloatArray:
        """Reduction in dB that is certain at each line, `(nf,)`: less than was read by what noise leaves open."""
        return -20 * np.log10(self._size + DEVIATIONS * self.deviation)

    def counted_db(self) -> FloatArray:
        """Return what counts of each line, `(nf,)`: the worst direction where it was resolved, elsewhere the bound."""
        return np.where(self.hidden, self.bound_db, self.worst_direction_db())

    def worst_in_band_db(self, low_hz: float, high_hz: float) -> float:
        """Smallest worst-direction reduction over a band, in dB, hidden lines counted at their bound."""
        return float(self.counted_db()[self._band(low_hz, high_hz)].min())

    def peak_amplification_db(self) -> float:
        """Largest amplification of any direction at any line, in dB, hidden lines counted at their bound."""
        return float(-self.counted_db().min())

    def mean_log_db(self) -> float:
        """Return the mean over frequency of 20 log10 |det S| / ny: what quiet bands are paid with elsewhere.

        For a stable loop with a stable controller and at least one sample of delay the mean over 0 to Nyquist is zero:
        every decibel gained over a hertz is lost over another (Bode's integral in discrete time; Sung and Hara 1988,
        doi:10.1080/00207178808906305). With fewer actuators than sensors it is that of the directions they reach.
        """
        sizes = principal_gains(self.S.values)
        count = min(self.opened.shape[:2])
        level = 20 * np.log10(np.maximum(sizes[:count], np.finfo(float).tiny)).mean(axis=0)
        return float(np.trapezoid(level, self.f_hz) / (self.f_hz[-1] - self.f_hz[0]))

    def broadband_db(self, low_hz: float, high_hz: float) -> float:
        """Reduction of the RMS of the worst sensor under equal, independent disturbances over a band, in dB."""
        band = self._band(low_hz, high_hz)
        width = np.gradient(self.f_hz)[band]
        power = [np.sum(np.abs(y[:, :, band]) ** 2 * width, axis=(1, 2)) for y in (self.opened, self.closed)]
        return float(10 * np.log10(np.min(power[0] / power[1])))

    def unresolved(self, low_hz: float = 0.0, high_hz: float = np.inf) -> str:
        """Return a sentence on the lines of a band that noise hides, in numbers, and `below` where the band begins."""
        band = self._band(low_hz, high_hz)
        hidden, f = band & self.hidden, self.f_hz
        said = f"All {band.sum()} lines were resolved." if band.sum() > 1 else "The line was resolved."
        if hidden.any():
            what = "Noise, or what still rings when a run ends," if self.rings else "Noise"
            said = (
                f"{what} hides {hidden.sum()} of {counted(int(band.sum()), 'line')}, {f[hidden].min():.4g} to "
                f"{f[hidden].max():.4g} Hz; they are counted at the bound it leaves."
            )
        outside = self.unheard if low_hz < f[0] or high_hz > f[-1] else ""
        return " ".join(filter(None, (said, self.below if low_hz < f[0] else "", outside)))

    @cached_property
    def _size(self) -> FloatArray:
        return _largest(self.S.values)

    def _band(self, low_hz: float, high_hz: float) -> np.ndarray:
        band = (self.f_hz >= low_hz) & (self.f_hz <= high_hz)
        if not band.any():
            raise UnheardError(f"MeasuredSensitivity: no line lies between {low_hz:g} and {high_hz:g} Hz.")
        return band


def measure_sensitivity(
    bench: Bench,
    controller: StateSpace | Controller,
    f_hz: ArrayLike | None = None,
    *,
    opened: OpenLoop | None = None,
) -> MeasuredSensitivity:
    """Measure S on the bench with swept disturbances in its own directions, open and closed loop.

    Each run sweeps from the lowest to the highest frequency and then waits until the plant has come to rest, so that
    Y(f) is the Fourier transform of the whole response and free of leakage at every line of a run: for as long as more
    silence helps, on a bench in real time four times. Where it ends displaced or moving, as an integrator or a free
    body does, the rest of the transform is known and added; what rings on is counted like noise. A run drives one
    right singular vector of the open loop, as loud as ranges allow at each frequency: weak directions stand as far
    above the noise as strong ones. Lines are where S is: closer together between lines that differ by more than 0.5 dB,
    down to one over the length of a run. A pass is repeated, louder where noise hid a line, four times at most; what
    noise leaves open in the open loop is the same in all passes and is not averaged away.

    Args:
        bench: any bench; with fewer sensors than actuators S is full, with more it is that of the reached directions.
        controller: acts as u = K y.
        f_hz: lines in Hz that are asked for, moved to the nearest of a run; chosen from S itself when absent, over the
            whole range of the sweep, and further down where S still rises there and a run is long enough.
        opened: the open loop of the same bench, measured before; its runs are made once for all laws.

    Returns:
        `MeasuredSensitivity`, every line asked for in it.

    Raises:
        InputError: lines beyond the Nyquist frequency, an open loop of another bench.
    """
    opened = OpenLoop(bench) if opened is None else opened
    if opened.bench is not bench and opened.bench != bench:
        raise InputError("measure_sensitivity: 'opened' is the open loop of another bench.")
    pairs = [_Pair(band, controller) for band in opened.bands]
    asked = [None] * len(pairs) if f_hz is None else _asked(opened, f_hz)
    with task("sensitivity on the bench", len(pairs)) as progress:
        parts = []
        for pair, lines in zip(pairs, asked, strict=True):
            parts.append(pair.at(lines))
            progress.advance(note=f"to {pair.band.sweep.high_hz:.3g} Hz")
        lower = opened.downwards()
        while f_hz is None and parts[0].f_hz.size and _may_peak_below(*_all_lines(parts)):
            if (below := next(lower, None)) is None:
                break
            parts.insert(0, _Pair(below, controller).at(None, most_hidden=0.0))
    found = _joined(opened, parts)
    if f_hz is not None:
        return found
    return replace(found, below=_rises_below(found), unheard=_unheard(found, opened))


def _asked(opened: OpenLoop, f_hz: ArrayLike) -> list[np.ndarray]:
    """Return the places of the lines asked for among those of each band."""
    f = np.sort(frequency_array("measure_sensitivity", f_hz))
    low, high = opened.bands[0].sweep.lines_hz[0], opened.bands[-1].sweep.lines_hz[-1]
    if f[0] < low or f[-1] > high:
        raise InputError(
            f"measure_sensitivity: 'f_hz' must lie between {low:.4g} and {high:.4g} Hz, got {f[0]:g} to {f[-1]:g}; "
            f"a longer OpenLoop(bench, seconds=...) begins lower."
        )
    places, below = [], -np.inf
    for band in opened.bands:
        lines, above = band.sweep.lines_hz, band.sweep.high_hz if band is not opened.bands[-1] else np.inf
        mine = f[(f > below) & (f <= above)]
        places.append(np.rint((mine - lines[0]) / (lines[1] - lines[0])).astype(int).clip(0, lines.size - 1))
        below = above
    return places


@dataclass(frozen=True, eq=False)
class _Part:
    """What one band gave: lines in Hz, S, its deviation, both responses."""

    f_hz: FloatArray
    S: ComplexArray
    deviation: FloatArray
    opened: ComplexArray
    closed: ComplexArray
    rings: bool


class _Pair:
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

    def at(self, asked: np.ndarray | None, most_hidden: float = HIDDEN) -> _Part:
        """Measure, again and louder where noise hides lines, and return these lines or those that S asks for."""
        places = np.zeros(0, dtype=int)
        for _ in range(PASSES):
            self._measure()
            places = self._dense() if asked is None else asked
            size, deviation = _largest(self._S[:, :, places]), self._deviation[places]
            # no pass resolves a line that the open loop's noise hides by itself
            hidden = (deviation > RESOLVED * size) & (self._by_open[places] <= RESOLVED * size)
            few = np.count_nonzero(hidden) <= (0 if asked is not None else most_hidden * places.size)
            if few and not _decides(hidden, size, deviation):
                break
        return _Part(
            self.band.sweep.lines_hz[places],
            self._S[:, :, places],
            self._deviation[places],
            self.band.response[:, :, places],
            self._closed[:, :, places],
            self._rings or self.band.runs.lines_open > 0,
        )

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
        size = _largest(self._S)
        level = 20 * np.log10(size)
        while True:
            steep = (np.abs(np.diff(level[places])) > STEP_DB) & (np.diff(places) > 1)
            between = (places[:-1] + places[1:])[steep] // 2
            needles = _needles(size, self._deviation, places)
            if not between.size and not needles.size:
                return places
            places = np.unique(np.concatenate([places, between, needles]))


def _decides(hidden: np.ndarray, size: FloatArray, deviation: FloatArray) -> bool:
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


def _rises_below(found: MeasuredSensitivity) -> str:
    if found.hidden[0] or not _may_peak_below(found.f_hz, found.S.values):
        return ""
    lowest_db = 20 * np.log10(_near_lowest(found.f_hz, _largest(found.S.values)))
    return f"The loop amplifies by {lowest_db:.1f} dB near the lowest, {found.f_hz[0]:.3g} Hz, and perhaps more below."


def _unheard(found: MeasuredSensitivity, opened: OpenLoop) -> str:
    low, high = opened.bands[0].sweep.low_hz, opened.bands[-1].sweep.high_hz
    first, last = found.f_hz[0], found.f_hz[-1]
    parts = [f"below {first:.3g} Hz"] if first > UNHEARD * low else []
    parts += [f"above {last:.3g} Hz"] if last < high / UNHEARD else []
    return f"The open loop is not heard {' and '.join(parts)}: nothing is known there." if parts else ""


def _all_lines(parts: list[_Part]) -> tuple[FloatArray, ComplexArray]:
    """Return the lines of all parts and S there."""
    return np.concatenate([part.f_hz for part in parts]), np.concatenate([part.S for part in parts], axis=2)


def _may_peak_below(f_hz: FloatArray, S: ComplexArray) -> bool:
    """Return whether the loop amplifies at its lowest lines nearly as much as anywhere above; `(ny, ny, lines)`."""
    size = _largest(S)
    return _near_lowest(f_hz, size) > max(AMPLIFIES, NEARLY * float(size.max()))


def _near_lowest(f_hz: FloatArray, size: FloatArray) -> float:
    return float(size[f_hz <= LOWEST * f_hz[0]].max())


def _largest(S: ComplexArray) -> FloatArray:
    return largest(np.moveaxis(S, 2, 0))


def _joined(opened: OpenLoop, parts: list[_Part]) -> MeasuredSensitivity:
    f, S = _all_lines(parts)
    bench = opened.bench
    if not f.size:
        advice = "raise the sensors' gain or lower their noise"
        if not np.isfinite([*ranges(bench.actuators), *ranges(bench.sensors)]).all():
            advice = f"give each channel its low and high: without them readings are kept to {LOUD:g} times their noise"
        raise UnheardError(f"measure_sensitivity: noise hides every line; {advice}.")
    ny, nu = len(bench.sensors), len(bench.actuators)
    reached = counted(nu, "actuator reaches", "actuators reach")
    seconds = ", ".join(f"{band.sweep.samples / bench.rate_hz:g}" for band in opened.bands)
    text = f"disturbance to sensors, sweeps of {seconds} s"
    opened_y, closed_y = (
        np.concatenate([getattr(part, name) for part in parts], axis=2) for name in ("opened", "closed")
    )
    deviation = np.concatenate([part.deviation for part in parts])
    return MeasuredSensitivity(
        FrequencyResponse(f, S, estimator=text),
        opened_y,
        closed_y,
        deviation,
        f"{reached} {nu} of {ny} directions of the sensors; in the others no law does anything." if nu < ny else "",
        rings=any(part.rings for part in parts),
    )


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
