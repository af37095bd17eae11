"""Power spectral density by Welch's method."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, between, frozen, positive, signal_array
from ultraquiet._base.errors import InputError
from ultraquiet.spectra.averaging import Averaging, averaging
from ultraquiet.spectra.cross import Accumulator, CrossSpectra, refuse_dead
from ultraquiet.values import Channel, Record


@dataclass(frozen=True, eq=False)
class PowerSpectrum:
    """One-sided power spectral density `(channel, frequency)` in squared units per Hz.

    `averaging` says how it was made: each value scatters by about 1 / sqrt(averaging.independent).
    """

    f_hz: FloatArray
    values: FloatArray
    averaging: Averaging
    channels: tuple[Channel, ...]

    @property
    def averages(self) -> int:
        """Number of segments averaged."""
        return self.averaging.averages

    @property
    def estimator(self) -> str:
        """How the spectrum was made: window, averages, overlap, resolution."""
        return f"Welch, {self.averaging.text}"

    @property
    def asd(self) -> FloatArray:
        """Amplitude spectral density, units per square root of Hz, `(channel, frequency)`."""
        return np.sqrt(self.values)

    @property
    def cumulative_rms(self) -> FloatArray:
        """Root mean square of everything up to and including each line, `(channel, frequency)`."""
        return np.sqrt(np.cumsum(self.values, axis=1) * self.averaging.line_hz)

    def rms(self, start_hz: float = 0.0, stop_hz: float = float("inf")) -> FloatArray:
        """Return the root mean square of each channel inside a band, `(channel,)`."""
        if not start_hz < stop_hz:
            raise InputError(f"PowerSpectrum.rms: the band {start_hz:g} to {stop_hz:g} Hz is empty.")
        inside = (self.f_hz >= start_hz) & (self.f_hz <= stop_hz)
        return np.sqrt(self.values[:, inside].sum(axis=1) * self.averaging.line_hz)

    def interval(self, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Return the confidence interval of every value, two arrays `(channel, frequency)`.

        nu S / chi2(1 - p/2) < true S < nu S / chi2(p/2), with nu = 2 x independent segments, and half of that at
        0 Hz and half the rate, where the transform is real.

        >>> low, high = psd(np.random.default_rng(0).standard_normal(4096), rate_hz=1000.0).interval()
        >>> bool((low < high).all())
        True

        Reference: Bendat and Piersol 2010, section 8.5, doi:10.1002/9781118032428.
        """
        from scipy.stats import chi2

        p = 1.0 - between("PowerSpectrum.interval", "level", level, 0.01, 0.9999)
        nu = np.full(self.f_hz.size, 2.0 * self.averaging.independent)
        nu[(self.f_hz == 0) | (self.f_hz >= self.averaging.rate_hz / 2 * (1 - 1e-12))] /= 2.0
        return self.values * (nu / chi2.ppf(1 - p / 2, nu)), self.values * (nu / chi2.ppf(p / 2, nu))


def psd(
    signals: Record | CrossSpectra | ArrayLike,
    rate_hz: float | None = None,
    segment_samples: int | None = None,
    overlap: float = 0.5,
    window: str = "hann",
    detrend: str = "constant",
) -> PowerSpectrum:
    """Return the power spectral density of a record's outputs, or of signals `(channel, sample)`.

    S(f) = mean over segments of 2 |FFT(w x)|^2 / (rate sum w^2)

    Args:
        signals: a record; or an array together with `rate_hz`; or cross spectra, whose averaging then stands.
        rate_hz: samples per second; taken from a record.
        segment_samples: length of a segment; by default an eighth of the signal, which gives about 15 averages.
        overlap: shared part of neighbouring segments, 0 to 0.95.
        window: any window name of scipy.signal.
        detrend: what is removed from every segment: its mean ("constant"), a line ("linear") or nothing ("none").

    Raises:
        InputError: no rate for an array, NaN, a channel that never moves, segments longer than the signal.

    >>> noise = np.random.default_rng(0).standard_normal(4096)
    >>> bool(abs(psd(noise, rate_hz=1000.0).rms()[0] - 1.0) < 0.1)
    True

    Reference: P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73, doi:10.1109/TAU.1967.1161901.
    """
    if isinstance(signals, CrossSpectra):
        outputs = slice(len(signals.actuators), None)
        return PowerSpectrum(frozen(signals.f_hz), frozen(signals.power[outputs]), signals.averaging, signals.sensors)
    if isinstance(signals, Record):
        x, rate, names = signals.outputs, signals.rate_hz, signals.sensors
    elif rate_hz is None:
        raise InputError("psd: an array needs 'rate_hz', in samples per second.")
    else:
        x, rate = signal_array("psd", "signals", signals), positive("psd", "rate_hz", rate_hz, "Hz")
        names = tuple(Channel(f"channel {k + 1}", "unit") for k in range(len(x)))
    plan = averaging("psd", x.shape[1], rate, segment_samples, overlap, window, detrend)
    total = Accumulator(plan, auto=True)
    total.add(refuse_dead("psd", x, names))
    return PowerSpectrum(frozen(plan.f_hz), total.mean().real, total.plan, names)
