"""How a spectrum was averaged: segments, window, overlap, and what they make the numbers worth."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, frozen, one_of, positive, whole
from ultraquiet._base.errors import InputError

DETRENDS = ("constant", "linear", "none")
# A segment shorter than this has no inner lines to speak of.
SHORTEST = 8
# Without a word from the user a record is cut into eighths: about 15 half-overlapping segments.
DEFAULT_PARTS = 8
MOST_OVERLAP = 0.95


@dataclass(frozen=True)
class Averaging:
    """Welch's averaging: `averages` windowed segments of `segment_samples`, `shared` samples apart from new.

    >>> plan = Averaging(1000.0, 1000, 500, "hann", "constant", averages=15)
    >>> round(plan.enbw_hz, 3), round(plan.independent, 2)
    (1.5, 14.26)

    Reference: F. J. Harris, Proc. IEEE 66 (1978) 51-83, doi:10.1109/PROC.1978.10837.
    """

    rate_hz: float
    segment_samples: int
    shared: int
    window: str
    detrend: str
    averages: int

    @property
    def overlap(self) -> float:
        """Shared part of neighbouring segments."""
        return self.shared / self.segment_samples

    @property
    def f_hz(self) -> FloatArray:
        """The lines, `(segment_samples // 2 + 1,)`."""
        return np.asarray(np.arange(self.segment_samples // 2 + 1) * self.line_hz, dtype=np.float64)

    @property
    def line_hz(self) -> float:
        """Distance of the lines."""
        return self.rate_hz / self.segment_samples

    @cached_property
    def taper(self) -> FloatArray:
        """The window's samples, `(segment_samples,)`."""
        from scipy.signal import get_window

        try:
            return frozen(np.asarray(get_window(self.window, self.segment_samples), dtype=np.float64))
        except ValueError as error:
            raise InputError(f"spectra: there is no window '{self.window}' ({error}).") from None

    @cached_property
    def enbw_hz(self) -> float:
        """Resolution: the equivalent noise bandwidth rate sum w^2 / (sum w)^2."""
        return float(self.rate_hz * np.sum(self.taper**2) / np.sum(self.taper) ** 2)

    @cached_property
    def statistical_hz(self) -> float:
        """Bandwidth in which one line's worth of independent information sits: rate sum w^4 / (sum w^2)^2."""
        return float(self.rate_hz * np.sum(self.taper**4) / np.sum(self.taper**2) ** 2)

    @cached_property
    def independent(self) -> float:
        """Number of independent segments that would scatter as much: K / (1 + 2 sum (1 - m/K) rho_m^2), Welch 1967."""
        K, step, w = self.averages, self.segment_samples - self.shared, self.taper
        lags = range(1, min(K, -(-self.segment_samples // step)))
        rho = [np.dot(w[: -m * step], w[m * step :]) / np.dot(w, w) for m in lags]
        return K / (1.0 + 2.0 * sum((1.0 - m / K) * float(r) ** 2 for m, r in zip(lags, rho, strict=True)))

    @property
    def text(self) -> str:
        """What a result and every picture of it say."""
        return (
            f"{self.averages} segments of {self.segment_samples} samples, window {self.window}, "
            f"overlap {self.overlap:.3g}, detrend {self.detrend}, resolution {self.enbw_hz:.4g} Hz"
        )


def segments(who: str, samples: int, segment_samples: int | None, overlap: float) -> tuple[int, int, int]:
    """Return length, shared samples and number of segments."""
    chosen = segment_samples is not None
    length = (
        whole(who, "segment_samples", segment_samples, SHORTEST) if chosen else max(SHORTEST, samples // DEFAULT_PARTS)
    )
    if length > samples:
        raise InputError(f"{who}: a segment of {length} samples does not fit into {samples} samples; shorten it.")
    shared = int(between(who, "overlap", overlap, 0.0, MOST_OVERLAP) * length)
    return length, shared, 1 + (samples - length) // (length - shared)


def averaging(
    who: str, samples: int, rate_hz: float, segment_samples: int | None, overlap: float, window: str, detrend: str
) -> Averaging:
    """Return the checked averaging of a signal of so many samples."""
    length, shared, count = segments(who, samples, segment_samples, overlap)
    one_of(who, "detrend", detrend, DETRENDS)
    return Averaging(positive(who, "rate_hz", rate_hz, "Hz"), length, shared, window, detrend, count)
