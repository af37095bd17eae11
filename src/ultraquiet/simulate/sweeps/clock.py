"""A swept tone in a direction that turns with frequency, followed by silence in which the plant comes to rest."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.sweeps.directions import Directions

# Share of a run that sweeps, and the part of it in which either end fades, beyond the frequencies asked for.
SWEPT, FADED = 0.625, 0.02


@dataclass(frozen=True, eq=False)
class SweepClock:
    """The clock of a sweep from `low_hz` to `high_hz`: `samples` of a run at `rate_hz`.

    Every octave takes as long, or, unless `even`, half as long as the one below. The response dies within the run, so
    that its transform may be taken at `finer` times as many lines.
    """

    samples: int
    rate_hz: float
    low_hz: float
    high_hz: float
    finer: int = 1
    even: bool = True

    @property
    def swept(self) -> int:
        """Samples of the sweep itself."""
        return int(SWEPT * self.samples)

    @property
    def lines(self) -> np.ndarray:
        """Numbers of the lines of a run's spectrum within the sweep."""
        per_hz = self.finer * self.samples / self.rate_hz
        return np.arange(int(np.ceil(self.low_hz * per_hz)), int(self.high_hz * per_hz) + 1)

    @property
    def lines_hz(self) -> FloatArray:
        """Their frequencies."""
        return self.lines * self.rate_hz / (self.finer * self.samples)

    def transform(self, signals: FloatArray) -> ComplexArray:
        """Return the Fourier transforms of signals `(channels, samples)`, however long, at the lines."""
        period = self.finer * self.samples
        count = -(-signals.shape[1] // period)
        # at these lines samples a period apart count alike
        folded = np.pad(signals, ((0, 0), (0, count * period - signals.shape[1]))).reshape(len(signals), count, period)
        return np.asarray(np.fft.rfft(folded.sum(axis=1), axis=1)[:, self.lines], dtype=np.complex128)

    @cached_property
    def f_hz(self) -> FloatArray:
        """Frequency of each swept sample."""
        share = np.clip((np.arange(self.swept) / self.swept - FADED) / (1 - 2 * FADED), -FADED, 1 + FADED)
        if self.even:
            return np.minimum(self.low_hz * (self.high_hz / self.low_hz) ** share, self.rate_hz / 2)
        # dt / d(ln f) = c / f: sensors and structures hear least where they are slowest, so 1 / f falls evenly.
        inverse = 1 / self.low_hz + share * (1 / self.high_hz - 1 / self.low_hz)
        return 1 / np.maximum(inverse, 2 / self.rate_hz)

    @cached_property
    def carrier(self) -> ComplexArray:
        """exp(j phase) of each swept sample, faded at both ends."""
        faded = max(2, int(FADED * self.swept))
        gain = np.minimum(1.0, np.minimum(np.arange(self.swept), np.arange(self.swept)[::-1]) / faded)
        return (gain * np.exp(2j * np.pi * np.cumsum(self.f_hz) / self.rate_hz)).astype(np.complex128)

    def signal(self, directions: Directions, k: int, grid_hz: FloatArray, level: FloatArray) -> FloatArray:
        """Return the disturbance `(nu, samples)` of one of some directions, at a level `(grid,)` held at `grid_hz`.

        Its spectrum is that of the sweep, times the direction at each frequency: a plant that rings for longer than the
        sweep stays near its resonance is moved in one direction all the same. What lies outside the sweep is cut off.
        """
        size = np.exp(np.interp(np.log(self.f_hz), np.log(grid_hz), np.log(level)))
        before, period = self.swept // 2, 2 * self.samples
        sweep = np.zeros(period)
        sweep[before : before + self.swept] = size * self.carrier.real
        f_hz: FloatArray = np.arange(self.samples + 1, dtype=float) * (self.rate_hz / period)
        turned = np.fft.rfft(sweep) * directions.at(k, f_hz)
        d = np.zeros((len(turned), self.samples))
        d[:, : self.swept] = np.fft.irfft(turned, period, axis=1)[:, before : before + self.swept]
        return d

    def envelope(self, signal: FloatArray, grid_hz: FloatArray) -> FloatArray:
        """Return the largest size of a signal `(samples,)` while the sweep passes each of `grid_hz`, `(grid,)`.

        What rings on from before counts where it is heard: it uses up the range there.
        """
        edges = np.sqrt(grid_hz[1:] * grid_hz[:-1])
        at = np.concatenate([[0], np.searchsorted(self.f_hz, edges)]).astype(int)
        return np.maximum.reduceat(np.abs(signal[: self.swept]), np.minimum(at, self.swept - 1))
