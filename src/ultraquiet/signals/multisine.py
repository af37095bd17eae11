"""A sum of sines on a grid of harmonics: periodic, and exactly as wide as asked."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import formerly, register
from ultraquiet.signals._abstract import Signal, band, below_nyquist, clock, draws, level_above_zero, upper_hz


@register("signals", "multisine")
@formerly(peak_v="peak")
@dataclass(frozen=True)
class Multisine(Signal):
    """u(t) = sum_k cos(2 pi k t rate / period + phi_k), equal amplitudes, scaled to its largest peak.

    Args:
        start_hz, stop_hz: band in Hz, up to 0.4 of the rate when no edge is named; every harmonic of
            rate / period_samples inside it is excited (not zero).
        period_samples: length of one period.
        peak: the largest absolute value, in the actuator's unit; one when absent, in a list
            a tenth of the actuator's range.
        odd: excite odd harmonics only, so that even distortion shows on the even lines.
        detection_group: of every so many neighbouring harmonics one is left out, at random, so that odd distortion
            shows there; 0 leaves none out. Four is usual.
        detection_seed: which ones are left out; keep it for all realisations of one measurement.
        phases: "random" (uniform, drawn from the seed) or "schroeder" (low crest factor, the seed has no influence).

    Raises:
        InputError: a peak not above zero, an empty band, a band without harmonics or beyond half the sampling rate.

    >>> u = Multisine(start_hz=5, stop_hz=250, period_samples=1024).generate(samples=2048, rate_hz=3500.0, seed=2)
    >>> bool((u[:1024] == u[1024:]).all())
    True

    References: M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85-89, doi:10.1109/TIT.1970.1054411;
    R. Pintelon, J. Schoukens, System Identification (2012), doi:10.1002/9781118287422.
    """

    start_hz: float = 0.0
    stop_hz: float | None = None
    period_samples: int = 4096
    peak: float | None = None
    odd: bool = False
    phases: str = "random"
    detection_group: int = 0
    detection_seed: int = 0

    levels = ("peak",)

    def __post_init__(self) -> None:
        band("Multisine", self.start_hz, self.stop_hz)
        whole("Multisine", "period_samples", self.period_samples, 2)
        level_above_zero("Multisine", "peak", self.peak)
        one_of("Multisine", "phases", self.phases, ("random", "schroeder"))
        if self.detection_group:
            whole("Multisine", "detection_group", self.detection_group, 2)
        whole("Multisine", "detection_seed", self.detection_seed, 0)

    def harmonics(self, rate_hz: float) -> np.ndarray:
        """Return the numbers of the excited harmonics of rate / period_samples."""
        stop = upper_hz(self.stop_hz, rate_hz)
        band("Multisine", self.start_hz, stop)
        below_nyquist("Multisine", "stop_hz", stop, rate_hz)
        k = np.arange(1, (self.period_samples + 1) // 2)
        f = k * rate_hz / self.period_samples
        keep = (f >= self.start_hz) & (f <= stop) & (not self.odd or k % 2 == 1)
        if not keep.any():
            raise InputError(
                f"Multisine: no harmonic of {rate_hz / self.period_samples:g} Hz lies in the band {self.start_hz:g} to "
                f"{stop:g} Hz; lengthen the period."
            )
        return self._without_detection(k[keep])

    def _without_detection(self, k: np.ndarray) -> np.ndarray:
        if not self.detection_group:
            return k
        groups = k.size // self.detection_group
        drawn = draws("Multisine", self.detection_seed).integers(self.detection_group, size=groups)
        return np.delete(k, drawn + self.detection_group * np.arange(groups))

    def lines_hz(self, rate_hz: float) -> FloatArray:
        """Return the excited frequencies in Hz."""
        return self.harmonics(rate_hz) * (rate_hz / self.period_samples)

    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the periods in the actuator's unit, `(samples,)`; the last one may be cut short."""
        n, rate = clock("Multisine", samples, rate_hz)
        k = self.harmonics(rate)
        if self.phases == "random":
            phase = draws("Multisine", seed).uniform(0.0, 2.0 * np.pi, k.size)
        else:
            i = np.arange(1, k.size + 1)
            phase = -np.pi * i * (i - 1) / k.size
        lines = np.zeros(self.period_samples // 2 + 1, dtype=np.complex128)
        lines[k] = np.exp(1j * phase)
        u = np.fft.irfft(lines, self.period_samples)
        peak = self.level_of("peak")
        u = np.clip(u * (peak / np.abs(u).max()), -peak, peak)
        return np.tile(u, -(-n // self.period_samples))[:n]
