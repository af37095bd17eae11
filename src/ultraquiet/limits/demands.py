"""The demands of a limit, checked, and as limits over frequency."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, positive, real_array, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.limits.loops import AffineLoops
from ultraquiet.limits.programme import TIGHTENED, Demand
from ultraquiet.values.state_space import StateSpace

WHO = "best_flat_attenuation"
IN_BAND, PEAK, CONTROL, ROBUST = "attenuation", "peak of S", "control gain", "uncertainty"
# Without a limit on the control, |K S| may still not exceed this many times what cancelling in the band takes.
FREE_CONTROL = 1e4


@dataclass(frozen=True)
class Wishes:
    """Band, peak of |S| and the bounds that hold at all frequencies."""

    band_hz: tuple[float, float]
    peak: float
    control_gain: float
    uncertainty: "StateSpace | tuple[FloatArray, FloatArray] | None" = None

    def demands(self, f_hz: FloatArray, lines: AffineLoops) -> list[Demand]:
        """Return the demands on a grid, that on the band first."""
        low, high = self.band_hz
        inside = (f_hz >= low) & (f_hz <= high)
        never = np.full(f_hz.size, np.inf)
        # S = 1 is what no control gives: a peak little above it is tightened by a share of what it allows beyond
        tight = 1 - (1 - TIGHTENED) * min(1.0, max(self.peak - 1, 0.0) if self.peak >= 1 else 1.0)
        demands = [
            Demand(IN_BAND, lines.a, lines.b, np.where(inside, 1.0, never), sought=True),
            Demand(PEAK, lines.a, lines.b, np.full(f_hz.size, self.peak), tight=tight),
            Demand(CONTROL, lines.c, lines.d, np.full(f_hz.size, self.control_gain)),
        ]
        if self.uncertainty is not None:
            demands.append(Demand(ROBUST, lines.a - 1, lines.b, 1 / self.weight(f_hz)))
        return demands

    def weight(self, f_hz: FloatArray) -> FloatArray:
        """Return |W| of the uncertainty on a grid; outside a table's frequencies, its ends."""
        W = self.uncertainty
        if isinstance(W, StateSpace):
            size = np.abs(W.frequency_response(f_hz)[0, 0])
        else:
            assert W is not None
            size = np.exp(np.interp(np.log(np.maximum(f_hz, 1e-12)), np.log(W[0]), np.log(W[1])))
        return np.maximum(size, 1e-9)  # a weight of zero asks nothing


def checked_uncertainty(
    plant: StateSpace, uncertainty: "StateSpace | tuple[ArrayLike, ArrayLike] | None"
) -> "StateSpace | tuple[FloatArray, FloatArray] | None":
    """Return the uncertainty as a stable scalar weight or as a table of frequencies and sizes."""
    if uncertainty is None:
        return None
    if isinstance(uncertainty, StateSpace):
        same_rate(WHO, "the plant", plant.rate_hz, "the uncertainty", uncertainty.rate_hz)
        if uncertainty.D.shape != (1, 1):
            raise InputError(f"{WHO}: the uncertainty must be scalar, got {uncertainty.D.shape}.")
        return uncertainty
    if not isinstance(uncertainty, tuple | list) or len(uncertainty) != 2:
        raise InputError(f"{WHO}: the uncertainty must be a StateSpace or a table (f_hz, size), got {uncertainty!r}.")
    f, size = (real_array(WHO, f"uncertainty[{k}]", part, 1) for k, part in enumerate(uncertainty))
    if f.size != size.size or f.size == 0 or f.min() <= 0 or size.min() <= 0 or np.any(np.diff(f) <= 0):
        raise InputError(
            f"{WHO}: a table of uncertainty is (f_hz, size): as many of both, all above zero, f_hz rising."
        )
    return f, size


@np.errstate(over="ignore")  # over nothing at all
def largest_control(control_gain: float | None, lines: AffineLoops, inside: np.ndarray) -> float:
    """Return the limit on |K S|, a very high one where none is given."""
    if control_gain is not None:
        return positive(WHO, "control_gain", control_gain)
    needed = np.abs(lines.a[inside] / np.maximum(np.abs(lines.b[inside]), np.finfo(float).tiny))
    return FREE_CONTROL * float(needed.max())
