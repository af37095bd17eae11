"""A weight as a system: the smallest one that stays above a bound and hardly higher than need be."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg import realize
from ultraquiet.linalg.discretize import tustin
from ultraquiet.linalg.magnitude_fit import Factors, fit_above
from ultraquiet.values import StateSpace

HIGHEST_ORDER = 8
ORDERS = (0, 1, 2, 4, 6, 8)  # tried when none is given
WORTH_DB = 1.0  # a state more must bring the weight this much nearer to its bound, on average


def fitted_weight(f_hz: FloatArray, bound: FloatArray, rate_hz: float | None, order: int | None) -> StateSpace:
    """Return a stable minimum-phase weight above the bound; the smallest within 1 dB of the best when order is None."""
    # Tustin's rule maps tan: a weight fitted over the warped axis is exact in discrete time.
    w = 2 * np.pi * f_hz if rate_hz is None else 2 * rate_hz * np.tan(np.pi * f_hz / rate_hz)
    if order is not None:
        return _system(fit_above(w, bound, order), rate_hz)
    fits = [_system(fit_above(w, bound, n), rate_hz) for n in ORDERS]
    excess = [float(np.mean(20 * np.log10(np.abs(s.frequency_response(f_hz)[0, 0]) / bound))) for s in fits]
    return fits[next(n for n, x in enumerate(excess) if x <= min(excess) + WORTH_DB)]


def _system(W: Factors, rate_hz: float | None) -> StateSpace:
    unit = float(np.exp(np.mean(np.log(np.abs(W.poles))))) if W.poles.size else 1.0
    num = np.asarray(W.gain * np.poly(W.zeros / unit).real, dtype=np.float64)
    den = np.asarray(np.poly(W.poles / unit).real, dtype=np.float64)
    A, B, C, D = realize.sections(np.atleast_1d(num), np.atleast_1d(den))
    M = (A * unit, B * np.sqrt(unit), C * np.sqrt(unit), D)
    return StateSpace(*(M if rate_hz is None else tustin(*M, rate_hz)), rate_hz=rate_hz)
