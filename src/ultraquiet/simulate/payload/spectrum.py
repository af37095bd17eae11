"""The spectra of a run under a periodic disturbance: lines of one whole period, without leakage."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError


@dataclass(frozen=True, eq=False)
class PeriodSpectrum:
    """Amplitudes of one period `(channels, lines)` at `f_hz` `(lines,)`, from 0 Hz to half the rate, both excluded.

    A channel's mean square over a band is the sum of |amplitude|^2 / 2 of its lines there (Parseval).
    """

    f_hz: FloatArray
    amplitude: ComplexArray

    @classmethod
    def of(cls, signals: FloatArray, rate_hz: float) -> "PeriodSpectrum":
        """Return the spectrum of signals `(channels, samples)` that hold a whole period."""
        n = signals.shape[1]
        lines = np.arange(1, (n + 1) // 2)
        return cls(lines * rate_hz / n, np.fft.rfft(signals, axis=1)[:, lines] * (2.0 / n))

    @property
    def line_hz(self) -> float:
        """Distance of two lines."""
        return float(self.f_hz[0])

    @property
    def density(self) -> FloatArray:
        """One-sided power spectral density of each channel, squared units per Hz."""
        return np.abs(self.amplitude) ** 2 / (2.0 * self.line_hz)

    def rms(self, low_hz: float, high_hz: float) -> FloatArray:
        """Root mean square of each channel over a band, `(channels,)`.

        Raises:
            InputError: the band holds no line.
        """
        inside = (self.f_hz >= low_hz) & (self.f_hz <= high_hz)
        if not inside.any():
            raise InputError(f"PeriodSpectrum: no line lies between {low_hz:g} and {high_hz:g} Hz.")
        return np.sqrt(self.density[:, inside].sum(axis=1) * self.line_hz)

    def cumulative_rms(self, low_hz: float = 0.0) -> FloatArray:
        """Root mean square of all channels together from `low_hz` up to and including each line, `(lines,)`."""
        power = np.where(self.f_hz >= low_hz, self.density.sum(axis=0), 0.0)
        return np.sqrt(np.cumsum(power) * self.line_hz)

    def together(self, width_hz: float) -> tuple[FloatArray, FloatArray]:
        """Return lines and the density of all channels together, means over `width_hz` each."""
        many = max(1, round(width_hz / self.line_hz))
        groups = self.f_hz.size // many
        if not groups:
            return self.f_hz, self.density.sum(axis=0)
        kept = groups * many
        return (
            self.f_hz[:kept].reshape(groups, many).mean(axis=1),
            self.density.sum(axis=0)[:kept].reshape(groups, many).mean(axis=1),
        )
