"""What a search holds: shapes over frequency for S, T and K S, in dB, and the band in which S is to be small."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, real_array
from ultraquiet._base.errors import InputError

Shape = float | tuple[tuple[float, ...], tuple[float, ...]]  # a number, or (frequencies in Hz, values)
SAME = 1e-9  # relative: frequencies as near as this are one
OfFrequency = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Demands:
    """Bounds in dB at frequencies in Hz, and what is sought.

    Attributes:
        band_hz: where the largest singular value of S is to be as small as it can be.
        sensitivity_db: bound on S outside the band.
        control_db: bound on K S.
        complementary_db: bound on T.
        tones_hz, tone_db: where S is to be below minus so much.
    """

    band_hz: tuple[float, float]
    sensitivity_db: OfFrequency
    control_db: OfFrequency
    complementary_db: OfFrequency | None = None
    tones_hz: tuple[float, ...] = ()
    tone_db: float = 0.0

    def inside(self, f_hz: FloatArray) -> np.ndarray:
        """Return which frequencies lie in the band; its ends do, whatever rounding has done to them."""
        low, high = self.band_hz
        return (f_hz >= low * (1 - SAME)) & (f_hz <= high * (1 + SAME))


def table(who: str, name: str, shape: object, logarithmic: bool) -> OfFrequency:
    """Return a shape as a function of frequency in Hz, linear over its logarithm, constant beyond its ends.

    Args:
        who: asks, for the sentence of a refusal.
        name: of the setting.
        shape: a number, or two sequences of frequencies in Hz, rising, and values.
        logarithmic: whether values are gains, returned in dB, and not dB already.

    Raises:
        InputError: neither, or gains that are not above zero.
    """
    if isinstance(shape, Sequence) and not isinstance(shape, str):
        if len(shape) != 2:
            raise InputError(f"{who}: '{name}' must be a number or (frequencies in Hz, values), got {shape!r}.")
        f, values = (real_array(who, name, np.atleast_1d(np.asarray(part)), 1) for part in shape)
        rising = f.size == values.size > 0 and f[0] > 0 and bool(np.all(np.diff(f) > 0))
        if not rising or (logarithmic and values.min() <= 0):
            what = "values above zero" if logarithmic else "values"
            raise InputError(f"{who}: '{name}' must be rising frequencies in Hz and as many {what}, got {shape!r}.")
    else:
        level = float(real_array(who, name, np.asarray(shape), 0))
        f, values = np.ones(1), np.array([positive(who, name, level) if logarithmic else level])
    values = 20 * np.log10(values) if logarithmic else values
    places = np.log(f)

    def at(f_hz: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.interp(np.log(np.asarray(f_hz, dtype=np.float64)), places, values)

    return at
