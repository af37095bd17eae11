"""The sensitivity matrix as the bench shows it, from which every direction and band can be read."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import UnheardError
from ultraquiet._base.shown.line import counted
from ultraquiet.linalg.response import principal_gains
from ultraquiet.simulate.sweeps.lines import largest
from ultraquiet.values import FrequencyResponse

# A line is resolved when noise moves its largest singular value by less than this share: 0.4 dB. One that is not is
# counted with so many deviations of the noise on top.
RESOLVED, DEVIATIONS = 0.05, 2.0
NEAR = 1.01  # a band whose end is that near to a line is heard up to there


@dataclass(frozen=True)
class MeasuredSensitivity:
    """S = Y closed Y open^-1 at each line, `(ny, ny, nf)`, and the responses from disturbance to sensors behind it.

    The largest singular value of S is the amplification in the worst direction, whatever direction the disturbance
    takes; S is measured with as many runs as there are directions. With fewer actuators than sensors S is that of the
    directions which the actuators reach, zero in the others: there nothing can be done and nothing is claimed.

    Attributes:
        S: at every line that was asked for.
        opened, closed: from disturbance to sensors, `(ny, nu, nf)`.
        deviation: of the largest singular value, from noise, `(nf,)`.
        reach: sentence on directions the actuators do not reach; empty where they reach all.
        below: sentence on what S may do under the lowest line; empty where it falls there, or lines were asked for.
        unheard: sentence on the range of the sweeps in which there are no lines, as the open loop is not heard there;
            empty where there are, or lines were asked for.
        louder: what would let hidden lines be heard; empty where nothing but the bench itself would.
        rings: whether a run ended before it had come to rest; what that leaves open counts as noise does.
    """

    S: FrequencyResponse
    opened: ComplexArray
    closed: ComplexArray
    deviation: FloatArray
    reach: str = ""
    below: str = ""
    unheard: str = ""
    louder: str = ""
    rings: bool = False

    @property
    def f_hz(self) -> FloatArray:
        """Lines in Hz: all that were asked for."""
        return self.S.f_hz

    @property
    def hidden(self) -> np.ndarray:
        """Whether noise hides the worst direction of a line, `(nf,)`: what is counted there is a bound."""
        return self.deviation > RESOLVED * self._size

    @property
    def lines_missing(self) -> int:
        """Lines asked for that were not measured: none, ever; those that noise hides are counted at its bound."""
        return int(np.count_nonzero(~np.isfinite(self._size)))

    def worst_direction_db(self) -> FloatArray:
        """Reduction in dB of the worst direction at each line, `(nf,)`; negative where it is amplified."""
        return -20 * np.log10(self._size)

    @property
    def bound_db(self) -> FloatArray:
        """Reduction in dB that is certain at each line, `(nf,)`: less than was read by what noise leaves open."""
        return -20 * np.log10(self._size + DEVIATIONS * self.deviation)

    def counted_db(self) -> FloatArray:
        """Return what counts of each line, `(nf,)`: the worst direction where it was resolved, elsewhere the bound."""
        return np.where(self.hidden, self.bound_db, self.worst_direction_db())

    def worst_in_band_db(self, low_hz: float, high_hz: float) -> float:
        """Smallest worst-direction reduction at the lines of a band, in dB, hidden ones counted at their bound.

        Nothing is known where a band reaches beyond the lines: `unresolved` says so.
        """
        return float(self.counted_db()[self._band(low_hz, high_hz)].min())

    def peak_amplification_db(self) -> float:
        """Largest amplification of any direction at any line, in dB, hidden lines counted at their bound."""
        return float(-self.counted_db().min())

    def mean_log_db(self) -> float:
        """Return the mean over frequency of 20 log10 |det S| / ny: what quiet bands are paid with elsewhere.

        For a stable loop with a stable controller and at least one sample of delay the mean over 0 to Nyquist is zero:
        every decibel gained over a hertz is lost over another (Bode's integral in discrete time; Sung and Hara 1988,
        doi:10.1080/00207178808906305). With fewer actuators than sensors it is that of the directions they reach.
        """
        sizes = principal_gains(self.S.values)
        count = min(self.opened.shape[:2])
        level = 20 * np.log10(np.maximum(sizes[:count], np.finfo(float).tiny)).mean(axis=0)
        if level.size == 1:
            return float(level[0])
        return float(np.trapezoid(level, self.f_hz) / (self.f_hz[-1] - self.f_hz[0]))

    def broadband_db(self, low_hz: float, high_hz: float) -> float:
        """Reduction of the RMS of the worst sensor under equal, independent disturbances over a band, in dB.

        Sensors that hear nothing, without the law or with it, are left out; 0 where none hears anything.
        """
        band = self._band(low_hz, high_hz)
        width = np.gradient(self.f_hz)[band] if self.f_hz.size > 1 else np.ones(1)
        opened, closed = (np.sum(np.abs(y[:, :, band]) ** 2 * width, axis=(1, 2)) for y in (self.opened, self.closed))
        heard = opened + closed > 0
        if not heard.any():
            return 0.0
        with np.errstate(divide="ignore"):
            return float(10 * np.log10(np.min(opened[heard] / closed[heard])))

    def unresolved(self, low_hz: float = 0.0, high_hz: float = np.inf) -> str:
        """Return a sentence on the lines of a band that noise hides, in numbers, and on where it was not measured."""
        band = self._band(low_hz, high_hz)
        hidden, f = band & self.hidden, self.f_hz
        said = f"All {band.sum()} lines were resolved." if band.sum() > 1 else "The line was resolved."
        if hidden.any():
            what = "Noise, or what still rings when a run ends," if self.rings else "Noise"
            n, low, high = int(hidden.sum()), f[hidden].min(), f[hidden].max()
            where, they = (f"{low:.4g} Hz", "it is") if n == 1 else (f"{low:.4g} to {high:.4g} Hz", "they are")
            said = (
                f"{what} hides {n} of {counted(int(band.sum()), 'line')}, {where}; {they} counted at the bound that "
                f"this leaves.{f' To hear more, {self.louder}.' if self.louder else ''}"
            )
        outside = self.unheard if low_hz < f[0] or high_hz > f[-1] else ""
        below = self.below if low_hz < f[0] else ""
        if not below and not outside and low_hz > 0 and not is_heard_from(f[0], low_hz):
            below = f"Nothing was measured from {low_hz:.4g} to {f[0]:.4g} Hz."
        return " ".join(filter(None, (said, below, outside)))

    @cached_property
    def _size(self) -> FloatArray:
        return size_of(self.S.values)

    def _band(self, low_hz: float, high_hz: float) -> np.ndarray:
        band = (self.f_hz >= low_hz) & (self.f_hz <= high_hz)
        if not band.any():
            raise UnheardError(f"MeasuredSensitivity: no line lies between {low_hz:g} and {high_hz:g} Hz.")
        return band


def is_heard_from(lowest_hz: float, low_hz: float) -> bool:
    """Return whether lines from `lowest_hz` on are those of a band that begins at `low_hz`."""
    return lowest_hz <= NEAR * low_hz


def size_of(S: ComplexArray) -> FloatArray:
    """Return the largest singular value of each line, `(lines,)`, of `(ny, ny, lines)`."""
    return largest(np.moveaxis(S, 2, 0))
