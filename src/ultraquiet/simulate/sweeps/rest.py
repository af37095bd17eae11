"""How a run comes to rest: offsets that stand before it, and what still moves when it ends."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, frozen
from ultraquiet.simulate.sweeps.clock import SweepClock

LAST = 8  # the last part of a run, one of so many, shows what still moves
# A reading at rest this many deviations of its noise from zero has an offset; within so many it has come to rest.
OFFSET, SETTLED = 3.0, 5.0
# What moves at the end counts when it has so many times the power of the noise there, the mean of all parts of a quiet
# run and of so many lines beside, which chance never has, and so much of a run's size.
RINGS, BESIDE, ROUNDED = 24.0, 4, 1e-12
KAISER = 14.0
SMOOTH = 4.0  # periods of the lowest line
NOISE_LINES = 24  # the noise of a line is the mean of so many neighbours to either side
LOUDEST = 64  # tones that ring on, at most
LOBE, UNSURE = 2, 0.1  # bins to either side in which a window shows one tone, and how far from where it seems it may be


@dataclass(frozen=True, eq=False)
class Quiet:
    """What a run shows in which nothing is sent: every run begins like it, and ends with its noise.

    Args:
        sweep: how runs are made.
        readings: of that run, `(ny, samples)`.
    """

    sweep: SweepClock
    readings: FloatArray

    @property
    def part(self) -> int:
        """Samples of the last part of a run."""
        return self.readings.shape[1] // LAST

    @cached_property
    def offset(self) -> FloatArray | None:
        """Where the readings rest, `(ny,)`; None where no sensor has an offset."""
        return rest_of(self.readings)

    @cached_property
    def alone(self) -> FloatArray:
        """Return the readings without an offset and what a loop makes of it at first."""
        return self._moved(self.readings)

    def spectra(self, y: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Return the transforms of readings `(ny, samples)` until they rest, and what ringing leaves open of each.

        A run ends while it still moves: with a displacement c or a drift v, as a free body does, the rest of the
        transform is known,

            sum_{t >= n} (c + v (t - n)) q^t = q^n (c / (1 - q) + v q / (1 - q)^2),   q = exp(-j w),

        and added. Of a tone of amplitude a that rings on it is at most a / 2 |1 - exp(j (w0 - w))|^-1 and its mirror,
        and no more than the run was long: that is left open.

        Returns:
            Both `(ny, lines)`.
        """
        moved = self._moved(y)
        level, drift, rest = self._end(moved)
        n = y.shape[1]
        q = np.exp(-2j * np.pi * self.sweep.lines_hz / self.sweep.rate_hz)
        missing = q**n * (level[:, None] / (1 - q) + drift[:, None] * q / (1 - q) ** 2)
        return self.sweep.transform(moved) + missing, self._ringing(rest, n, np.abs(moved).max(axis=1))

    def rounding(self, y: FloatArray) -> FloatArray:
        """Return the power in a spectrum of what converters round in `(ny, samples)`, beyond the noise, `(ny,)`.

        Noise that is as large as a converter's step has that error in it; a sensor that hears nothing shows none.
        """
        extra = converter_steps(y) ** 2 / 12 - self.alone[:, -self.part :].var(axis=1)
        return y.shape[1] * np.maximum(extra, 0.0)

    def _moved(self, y: FloatArray) -> FloatArray:
        """Return readings without an offset and without what a loop makes of it when it is closed."""
        offset = self.offset
        if offset is None:
            return y
        known = np.repeat(offset[:, None], y.shape[1], axis=1)
        start, later = self._startup, self._later
        known[:, : later.shape[1]] = later
        known[:, : start.shape[1]] = start
        return np.asarray(y - known)

    # What a quiet run says is asked for with every other run.
    @cached_property
    def _startup(self) -> FloatArray:
        return startup(self.readings)

    @cached_property
    def _later(self) -> FloatArray:
        """What moves on, slowly, where the beginning has not come to rest by half a run; empty where it has.

        Smoothed over so many periods of the lowest line that the noise of no line is taken away with it.
        """
        from scipy.signal import fftconvolve

        y = self.readings
        if self._startup.shape[1] < y.shape[1] // 2:
            return y[:, :0]
        window = np.hanning(2 * round(SMOOTH * self.sweep.rate_hz / self.sweep.low_hz / 2) + 1)
        half = window.size // 2
        ends = 2 * y[:, :1] - y[:, half:0:-1], 2 * y[:, -1:] - y[:, -2 : -half - 2 : -1]  # odd about the last reading
        padded = np.hstack([ends[0], y, ends[1]])
        return np.stack([fftconvolve(row, window / window.sum(), "valid") for row in padded])

    @cached_property
    def _spread(self) -> FloatArray:
        """Root mean square of the noise of level and drift of a last part, `(2, ny)`."""
        own = np.stack([_line(part) for part in np.array_split(self.readings, LAST, axis=1)])  # (parts, 2, ny)
        return np.asarray(np.sqrt(np.mean((own - own.mean(axis=0)) ** 2, axis=0)))

    @cached_property
    def _floor(self) -> FloatArray:
        """Mean power of the noise of a last part, a Hann window before it, `(ny, lines)`."""
        window = np.hanning(self.part)
        quiet = self.alone[:, : LAST * self.part].reshape(len(self.alone), LAST, self.part)
        quiet = (quiet - quiet.mean(axis=2, keepdims=True)) * window
        noise = np.abs(2 / window.sum() * np.fft.rfft(quiet, axis=2)) ** 2
        return smoothed(noise.mean(axis=1), BESIDE)

    def _end(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return level and drift after the end, those that noise does not explain, and the last part without them."""
        last = y[:, -self.part :]
        mean, slope = _line(last)
        spread = self._spread + ROUNDED * np.abs(y).max(axis=1)
        slope = np.where(np.abs(slope) > SETTLED * np.maximum(spread[1], spread[0] / self.part), slope, 0.0)
        mean = np.where((np.abs(mean) > SETTLED * spread[0]) | (slope != 0), mean, 0.0)
        t = np.arange(self.part) - (self.part - 1) / 2
        level = mean + slope * (self.part + 1) / 2  # at the first sample after the end
        return level, slope, last - mean[:, None] - slope[:, None] * t

    def _ringing(self, rest: FloatArray, n: int, size: FloatArray) -> FloatArray:
        """Return what tones that ring in the last part leave open, `(ny, lines)`."""
        lines = self.sweep.lines_hz
        window = np.hanning(self.part)
        scale = 2 / window.sum()
        bin_hz = self.sweep.rate_hz / self.part
        power = np.abs(scale * np.fft.rfft(rest * window, axis=1)) ** 2
        left = np.zeros((len(rest), lines.size))
        for row, (found, floor) in enumerate(zip(power, self._floor, strict=True)):
            ringing = np.flatnonzero(found > np.maximum(RINGS * floor, (ROUNDED * size[row]) ** 2))
            for k in ringing[np.argsort(-found[ringing], kind="stable")][:LOUDEST]:
                tone_hz = bin_hz * tone_at(found, k)
                for mirrored in (tone_hz, -tone_hz):
                    away_hz = np.maximum(np.abs(mirrored - lines) - UNSURE * bin_hz, 0.0)
                    apart = np.abs(1 - np.exp(2j * np.pi * away_hz / self.sweep.rate_hz))
                    left[row] += found[k] / 4 / np.maximum(apart, 1 / n) ** 2
        return np.sqrt(left)


def tone_at(power: FloatArray, k: int) -> float:
    """Return where the tone stands that a bin of a Hann window shows, in bins, from the loudest bin within its lobe.

    Its amplitude there and in the louder of both neighbours, in the ratio r, tell that it is (2 r - 1) / (r + 1) of a
    bin from the first towards the second (Grandke 1983, doi:10.1109/TIM.1983.4315077).
    """
    first = max(k - LOBE, 0)
    top = first + int(np.argmax(power[first : k + LOBE + 1]))
    beside = [j for j in (top - 1, top + 1) if 0 <= j < power.size]
    if not beside or power[top] == 0:
        return float(top)
    louder = max(beside, key=lambda j: power[j])
    ratio = np.sqrt(power[louder] / power[top])
    return float(top + (louder - top) * np.clip((2 * ratio - 1) / (ratio + 1), 0.0, 0.5))


def _line(part: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and slope per sample of readings, each `(ny,)`; a window keeps what rings out of both."""
    window = _kaiser(part.shape[1])
    t = np.arange(part.shape[1]) - (part.shape[1] - 1) / 2
    return part @ window / window.sum(), part @ (window * t) / (window @ t**2)


@lru_cache(maxsize=8)
def _kaiser(samples: int) -> FloatArray:
    return frozen(np.kaiser(samples, KAISER))


def converter_steps(y: FloatArray) -> FloatArray:
    """Return the smallest step of each sensor's readings, `(ny,)`; next to nothing where no converter rounds them."""
    gaps = (np.diff(np.unique(row)) for row in y)
    least = ROUNDED * np.abs(y).max(axis=1)
    steps = [each[each > tiny] for each, tiny in zip(gaps, least, strict=True)]
    return np.array([each.min() if each.size else 0.0 for each in steps])


def smoothed(power: FloatArray, reach: int = NOISE_LINES) -> FloatArray:
    """Return the mean power of each line and so many neighbours to either side, `(rows, lines)`."""
    reach = min(reach, power.shape[1] - 1)
    wide = np.ones(2 * reach + 1) / (2 * reach + 1)
    padded = np.pad(power, ((0, 0), (reach, reach)), mode="reflect")
    return np.stack([np.convolve(row, wide, "valid") for row in padded])


def startup(quiet: FloatArray) -> FloatArray:
    """Return the beginning of a run in which nothing is sent, until it has come to rest; empty without an offset.

    With a law a run begins with what the loop makes of an offset as it is closed: it would leak into every line.
    """
    rest = rest_of(quiet)
    if rest is None:
        return quiet[:, :0]
    noise = quiet[:, -(quiet.shape[1] // LAST) :].std(axis=1, keepdims=True)
    moving = np.flatnonzero((np.abs(quiet - rest[:, None]) > SETTLED * noise).any(axis=0)[: quiet.shape[1] // 2])
    return quiet[:, : moving[-1] + 1 if moving.size else 0]


def rest_of(y: FloatArray) -> FloatArray | None:
    """Return where readings rest at their end, `(ny,)`; None where none is beside zero beyond its noise."""
    last = y[:, -(y.shape[1] // LAST) :]
    rest = last.mean(axis=1)
    return rest if (np.abs(rest) > OFFSET * last.std(axis=1)).any() else None
