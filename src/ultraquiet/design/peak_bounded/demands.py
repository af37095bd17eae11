"""What a search holds: shapes over frequency for S, T and K S, in dB, and the band in which S or S G is to be small."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, OfFrequency

SAME = 1e-9  # relative: frequencies as near as this are one


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
