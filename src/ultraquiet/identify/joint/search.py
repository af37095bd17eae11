"""One search over several data sets whose polynomials are tied: Levenberg-Marquardt on the sum of normal matrices.

Each set d has its own table, past and constant; a map T_d takes the step of all unknowns to the step of its table. The
criterion is that of maximum likelihood with an unknown innovation variance per group of sets,

    W = sum_g N_g log(lambda_g),   lambda_g = 1/N_g sum_{d in g} e_d'e_d,

whose Gauss-Newton matrix is sum_d T_d' J_d'J_d T_d / lambda_g. Past and constant are eliminated inside J_d, exactly.

Reference: Ljung, System Identification, 2nd ed., sections 7.2 and 10.2.
"""

from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.initial_models import Channel
from ultraquiet.identify.prediction_error.parameterisation import Layout
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, ROW_FIRST, IntArray

FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-12
SMALLEST_VARIANCE = 1e-28  # of the output's own: below it lies only rounding


@dataclass(frozen=True, eq=False)
class Part:
    """One data set: an output of one record.

    Attributes:
        data: its samples.
        layout: its polynomials.
        group: sets of one group share the innovation variance, and give one model.
        keys: one per row of the table; rows of equal keys, in whatever set, are one polynomial.
        states: initial conditions as `Layout.states` counts them.
    """

    data: Channel
    layout: Layout
    group: int
    keys: tuple[Hashable, ...]
    states: IntArray


@dataclass(frozen=True, eq=False)
class Place:
    """Where the unknowns of one set stand among all: step of the table = `map` @ step[`index`]."""

    index: IntArray
    map: FloatArray
    free: np.ndarray[Any, np.dtype[np.bool_]]


@dataclass(frozen=True, eq=False)
class Problem:
    """Several sets and their common unknowns, `size` in number."""

    parts: tuple[Part, ...]
    places: tuple[Place, ...]
    size: int


@dataclass(frozen=True, eq=False)
class Ended:
    """Where a joint search ended.

    `normal` is the weighted [J e]'[J e] of all unknowns, `variance` the innovations' of each set's group in output
    units, `state` as in `kernels.search`.
    """

    tables: list[FloatArray]
    criterion: float
    variance: FloatArray
    residuals: list[FloatArray]
    normal: FloatArray
    iterations: int
    state: int


def posed(parts: Sequence[Part], movable: Callable[[str], bool] = lambda letter: True) -> Problem:
    """Return the problem in which the polynomials of the movable letters are searched for."""
    offsets: dict[Hashable, int] = {}
    references: dict[Hashable, float] = {}
    size = 0
    for part in parts:
        for row, m in _maps(part, movable):
            if part.keys[row] not in offsets:
                offsets[part.keys[row]] = size
                references[part.keys[row]] = _unit(part, row)
                size += m.shape[1]
    return Problem(tuple(parts), tuple(_place(part, movable, offsets, references) for part in parts), size)


def _maps(part: Part, movable: Callable[[str], bool]) -> list[tuple[int, FloatArray]]:
    rows = [ROW_A, *range(ROW_FIRST, part.layout.rows), ROW_C, ROW_D]  # the kernels' order of parameters
    found = [(row, part.layout.free(row)) for row in rows if movable(part.layout.letter(row))]
    return [(row, m) for row, m in found if m is not None]


def _unit(part: Part, row: int) -> float:
    return float(part.data.gain[(row - ROW_FIRST) // 2]) if part.layout.letter(row) == "b" else 1.0


def _place(
    part: Part, movable: Callable[[str], bool], offsets: dict[Hashable, int], references: dict[Hashable, float]
) -> Place:
    maps = _maps(part, movable)
    free = np.zeros(part.layout.rows, dtype=np.bool_)
    free[[row for row, _ in maps]] = True
    index = np.unique([offsets[part.keys[row]] + k for row, m in maps for k in range(m.shape[1])]).astype(np.int64)
    T = np.zeros((sum(m.shape[0] for _, m in maps), index.size))
    at = 0
    for row, m in maps:
        key = part.keys[row]
        first = int(np.searchsorted(index, offsets[key]))
        T[at : at + m.shape[0], first : first + m.shape[1]] += m * (references[key] / _unit(part, row))
        at += m.shape[0]
    return Place(index, T, free)


def search(
    problem: Problem,
    tables: Sequence[FloatArray],
    steps: int,
    tolerance: float,
    workers: int = 1,
    damping: float = FIRST_DAMPING,
) -> Ended:
    """Minimise the criterion from the given tables, one per set; every table stays admissible at every step."""
    from ultraquiet.identify.prediction_error import kernels

    with ThreadPoolExecutor(workers) as pool:
        run: Any = map if workers == 1 else pool.map
        now: list[FloatArray] = list(tables)
        state, small, iterations = 0, 0, 0
        while True:
            W, variance, residuals, S = _summed(problem, now, run)
            _, promised = kernels.damped_step(S, 0.0)
            if promised <= tolerance or small >= kernels.STALLED_STEPS:
                state = 1
            if state != 0 or iterations >= steps or not np.isfinite(W):
                return Ended(now, W, variance, residuals, S, iterations, state)
            state = -1
            for _ in range(kernels.INNER_TRIES):
                step, promised = kernels.damped_step(S, damping)
                trial = _moved(problem, now, step)
                gain = W - _criterion(problem, trial, run)
                if trial is not None and gain > 0:
                    damping *= 0.1 if gain > 0.75 * promised else (0.5 if gain > 0.25 * promised else 2.0)
                    damping = max(LEAST_DAMPING, damping)
                    small = small + 1 if gain <= tolerance else 0
                    now, state = trial, 0
                    break
                damping = max(damping, 1e-9) * 6.0
            iterations += 1


def _summed(
    problem: Problem, tables: Sequence[FloatArray], run: Any
) -> tuple[float, FloatArray, list[FloatArray], FloatArray]:
    """Return criterion, variance of each set's group, residuals, and the weighted normal matrix of all unknowns."""
    from ultraquiet.identify import joint_kernels

    def one(work: tuple[Part, Place, FloatArray]) -> Any:
        part, place, table = work
        layout = part.layout
        return joint_kernels.normal(
            part.data.u, part.data.y, table, layout.degree(), layout.lag(), place.free, part.states
        )

    found = list(run(one, zip(problem.parts, problem.places, tables, strict=True)))
    W, variance = _judged(problem.parts, [f[0] for f in found])
    S = np.zeros((problem.size + 1, problem.size + 1))
    for part, place, weight, (_, _, local) in zip(problem.parts, problem.places, variance, found, strict=True):
        m = place.index.size
        T = np.zeros((local.shape[0], m + 1))
        T[:-1, :m], T[-1, m] = place.map, 1.0
        at = np.append(place.index, problem.size)
        S[np.ix_(at, at)] += part.data.output_size**2 / weight * (T.T @ local @ T)
    return W, variance, [f[1] for f in found], S


def _criterion(problem: Problem, tables: Sequence[FloatArray] | None, run: Any) -> float:
    from ultraquiet.identify import joint_kernels

    if tables is None:
        return np.inf

    def one(work: tuple[Part, FloatArray]) -> float:
        part, table = work
        layout = part.layout
        return joint_kernels.residual(part.data.u, part.data.y, table, layout.degree(), layout.lag(), part.states)[0]

    return _judged(problem.parts, list(run(one, zip(problem.parts, tables, strict=True))))[0]


def _judged(parts: Sequence[Part], losses: Sequence[float]) -> tuple[float, FloatArray]:
    """Return the criterion and the variance of each set's group."""
    groups = np.array([part.group for part in parts])
    count = np.array([part.data.y.size for part in parts])
    power = np.array([part.data.output_size**2 for part in parts])
    W, variance = 0.0, np.zeros(len(parts))
    for g in np.unique(groups):
        own = groups == g
        least = SMALLEST_VARIANCE * float(power[own].max())
        value = max(least, float(np.sum((count * power * np.array(losses))[own]) / np.sum(count[own])))
        W += float(np.sum(count[own])) * np.log(value)
        variance[own] = value
    return float(W), variance


def _moved(problem: Problem, tables: Sequence[FloatArray], step: FloatArray) -> list[FloatArray] | None:
    """Return the tables after a step of all unknowns; None when one of them is not admissible."""
    from ultraquiet.identify.prediction_error import kernels

    out: list[FloatArray] = []
    for part, place, table in zip(problem.parts, problem.places, tables, strict=True):
        degree = part.layout.degree()
        moved = kernels.stepped(table, degree, place.free, place.map @ step[place.index])
        if not kernels.admissible(moved, degree):
            return None
        out.append(moved)
    return out


def covariance_root(problem: Problem, normal: FloatArray) -> FloatArray:
    """Return R with R R' the covariance of all unknowns."""
    p = problem.size
    size = np.sqrt(np.maximum(np.diag(normal)[:p], np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(normal[:p, :p] / np.outer(size, size))
    least = np.finfo(float).eps * max(float(values[-1]), 1e-300)
    return vectors / size[:, None] / np.sqrt(np.maximum(values, least))
