"""Starts of a search for the least one-step error beside the predictor's own subspace, and the best of what they give.

A regression on the past must be as long as the predictor's memory, and where noise only reads off the outputs that is
the plant's: lightly damped modes far below the sampling rate then lie in none that a record can bear. Their simulated
error holds them. Whatever the start, in a closed loop too, the least one-step error is consistent.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.identify.subspace import fit
from ultraquiet.identify.subspace.method import Subspace, fitted
from ultraquiet.identify.subspace.one_step.past_regression import (
    LONGEST,
    SAMPLES_PER_COLUMN,
    PastRegression,
)
from ultraquiet.values import Record


def from_simulation(settings: Subspace, record: Record, data: fit.Scaled, options: fit.Options) -> list[fit.SystemFit]:
    """Return models of least one-step error near that of least simulated error, and the latter where it has no K.

    A plant whose outputs carry white noise alone has K = 0, and both errors are one; a K that is searched all the same
    follows the noise, with the predictor's poles at the edge of stability. Coloured noise has states of its own.
    """
    simulated = _simulated(settings, record)
    if simulated is None:
        return []
    plain = fit.SystemFit(replace(simulated.system, K=np.zeros_like(simulated.system.K)), *simulated[1:])
    noise = noise_model(data.y - plain.system.simulated(data.u))
    plant: fit.SystemFit | None = plain
    if noise is not None and settings.given_order is not None:  # the states asked for are those of both
        order = settings.given_order - len(noise.A)
        plant = _simulated(replace(settings, order=order), record) if order > 0 else None
    starts = [simulated.system]
    if noise is not None and plant is not None:
        starts.append(beside(plant.system, noise))
    refined = [fit.refined_prediction(start, data, options) for start in starts]
    return refined if np.any(simulated.system.K) else [plain, *refined]


def _simulated(settings: Subspace, record: Record) -> fit.SystemFit | None:
    try:
        return fitted(settings, record)
    except InputError:  # the record is too short, or moves too little, for block rows of past and of future
        return None


def noise_model(v: FloatArray) -> fit.System | None:
    """Return x+ = A x + K e, v = C x + e of a signal `(ny, n)`; None where Schwarz's criterion finds it white."""
    ny, n = v.shape
    one = np.ones((ny, 1))
    data = fit.Scaled(np.zeros((0, n)), v, np.zeros((0, 1)), one)
    longest = min(LONGEST, n // (SAMPLES_PER_COLUMN * ny) - 1)
    if longest < 1:
        return None
    regression = PastRegression.of(data, longest, feedthrough=False)
    states = regression.states(regression.memory(1))
    model = fit.with_poles_inside(states.model(states.order()))
    nothing = replace(model, A=np.zeros((0, 0)), B=np.zeros((0, 0)), C=np.zeros((ny, 0)), K=np.zeros((0, ny)))
    white = replace(nothing, x0=np.zeros(0))
    if not model.predicts() or schwarz(model, data, True) >= schwarz(white, data, True):
        return None
    return model


def beside(plant: fit.System, noise: fit.System) -> fit.System:
    """Return a plant that innovations do not move, its outputs joined by noise that inputs do not move."""
    p, q, nu = len(plant.A), len(noise.A), plant.B.shape[1]
    A = np.block([[plant.A, np.zeros((p, q))], [np.zeros((q, p)), noise.A]])
    K = np.vstack([np.zeros((p, len(noise.C))), noise.K])
    B, C = np.vstack([plant.B, np.zeros((q, nu))]), np.hstack([plant.C, noise.C])
    return fit.System(A, B, C, plant.D, K, np.concatenate([plant.x0, np.zeros(q)]), plant.constant)


def best(found: Sequence[fit.SystemFit], data: fit.Scaled, weighted: bool) -> fit.SystemFit:
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
    return n * fit.log_size(e, weighted) + float(np.log(n)) * free
