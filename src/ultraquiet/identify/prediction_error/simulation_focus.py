"""Box-Jenkins models whose plant simulates best: the plant by its output error, the noise from what it leaves."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from ultraquiet.identify.prediction_error.fit import (
    Fit,
    Search,
    covariance,
    finished,
    fit_channel,
    model_of,
    run_search,
    simulated,
)
from ultraquiet.identify.prediction_error.initial_models import ChannelData, noise_start, start_table
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.structure import ROW_C, ROW_D, Structure
from ultraquiet.identify.result import SIGNIFICANCE

FOCUSES = ("auto", "prediction", "simulation")
# Points of simulated fit that the other focus must bring: the record's own scatter moves it by less.
WORTH = 1.0


def fit_focused(data: ChannelData, structure: Structure, search: Search, rate_hz: float, focus: str) -> Fit:
    """Return the model of one output for the wanted focus.

    Where a structure holds the truth, both criteria meet in the same plant, and the one-step error finds it with the
    least variance. Where it does not, the one-step error weighs frequencies by the inverse of the noise model: under
    noise of low frequency the plant is fitted to the highest ones. "auto" notices by a residual that is not white.
    """
    if focus == "simulation":
        return fit_simulated(data, structure, search, rate_hz)
    predicted = fit_channel(data, structure, search, rate_hz)
    if focus == "prediction" or min(predicted.whiteness_p, predicted.correlation_p) >= SIGNIFICANCE:
        return predicted
    other = fit_simulated(data, structure, search, rate_hz)
    return other if other.fit_percent > predicted.fit_percent + WORTH else predicted


def fit_simulated(data: ChannelData, structure: Structure, search: Search, rate_hz: float) -> Fit:
    """Return B / F by the simulated error, then C / D by the one-step error with B / F held.

    The covariance of B and F is that of the output error, coloured as it is; that of C and D stands beside it, for
    without feedback the two err independently.
    """
    output_error = replace(structure, c=0, d=0)
    plant = fit_channel(data, output_error, search, rate_hz)
    if search.repair and data.clipped:
        data = data.repaired(simulated(data, plant.model, search))
    at_plant = run_search(data, output_error, search, start_table(data, output_error, plant.model), 0)
    table = Parameterisation.alike(structure, data.u.shape[0]).empty()
    table[:, : at_plant.table.shape[1]] = at_plant.table[:, : table.shape[1]]
    c, d = noise_start(at_plant.residual, structure.c, structure.d)
    table[ROW_C, : c.size], table[ROW_D, : d.size] = c, d
    minimum = run_search(data, structure, search, table, search.max_iterations, noise_only=True)
    model = model_of(minimum, structure, data, rate_hz)
    whole = np.eye(structure.parameters(data.u.shape[0]) + 1)
    ended = replace(minimum, normal=whole, iterations=minimum.iterations + plant.iterations)
    fit = finished(data, structure, search, model, ended, plant.starts)
    noise_alone = covariance(minimum.normal, minimum.loss, replace(structure, a=0, b=0, f=0), np.zeros(0))
    return replace(fit, covariance=np.asarray(block_diag(plant.covariance, noise_alone)))
