"""Power spectral density by Welch's method."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, between, frozen, positive, signal_array, whole
from ultraquiet._base.errors import InputError
from ultraquiet.values import Record


@dataclass(frozen=True, eq=False)
class PowerSpectrum:
    """One-sided power spectral density `(channel, frequency)` in squared units per Hz.

    `averages` is the number of segments behind it: each value scatters by about 1 / sqrt(averages).
    """

    f_hz: FloatArray
    values: FloatArray
    averages: int
    estimator: str

    @property
    def asd(self) -> FloatArray:
        """Amplitude spectral density, units per square root of Hz, `(channel, frequency)`."""
        return np.sqrt(self.values)

    def rms(self, start_hz: float = 0.0, stop_hz: float = float("inf")) -> FloatArray:
        """Return the root mean square of each channel inside a band, `(channel,)`."""
        if not start_hz < stop_hz:
            raise InputError(f"PowerSpectrum.rms: the band {start_hz:g} to {stop_hz:g} Hz is empty.")
        inside = (self.f_hz >= start_hz) & (self.f_hz <= stop_hz)
        return np.sqrt(self.values[:, inside].sum(axis=1) * (self.f_hz[1] - self.f_hz[0]))


def psd(
    signals: Record | ArrayLike,
    rate_hz: float | None = None,
    segment_samples: int | None = None,
    overlap: float = 0.5,
    window: str = "hann",
) -> PowerSpectrum:
    """Return the power spectral density of a record's outputs, or of signals `(channel, sample)`.

    S(f) = mean over segments of 2 |FFT(w x)|^2 / (rate sum w^2), means of the segments removed.

    Args:
        signals: a record, or an array together with `rate_hz`.
        rate_hz: samples per second; taken from a record.
        segment_samples: length of a segment; by default an eighth of the signal, which gives about 15 averages.
        overlap: shared part of neighbouring segments, 0 to 0.95.
        window: any window name of scipy.signal.

    Raises:
        InputError: no rate for an array, NaN, segments longer than the signal.

    >>> noise = np.random.default_rng(0).standard_normal(4096)
    >>> bool(abs(psd(noise, rate_hz=1000.0).rms()[0] - 1.0) < 0.1)
    True

    Reference: P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73, doi:10.1109/TAU.1967.1161901.
    """
    from scipy.signal import welch

    if isinstance(signals, Record):
        x, rate = signals.outputs, signals.rate_hz
    elif rate_hz is None:
        raise InputError("psd: an array needs 'rate_hz', in samples per second.")
    else:
        x, rate = signal_array("psd", "signals", signals), positive("psd", "rate_hz", rate_hz, "Hz")
    length, shared, averages = segments("psd", x.shape[1], segment_samples, overlap)
    f, values = welch(x, rate, window=window, nperseg=length, noverlap=shared, detrend="constant")
    text = f"Welch, {averages} segments of {length} samples, window {window}, overlap {overlap:g}"
    return PowerSpectrum(frozen(f), frozen(values), averages, text)


def segments(who: str, samples: int, segment_samples: int | None, overlap: float) -> tuple[int, int, int]:
    """Return length, shared samples and number of segments."""
    length = max(8, samples // 8) if segment_samples is None else whole(who, "segment_samples", segment_samples, 8)
    if length > samples:
        raise InputError(f"{who}: a segment of {length} samples does not fit into {samples} samples; shorten it.")
    shared = int(between(who, "overlap", overlap, 0.0, 0.95) * length)
    return length, shared, 1 + (samples - length) // (length - shared)
