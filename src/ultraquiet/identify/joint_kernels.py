"""One data set of a joint fit, compiled: residual and reduced normal matrix with working arrays of its own.

The sets are independent given their tables, so threads take one each; neither function holds the lock.
"""

from typing import Any

import numpy as np
from numba import njit

from ultraquiet.identify.prediction_error import kernels

compiled: Any = njit(cache=True, nogil=True, fastmath=False)


@compiled
def residual(u, y, P, degree, lag, states):
    """Return the mean squared residual and the residual, past and constant fitted."""
    nu, n = u.shape
    signals = np.zeros((nu + 2 + P.shape[0] + 1, n))
    driven, parts, rest, e = np.zeros((nu, n)), np.zeros((nu, n)), np.zeros(n), np.zeros(n)
    loss = kernels.evaluate(u, y, P, degree, lag, states, signals, driven, parts, rest, e)
    return loss, e


@compiled
def normal(u, y, P, degree, lag, free, states):
    """Return loss, residual and [J e]'[J e] in the delta basis, past and constant eliminated."""
    nu, n = u.shape
    signals = np.zeros((nu + 2 + P.shape[0] + 1, n))
    driven, parts, rest, e = np.zeros((nu, n)), np.zeros((nu, n)), np.zeros(n), np.zeros(n)
    loss = kernels.evaluate(u, y, P, degree, lag, states, signals, driven, parts, rest, e)
    G, q = kernels.normal_matrix(y, P, degree, lag, free, states, signals, driven, parts, rest, e)
    return loss, e, kernels.reduced(G, q)
