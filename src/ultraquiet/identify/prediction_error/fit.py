"""One output of one structure: starts, search, verdict."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify import chance
from ultraquiet.identify.prediction_error import in_memory
from ultraquiet.identify.prediction_error.in_memory import InMemory
from ultraquiet.identify.prediction_error.initial_models import ChannelData, start_table, starting_tables
from ultraquiet.identify.prediction_error.levenberg_marquardt import CONVERGED, RUNNING, STUCK
from ultraquiet.identify.prediction_error.model_table import modelled
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.signals import signals_of
from ultraquiet.identify.prediction_error.structure import (
    ROW_A,
    ROW_C,
    ROW_D,
    Structure,
    b_rows,
    f_rows,
    free_rows,
)
from ultraquiet.identify.result import SIGNIFICANCE, noiseless
from ultraquiet.linalg import portmanteau, prediction
from ultraquiet.linalg.balance import square_root
from ultraquiet.values import PolynomialModel, Status, StatusWord

# The search ends when a step would move the sum of squares by less than this many innovation variances: the estimate
# then stands within 3 % of its own standard deviation of the minimum.
TOLERANCE = 1e-3
TEST_LAGS = 40  # at 3.5 kHz 11 ms, over which a wrong 12 Hz pole leaves a visible residual correlation
# The race of the starts: each runs so many steps in all, then so many of them go on, if within this ratio of the best
# loss. On 126 searches of records of the bench it ended within 1 % of the best of all starts in 122.
TRIAL_STEPS = 10
PROMISING = 1.1
FIRST_STEPS = 2 * TRIAL_STEPS
RACE = ((TRIAL_STEPS, 3, 1.2), (2 * TRIAL_STEPS, 2, PROMISING))
# Rounds of replacing clipped readings by the model's output, and the share of the record's size below which a round no
# longer matters. A tenth of a record at its limits pulls a gain down by 1 dB and is mended in four rounds; with half of
# it there, 40 rounds bring 11 dB down to 3: lower the excitation instead.
REPAIRS = 40
SETTLED = 1e-3


@dataclass(frozen=True)
class Search:
    """How the search is run; see `PolynomialMethod`."""

    horizons: tuple[int, ...]
    estimate: bool
    offset: bool
    max_iterations: int
    repair: bool


@dataclass(frozen=True, eq=False)
class Found:
    """Where a search ended: see `levenberg_marquardt.Ended`."""

    table: FloatArray
    loss: float
    residual: FloatArray
    normal: FloatArray
    iterations: int
    state: int


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
        best = replace(again, iterations=best.iterations + again.iterations)
        model = model_of(best, structure, data, rate_hz)
    return finished(data, structure, search, model, best, tried)


def finished(
    data: ChannelData, structure: Structure, search: Search, model: PolynomialModel, best: "Found", tried: int
) -> Fit:
    """Return a model with its evidence: residual tests, fit, covariance."""
    evidence = residual_tests(best.residual, data.u, structure)
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


def best_of_starts(data: ChannelData, structure: Structure, search: Search) -> "tuple[Found, int]":
    """Search from a given model, or race all starts; the result is kept for fits that need it again.

    Where the same channel has been fitted one order lower with less loss, the race has missed the minimum, and the
    search begins from that smaller model.
    """
    key = (structure, search)
    if key not in data.searched:
        minimum, tried = _from_model(data, structure, search) or _raced(data, structure, search)
        smaller = data.searched.get((structure.smaller(), search))
        if smaller is not None and smaller[0].loss < minimum.loss:
            table = Parameterisation.alike(structure, data.u.shape[0]).empty()
            table[:, : smaller[0].table.shape[1]] = smaller[0].table
            minimum, tried = run_search(data, structure, search, table, search.max_iterations), tried + 1
        data.searched[key] = minimum, tried
    return data.searched[key]


def _from_model(data: ChannelData, structure: Structure, search: Search) -> "tuple[Found, int] | None":
    """Search from the channel's given model; None when there is none or the search does not converge."""
    if data.start is None:
        return None
    minimum = run_search(data, structure, search, start_table(data, structure, data.start), search.max_iterations)
    return (minimum, 1) if minimum.state == CONVERGED else None


def _raced(data: ChannelData, structure: Structure, search: Search) -> "tuple[Found, int]":
    """Let all starts run some steps, the better of them more; the lowest loss wins.

    A residual that passes the tests ends the race: no other minimum can be better by more than chance.
    """
    tables = starting_tables(data, structure, search.horizons)
    (steps, _, _), *later = RACE
    runners: list[Found] = []
    for table in tables:
        # The most trusted one may show at once that the race is not needed.
        ahead = steps if runners else FIRST_STEPS
        minimum = run_search(data, structure, search, table, min(ahead, search.max_iterations))
        runners.append(minimum)
        if _passes(minimum, data, structure):
            minimum = runners[-1] = _further(minimum, data, structure, search, search.max_iterations)
            if minimum.state == CONVERGED and _passes(minimum, data, structure):
                return minimum, len(runners)
    tried = len(runners)
    for (_, kept, ratio), (steps, _, _) in zip(RACE, [*later, (search.max_iterations, 0, 0.0)], strict=True):
        runners = sorted(runners, key=lambda r: r.loss)[:kept]
        runners = [r for r in runners if r.loss <= ratio * runners[0].loss]
        runners = [_further(r, data, structure, search, steps) for r in runners]
    return min(runners, key=lambda r: r.loss), tried


def _passes(found: "Found", data: ChannelData, structure: Structure) -> bool:
    e = found.residual
    return whiteness(e, structure) >= SIGNIFICANCE and freedom(e, data.u) >= SIGNIFICANCE


def _further(found: "Found", data: ChannelData, structure: Structure, search: Search, steps: int) -> "Found":
    """Return the search continued until `steps` of its steps are used in all."""
    left = min(steps, search.max_iterations) - found.iterations
    if found.state != RUNNING or left <= 0:
        return found
    more = run_search(data, structure, search, found.table, left)
    return replace(more, iterations=found.iterations + more.iterations)


def run_search(
    data: ChannelData, structure: Structure, search: Search, table: FloatArray, steps: int, *, noise_only: bool = False
) -> "Found":
    """Search from a table; with `noise_only` the plant is held and C and D alone move."""
    nu = data.u.shape[0]
    plant = [] if noise_only else [ROW_A, *b_rows(nu), *f_rows(nu)]
    parameterisation = Parameterisation.alike(structure, nu)
    free = free_rows(nu, [*plant, ROW_C, ROW_D])
    signals = signals_of(parameterisation, free, parameterisation.states(search.estimate, search.offset))
    accumulator = InMemory(data.u, data.y, signals)
    ended = in_memory.search(accumulator, table, steps, TOLERANCE)
    point = ended.point
    return Found(
        point.table, point.criterion, accumulator.residual(point.table), ended.normal, ended.iterations, ended.state
    )


def residual_tests(e: FloatArray, u: FloatArray, structure: Structure) -> tuple[float, float]:
    """Return the p-values that e is white and that it is free of the inputs."""
    return whiteness(e, structure), freedom(e, u)


def whiteness(e: FloatArray, structure: Structure) -> float:
    """Return the p-value that the residual e of a structure is white."""
    return portmanteau.ljung_box(e, _test_lags(e), structure.a + structure.c + structure.d).p_value


def freedom(e: FloatArray, u: FloatArray) -> float:
    """Return the p-value that e is free of the inputs, that of the least over them."""
    return portmanteau.sidak(portmanteau.cross_correlation(e, x, _test_lags(e)).p_value for x in u)


def _test_lags(e: FloatArray) -> int:
    return min(TEST_LAGS, e.size // 10)


def model_of(found: "Found", structure: Structure, data: ChannelData, rate_hz: float) -> PolynomialModel:
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
