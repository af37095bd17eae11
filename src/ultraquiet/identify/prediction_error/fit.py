"""One output of one structure: its model, its evidence and the verdict on it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify import chance
from ultraquiet.identify.prediction_error.damping_policy import CONVERGED, STUCK
from ultraquiet.identify.prediction_error.in_memory import InMemory
from ultraquiet.identify.prediction_error.initial_models import ChannelData, noise_start, start_table
from ultraquiet.identify.prediction_error.model_table import modelled
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.race import (
    Found,
    Search,
    best_of_starts,
    fed_back,
    noise_rings,
    residual_tests,
    run_search,
)
from ultraquiet.identify.prediction_error.signals import signals_of
from ultraquiet.identify.prediction_error.structure import ROW_C, ROW_D, Structure, b_rows, f_rows, free_rows
from ultraquiet.identify.response.follows_inputs import MISSED, unless_followed
from ultraquiet.identify.result import SIGNIFICANCE, noiseless
from ultraquiet.linalg import prediction
from ultraquiet.linalg.balance import square_root
from ultraquiet.values import PolynomialModel, Status, StatusWord

# Rounds of replacing clipped readings by the model's output, and the share of the record's size below which a round no
# longer matters. A tenth of a record at its limits pulls a gain down by 1 dB and is mended in four rounds; with half of
# it there, 40 rounds bring 11 dB down to 3: lower the excitation instead.
REPAIRS = 40
SETTLED = 1e-3
FOCUSES = ("auto", "prediction", "simulation")
# Points of simulated fit that the other focus must bring: the record's own scatter moves it by less.
WORTH = 1.0


@dataclass(frozen=True, eq=False)
class Fit:
    """A model of one output and its evidence."""

    model: PolynomialModel
    status: Status
    fit_percent: float
    loss: float
    covariance: FloatArray
    whiteness_p: float
    correlation_p: float
    iterations: int
    starts: int
    repaired: int
    silent: bool = False  # its inputs explain no more of the output than chance would
    past: int = 0  # initial conditions fitted beside the coefficients, a constant among them


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


def fit_channel(data: ChannelData, structure: Structure, search: Search, rate_hz: float) -> Fit:
    """Return the model of one output, clipped readings repaired by the model itself until it no longer moves."""
    best, tried = best_of_starts(data, structure, search)
    model = model_of(best, structure, data, rate_hz)
    for _ in range(REPAIRS if search.repair and data.clipped else 0):
        mended = data.repaired(simulated(data, model, search))
        moved = float(np.linalg.norm(mended.y - data.y) / np.linalg.norm(mended.y))
        data = mended
        if moved < SETTLED:
            break
        again = run_search(data, structure, search, best.table, search.max_iterations)
        iterations = best.iterations + again.iterations
        best = replace(again, iterations=iterations, plant_whole_p=best.plant_whole_p)
        model = model_of(best, structure, data, rate_hz)
    return finished(data, structure, search, model, best, tried)


def finished(
    data: ChannelData, structure: Structure, search: Search, model: PolynomialModel, best: Found, tried: int
) -> Fit:
    """Return a model with its evidence: residual tests, fit, covariance."""
    evidence = residual_tests(best, data, structure)
    output = np.clip(simulated(data, model, search), data.low, data.high)
    fit_percent = prediction.fit_percent(data.recorded, output)
    nu = data.u.shape[0]
    free = structure.parameters(nu) + nu * structure.longest + 1  # its past and a constant too
    share = best.loss / max(float(np.var(data.y)), np.finfo(float).tiny)
    status, silent = judged(
        noiseless(share) or verdict(best.state, best.iterations, evidence),
        evidence[1],
        model,
        lambda: chance.explained(data.recorded, data.recorded - output),
        data.recorded.size,
        free,
    )
    if noise_rings(best.table, structure) and not fed_back(best.residual, data.u):
        status = unless_followed(status, data.recorded - output, data.recorded, data.u, model.rate_hz, MISSED)
    colored = colored_products(data, structure, search, best) if is_colored(structure, evidence[0]) else None
    return Fit(
        model,
        status,
        fit_percent,
        model.noise_variance,
        covariance(best.normal, best.loss, structure, data.gain, colored),
        whiteness_p=evidence[0],
        correlation_p=evidence[1],
        iterations=best.iterations,
        starts=tried,
        repaired=data.clipped if search.repair else 0,
        silent=silent,
        past=int(Parameterisation.alike(structure, nu).states(search.estimate, search.offset).sum()),
    )


def judged(
    status: Status, free: float, model: PolynomialModel, explains: Callable[[], float], samples: int, parameters: float
) -> tuple[Status, bool]:
    """Return what the verdict on a residual says of a model, and whether its inputs explain no more than chance would.

    A residual that is white and free of the inputs is no praise where the inputs have nothing to do with the output, or
    where only one step is predicted. `explains` returns the share of `chance.explained`; it is asked where it matters.
    `free` is the p-value that the residual holds nothing of the inputs.
    """
    if not (status.ok or chance.of_nothing(status, free)):
        return status, False
    if not model.is_stable():  # of ARX and ARMAX alone: their A is not divided by
        said = "The model is unstable: it predicts one step, but its simulation grows without bound."
        return (Status(StatusWord.POOR_FIT, said) if status.ok else status), False
    told = explains()
    silent = chance.by_chance(told, samples, parameters)
    return (chance.silence(told) if silent else status), silent


def model_of(found: Found, structure: Structure, data: ChannelData, rate_hz: float) -> PolynomialModel:
    """Return the model a search ended at, in the units of the record."""
    parameterisation = Parameterisation.alike(structure, data.u.shape[0])
    return modelled(parameterisation, found.table, data.gain, rate_hz, found.loss * data.output_size**2)


def simulated(data: ChannelData, model: PolynomialModel, search: Search) -> FloatArray:
    """Return the model's simulated output in output units, its past and a constant fitted."""
    y = data.y * data.output_size
    u = data.u * data.input_size[:, None]
    f = [model.denominator(j) for j in range(u.shape[0])]
    return prediction.simulate(u, y, model.b, f, estimate=search.estimate, offset=search.offset)


def verdict(state: int, iterations: int, evidence: tuple[float, float]) -> Status:
    """Return what a search's end and the p-values of its residual say."""
    white, free = evidence
    if state != CONVERGED:
        why = "no admissible step lowers the loss" if state == STUCK else f"{iterations} steps were not enough"
        return Status(StatusWord.NOT_CONVERGED, f"The search ended away from a minimum: {why}.")
    if min(evidence) < SIGNIFICANCE:
        what = "is not white" if white < free else "still holds something of the input"
        return Status(
            StatusWord.NOT_WHITE,
            f"The residual {what} ({p_in_words(min(evidence))}): the structure or the order leaves part of the record "
            f"unexplained, or the search found a poor minimum.",
        )
    return Status(
        StatusWord.OK, f"Converged; the residual is white (p = {white:.2g}) and free of the input (p = {free:.2g})."
    )


def covariance(
    normal: FloatArray, loss: float, structure: Structure, gain: FloatArray, colored: FloatArray | None = None
) -> FloatArray:
    """Return the covariance in coefficients of q^-k, output and input in their units.

    loss (J'J)^-1 where the residual is white; else (J'J)^-1 J'RJ (J'J)^-1, R the covariance of the residual's samples.

    Args:
        normal: [J e]'[J e] in the delta basis.
        loss: mean square of the residual.
        structure: numbers of coefficients.
        gain: output's unit over each input's.
        colored: J'RJ of a residual that is not white; None where it is.

    Ljung, System Identification, 2nd ed., eqs. (9.17) and (9.42).
    """
    p = normal.shape[0] - 1
    if p == 0:
        return np.zeros((0, 0))
    to_shift = np.zeros((p, p))
    at = 0
    for count, scale in _blocks(structure, gain):
        for k in range(count):
            binomial = 1.0
            for m in range(k + 1):
                to_shift[at + m, at + k] = scale * binomial
                binomial *= -(k - m) / (m + 1.0)
        at += count
    size = np.sqrt(np.maximum(np.diag(normal)[:p], np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(normal[:p, :p] / np.outer(size, size))
    values = np.maximum(values, np.finfo(float).eps * max(values[-1], 1e-300))
    if colored is None:
        root = (to_shift / size) @ vectors / np.sqrt(values)
        return loss * root @ root.T
    back = (to_shift / size) @ (vectors / values) @ vectors.T
    root = back @ square_root(colored / np.outer(size, size))
    return root @ root.T


def is_colored(structure: Structure, whiteness_p: float) -> bool:
    """Return whether a residual counts as coloured: one of an output error whose test for whiteness fails.

    What a structure with a noise model leaves is white, or the model is not the plant's.
    """
    return not (structure.models_noise or whiteness_p >= SIGNIFICANCE)


def colored_products(data: ChannelData, structure: Structure, search: Search, found: Found) -> FloatArray:
    """Return J'RJ of an output error that is coloured, R of an autoregression of it.

    The columns of J are filters of the inputs: driven by inputs that the colour has filtered, they are as the root of R
    leaves them, but for a phase that no product over the whole record sees.
    """
    a, variance = prediction.whitening(found.residual)
    u, y = (
        np.ascontiguousarray([prediction.filtered(x, np.ones(1), a) for x in rows]) for rows in (data.u, data.y[None])
    )
    nu = data.u.shape[0]
    parameterisation = Parameterisation.alike(structure, nu)
    free = free_rows(nu, [*b_rows(nu), *f_rows(nu)])
    signals = signals_of(parameterisation, free, parameterisation.states(search.estimate, search.offset))
    normal = InMemory(u, y[0], signals).normal(found.table)
    p = normal.shape[0] - 1
    return variance * normal[:p, :p]


def _blocks(structure: Structure, gain: FloatArray) -> list[tuple[int, float]]:
    """Return size and unit of each block of parameters, in order."""
    blocks = [(structure.a, 1.0)]
    for g in gain:
        blocks += [(structure.b, float(g)), (structure.f, 1.0)]
    return [*blocks, (structure.c, 1.0), (structure.d, 1.0)]
