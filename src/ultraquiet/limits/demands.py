"""The demands of a limit, checked, and as limits over frequency."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, OfFrequency, between, is_shape, over_frequency, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.limits.loops import AffineLoops
from ultraquiet.limits.programme import TIGHTENED, Demand, largest_sensitivity
from ultraquiet.values.state_space import StateSpace

WHO = "best_flat_attenuation"
IN_BAND, PEAK, CONTROL, ERROR = "attenuation", "peak of S", "control gain", "uncertainty"
# Without a limit on the control, |K S| may still not exceed this many times what cancelling in the band takes.
FREE_CONTROL = 1e4
LEAST_ERROR = 1e-9  # a weight of zero asks nothing


@dataclass(frozen=True, eq=False)
class Wishes:
    """Band, peak of |S| and the bounds that hold at all frequencies.

    `control_gain` is the largest |K S| anywhere; where it is less, `control_share` says over frequency by how much.
    `error` is the size of the plant's relative error: the band and the peak are those of every such plant. Then the
    level sought is no convex demand; about a `guess` of it, it is.
    """

    band_hz: tuple[float, float]
    peak: float | OfFrequency
    control_gain: float
    error: OfFrequency | None = None
    control_share: OfFrequency | None = None
    guess: float | None = None

    def inside(self, f_hz: FloatArray) -> np.ndarray:
        """Return which frequencies lie in the band."""
        return (f_hz >= self.band_hz[0]) & (f_hz <= self.band_hz[1])

    def demands(self, f_hz: FloatArray, lines: AffineLoops) -> list[Demand]:
        """Return the demands on a grid, that on the band first.

        Of plants off by e that is |S| + e t |1 - S| <= t. With a guess in place of the second t it is convex, and right
        where t comes out as guessed. Without one |1 - S| counts as one, which it nearly is where much is attenuated.
        """
        inside = self.inside(f_hz)
        error = self.errors(f_hz)
        guessed = error is not None and self.guess is not None
        sure = 1.0 if error is None or guessed else 1 - error
        band = Demand(IN_BAND, lines.a, lines.b, np.where(inside, sure, np.inf), sought=True)
        if guessed:
            band = replace(band, error=error, guess=self.guess)
        gains = np.full(f_hz.size, self.control_gain)
        if self.control_share is not None:
            gains = gains * self.control_share(f_hz)
        return [
            band,
            Demand(PEAK, lines.a, lines.b, self.peaks(f_hz), tight=self._tight(f_hz), error=error),
            Demand(CONTROL, lines.c, lines.d, gains),
        ]

    def peaks(self, f_hz: FloatArray) -> FloatArray:
        """Return the largest |S| allowed."""
        return self.peak(f_hz) if callable(self.peak) else np.full(f_hz.size, self.peak)

    def errors(self, f_hz: FloatArray) -> FloatArray | None:
        """Return the size of the plant's relative error, where it has one."""
        return None if self.error is None else np.maximum(self.error(f_hz), LEAST_ERROR)

    def largest(self, f_hz: FloatArray, S: np.ndarray) -> FloatArray:
        """Return |S| of the worst plant within the error, from S of the plant itself."""
        return largest_sensitivity(S, self.errors(f_hz))

    def _tight(self, f_hz: FloatArray) -> float | FloatArray:
        """S = 1 is what no control gives: a peak little above it is tightened by a share of what it allows beyond."""
        peak = self.peak(f_hz) if callable(self.peak) else self.peak
        tight = 1 - (1 - TIGHTENED) * np.where(np.asarray(peak) >= 1, np.minimum(1.0, np.asarray(peak) - 1), 1.0)
        return tight if callable(self.peak) else float(tight)


def checked_peak(who: str, peak_db: Any, least_db: float) -> float | OfFrequency:
    """Return the largest |S| allowed, as a factor: a number, or what it is over frequency.

    Raises:
        InputError: it is neither a number nor a shape (frequencies in Hz, dB), or below `least_db`.
    """
    if not is_shape(peak_db):
        return 10 ** (between(who, "peak_db", peak_db, least_db, 300.0, "dB") / 20)
    shape_db = over_frequency(who, "peak_db", peak_db, logarithmic=False)
    for value in np.atleast_1d(peak_db[1]):
        between(who, "peak_db", value, least_db, 300.0, "dB")
    return lambda f_hz: 10 ** (shape_db(f_hz) / 20)


def checked_error(who: str, plant: StateSpace, uncertainty: Any) -> OfFrequency | None:
    """Return the size of a relative error over frequency: a number's, a table's (Hz, size), a scalar system's.

    Raises:
        InputError: it is none of these, not above zero, or a system of another rate.
    """
    if uncertainty is None:
        return None
    if not isinstance(uncertainty, StateSpace):
        size_db = over_frequency(who, "uncertainty", uncertainty, logarithmic=True)
        return lambda f_hz: 10 ** (size_db(f_hz) / 20)
    same_rate(who, "the plant", plant.rate_hz, "the uncertainty", uncertainty.rate_hz)
    if uncertainty.D.shape != (1, 1):
        raise InputError(f"{who}: the uncertainty must be scalar, got {uncertainty.D.shape}.")
    return lambda f_hz: np.abs(uncertainty.frequency_response(f_hz)[0, 0])


def checked_control(
    who: str, control_gain: Any, lines: AffineLoops, inside: np.ndarray
) -> tuple[float, OfFrequency | None]:
    """Return the largest |K S| allowed and the share of it allowed over frequency; very much where none is given.

    Raises:
        InputError: it is neither a number above zero nor a shape (frequencies in Hz, gains above zero).
    """
    if control_gain is None:
        return _free_control(lines, inside), None
    shape_db = over_frequency(who, "control_gain", control_gain, logarithmic=True)
    if not is_shape(control_gain):
        return float(control_gain), None
    most = float(np.max(control_gain[1]))
    return most, lambda f_hz: 10 ** (shape_db(f_hz) / 20) / most


@np.errstate(over="ignore")  # over nothing at all
def _free_control(lines: AffineLoops, inside: np.ndarray) -> float:
    """Return a limit on |K S| that is none."""
    needed = np.abs(lines.a[inside] / np.maximum(np.abs(lines.b[inside]), np.finfo(float).tiny))
    return FREE_CONTROL * float(needed.max())
