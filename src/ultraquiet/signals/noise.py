"""Gaussian noise confined to a band."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import formerly, register
from ultraquiet.signals._abstract import Signal, band, below_nyquist, clock, draws, level_above_zero, upper_hz


@register("signals", "noise")
@formerly(peak_v="peak")
@dataclass(frozen=True)
class BandLimitedNoise(Signal):
    """White Gaussian noise whose spectrum is zero outside [start_hz, stop_hz], scaled to its largest peak.

    u = irfft(g 1_band), g complex Gaussian, then scaled so that max |u| = peak. There is no mean.

    Args:
        stop_hz, start_hz: edges of the band in Hz; up to 0.4 of the rate when none is named.
        peak: the largest absolute value, in the actuator's unit; one when absent, in a list a tenth
            of the actuator's range. The rms is about a quarter of it.

    Raises:
        InputError: a peak not above zero, an empty band, a band beyond half the sampling rate or too narrow for the
            number of samples.

    >>> u = BandLimitedNoise(stop_hz=250, peak=25).generate(4096, 3500.0, seed=1)
    >>> float(abs(u).max())
    25.0

    Reference: section 3.3 of the paper (250 Hz).
    """

    stop_hz: float | None = None
    peak: float | None = None
    start_hz: float = 0.0

    levels = ("peak",)

    def __post_init__(self) -> None:
        band("BandLimitedNoise", self.start_hz, self.stop_hz)
        level_above_zero("BandLimitedNoise", "peak", self.peak)

    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return noise in the actuator's unit, `(samples,)`, the same for the same seed."""
        n, rate = clock("BandLimitedNoise", samples, rate_hz)
        stop = upper_hz(self.stop_hz, rate)
        band("BandLimitedNoise", self.start_hz, stop)
        below_nyquist("BandLimitedNoise", "stop_hz", stop, rate)
        f = np.fft.rfftfreq(n, 1.0 / rate)
        inside = (f >= self.start_hz) & (f <= stop) & (f > 0)
        if not inside.any():
            raise InputError(
                f"BandLimitedNoise: {n} samples at {rate:g} Hz resolve {rate / n:g} Hz, too coarse for the band "
                f"{self.start_hz:g} to {stop:g} Hz; take more samples."
            )
        draw = draws("BandLimitedNoise", seed).standard_normal((2, f.size))
        u = np.fft.irfft(np.where(inside, draw[0] + 1j * draw[1], 0.0), n)
        peak = self.level_of("peak")
        # Clipped because the division may leave the peak one rounding above it.
        return np.clip(u * (peak / np.abs(u).max()), -peak, peak)
