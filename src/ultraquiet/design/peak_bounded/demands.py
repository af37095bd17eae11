"""What a search holds: shapes over frequency for S, T and K S, in dB, and the band in which S or S G is to be small."""

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
        band_hz: where the largest singular value of what is sought is to be as small as it can be.
        sensitivity_db: bound on S outside the band.
        control_db: bound on K S.
        complementary_db: bound on T.
        tones_hz, tone_db: where S is to be below minus so much.
        response_db: the largest gain of G in the band: S G is sought, in dB over it; S itself when absent.
        disk_margin: bound on 1 / ||S - I/2|| at the ends named by `margin_ends`; 0 asks nothing.
        one_loop: whether S is the same at both ends, as it is with one scalar law on every channel.
    """

    band_hz: tuple[float, float]
    sensitivity_db: OfFrequency
    control_db: OfFrequency
    complementary_db: OfFrequency | None = None
    tones_hz: tuple[float, ...] = ()
    tone_db: float = 0.0
    response_db: float | None = None
    disk_margin: float = 0.0
    one_loop: bool = False

    def inside(self, f_hz: FloatArray) -> np.ndarray:
        """Return which frequencies lie in the band; its ends do, whatever rounding has done to them."""
        low, high = self.band_hz
        return (f_hz >= low * (1 - SAME)) & (f_hz <= high * (1 + SAME))

    def margin_ends(self, f_hz: FloatArray) -> tuple[str, ...]:
        """Return at which ends the disk margin is a bound of its own; that on S implies it at the output where it can.

        ||S - I/2|| <= ||S|| + 1/2. The law of a plant with more inputs than outputs may turn commands into one another
        that no output shows: there the input's margin is bounded by nothing else.
        """
        if self.disk_margin <= 0:
            return ()
        implied = 10 ** (float(np.max(self.sensitivity_db(f_hz))) / 20) + 0.5 <= 1 / self.disk_margin
        output = () if implied else ("output",)
        return output if self.one_loop else (*output, "input")

    @property
    def margin_db(self) -> float:
        """The bound on ||S - I/2||, in dB."""
        return -20 * float(np.log10(self.disk_margin))


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
