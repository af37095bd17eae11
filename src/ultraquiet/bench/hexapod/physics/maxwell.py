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
    """k(s) = k0 + sum_j k_j s / (s + w_j): a spring beside Maxwell branches; `n` stages side by side.

    `spring_n_per_m` `(n,)`, `branch_n_per_m` `(branches, n)`, `branch_rad_s` `(branches,)`.
    """

    spring_n_per_m: FloatArray
    branch_n_per_m: FloatArray
    branch_rad_s: FloatArray

    @property
    def glass_n_per_m(self) -> FloatArray:
        """Stiffness with all dashpots locked, `(n,)`."""
        return self.spring_n_per_m + self.branch_n_per_m.sum(axis=0)

    def stiffness(self, f_hz: ArrayLike) -> ComplexArray:
        """Return the complex stiffnesses in N/m at `f_hz`, `(n, nf)`."""
        s = 2j * np.pi * frequency_array("Stage.stiffness", f_hz)
        share = s / (s + self.branch_rad_s[:, np.newaxis])
        return (self.spring_n_per_m[:, np.newaxis] + self.branch_n_per_m.T @ share).astype(np.complex128)


def stage(stiffness_n_per_m: ArrayLike, loss: ArrayLike) -> Stage:
    """Return stages whose loss factor is `loss` over LOSS_BAND_HZ and whose storage stiffness holds at STORAGE_HZ.

    With the branches' frequencies given, Im k = loss Re k is linear in k_j / k0 and solved by least squares.

    >>> k = stage(3.5e5, 0.167).stiffness([60.0])[0, 0]
    >>> round(k.real), bool(abs(k.imag / k.real - 0.167) < 0.01)
    (350000, True)
    """
    k, eta = np.atleast_1d(stiffness_n_per_m).astype(np.float64), np.atleast_1d(loss).astype(np.float64)
    w = 2.0 * np.pi * np.array(RELAXATION_HZ)
    s = 2j * np.pi * np.geomspace(*LOSS_BAND_HZ, 60)[:, np.newaxis]
    g = s / (s + w)
    solved = {e: np.linalg.lstsq(g.imag - e * g.real, np.full(len(s), e), rcond=None)[0] for e in set(eta.tolist())}
    ratio = np.column_stack([solved[e] for e in eta.tolist()]).astype(np.float64)
    spring = k / Stage(np.ones(len(k)), ratio, w).stiffness([STORAGE_HZ])[:, 0].real
    return Stage(spring, spring * ratio, w)
