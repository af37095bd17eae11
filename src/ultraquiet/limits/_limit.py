"""What a limit says."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

NO_LEVEL = 1e-9  # 180 dB: nothing is left to attenuate


@dataclass(frozen=True, eq=False)
class Limit:
    """The best flat attenuation of a band, between what a controller reaches and what none can.

    Attributes:
        status: `ok` and what was found; `short` where the controller found exceeds a demand by a hundredth or more
            between the points of every grid that was tried; `refused` and why there is none.
        attenuation_db: -20 log10 of the largest |S| in the band with `controller`: it can be had. With an uncertainty
            this, `peak_db` and `sensitivity` are those of the worst plant within it, `control_gain` the plant's own.
        bound_db: no linear controller that keeps the demands attenuates more; nan where it could not be certified.
        peak_db: largest |S| anywhere, with `controller`.
        control_gain: largest |K S| anywhere, with `controller`.
        controller: u = K y that does it. Of high order, a proof and not a design.
        f_hz: `(nf,)` frequencies.
        sensitivity: `(nf,)` |S| with `controller`.
        binding: for each demand the stretches of frequency, Hz, over which it is used up.
        half_basis_db: what half of the basis reaches: how far the basis has converged.
        basis: functions in Q.
        violation: largest share by which a demand is exceeded on a grid four times as fine; zero when none is.
    """

    status: Status
    attenuation_db: float = float("nan")
    bound_db: float = float("nan")
    peak_db: float = float("nan")
    control_gain: float = float("nan")
    controller: StateSpace | None = None
    f_hz: FloatArray = field(default_factory=lambda: np.zeros(0))
    sensitivity: FloatArray = field(default_factory=lambda: np.zeros(0))
    binding: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    half_basis_db: float = float("nan")
    basis: int = 0
    violation: float = 0.0


def refused(sentence: str) -> Limit:
    """Return a limit that is none."""
    return Limit(Status(StatusWord.REFUSED, sentence))


def attenuation(level: float) -> float:
    """Return a level of |S| as attenuation in dB."""
    return -20 * float(np.log10(max(level, NO_LEVEL)))
