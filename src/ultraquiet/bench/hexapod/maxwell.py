"""The viscoelastic stage: springs in series with dashpots, so that time and frequency domain agree."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array

# Two branches that relax at these frequencies hold the loss factor within 2 % over the band; found by a search over
# pairs of frequencies for the smallest worst deviation.
RELAXATION_HZ = (20.7, 162.0)
LOSS_BAND_HZ = (20.0, 120.0)
# The suspension modes lie at 35 to 113 Hz; the storage stiffness is the given one in their middle. It cannot be
# constant: by causality a loss factor eta lets it grow by about 2 eta / pi for each factor e in frequency.
STORAGE_HZ = 60.0


@dataclass(frozen=True, eq=False)
class Stage:
    """k(s) = k0 + sum_j k_j s / (s + w_j): a spring beside Maxwell branches."""

    spring_n_per_m: float
    branch_n_per_m: FloatArray
    branch_rad_s: FloatArray

    def stiffness(self, f_hz: ArrayLike) -> ComplexArray:
        """Return the complex stiffness in N/m at `f_hz`, `(nf,)`."""
        s = 2j * np.pi * frequency_array("Stage.stiffness", f_hz)[:, np.newaxis]
        return self.spring_n_per_m + np.sum(self.branch_n_per_m * s / (s + self.branch_rad_s), axis=1)


def stage(stiffness_n_per_m: float, loss: float) -> Stage:
    """Return the stage whose loss factor is `loss` over LOSS_BAND_HZ and whose storage stiffness holds at STORAGE_HZ.

    With the branches' frequencies given, Im k = loss Re k is linear in k_j / k0 and solved by least squares.

    >>> k = stage(3.5e5, 0.167).stiffness([60.0])[0]
    >>> round(k.real), bool(abs(k.imag / k.real - 0.167) < 0.01)
    (350000, True)
    """
    w = 2.0 * np.pi * np.array(RELAXATION_HZ)
    s = 2j * np.pi * np.geomspace(*LOSS_BAND_HZ, 60)[:, np.newaxis]
    g = s / (s + w)
    ratio = np.linalg.lstsq(g.imag - loss * g.real, np.full(len(s), loss), rcond=None)[0].astype(np.float64)
    unit = Stage(1.0, ratio, w)
    scale = stiffness_n_per_m / float(unit.stiffness([STORAGE_HZ])[0].real)
    return Stage(scale, scale * ratio, w)
