"""Starts of a search for the least one-step error beside the predictor's own subspace, and the best of what they give.

A regression on the past must be as long as the predictor's memory, and where noise only reads off the outputs that is
the plant's: lightly damped modes far below the sampling rate then lie in none that a record can bear. Their simulated
error holds them. Whatever the start, in a closed loop too, the least one-step error is consistent.
"""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.identify.subspace import fit
from ultraquiet.identify.subspace.method import Subspace, fitted
from ultraquiet.values import Record


def from_simulation(settings: Subspace, record: Record, data: fit.Scaled, options: fit.Options) -> list[fit.Fitted]:
    """Return the model of least one-step error near that of least simulated error, and the latter where it has no K.

    A plant whose outputs carry white noise alone has K = 0, and both errors are one; a K that is searched all the same
    follows the noise, with the predictor's poles at the edge of stability.
    """
    try:
        simulated = fitted(settings, record)
    except InputError:  # the record is too short, or moves too little, for block rows of past and of future
        return []
    refined = fit.refined_prediction(simulated.system, data, options)
    return [refined] if np.any(simulated.system.K) else [simulated, refined]


def best(found: Sequence[fit.Fitted], data: fit.Scaled, weighted: bool) -> fit.Fitted:
    """Return the model of least `schwarz`, the first of equals."""
    return min(found, key=lambda one: schwarz(one.system, data, weighted))


def schwarz(system: fit.System, data: fit.Scaled, weighted: bool) -> float:
    """Return Schwarz's criterion of the one-step error e `(ny, n)`: n log det(e e' / n) + log n (free parameters).

    A state of ny outputs and nu inputs brings nu + 2 ny of them, nu + ny where K = 0. Not `weighted`: with ny times the
    log of the mean trace in the place of log det, as the search has it.

    Reference: Schwarz 1978, doi:10.1214/aos/1176344136; Hannan and Deistler 1988, The Statistical Theory of Linear
    Systems, chapter 5.
    """
    e = system.errors(data.u, data.y)
    nu, (ny, n) = len(data.u), e.shape
    free = len(system.A) * (nu + ny + (ny if np.any(system.K) else 0))
    return n * _log_size(e @ e.T / n, weighted) + float(np.log(n)) * free


def _log_size(covariance: FloatArray, weighted: bool) -> float:
    if not np.all(np.isfinite(covariance)):
        return np.inf
    least = np.finfo(float).tiny  # of a record without noise nothing is left
    if not weighted:
        return len(covariance) * float(np.log(max(np.trace(covariance) / len(covariance), least)))
    sign, value = np.linalg.slogdet(covariance)
    return float(value) if sign > 0 else len(covariance) * float(np.log(least))
