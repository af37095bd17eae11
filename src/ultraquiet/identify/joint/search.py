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
from ultraquiet.identify.prediction_error.damping_policy import FIRST_DAMPING
from ultraquiet.identify.prediction_error.in_memory import InMemory, moved
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.levenberg_marquardt import minimise
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.signals import signals_of
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, ROW_FIRST, IntArray

MOST_BYTES = 1 << 28  # of workspaces kept at once; beyond it each is made again for the normal matrix
SMALLEST_VARIANCE = 1e-28  # of the output's own: below it lies only rounding


@dataclass(frozen=True, eq=False)
class Part:
    """One data set: an output of one record.

    Attributes:
        data: its samples.
        parameterisation: its polynomials.
        group: sets of one group share the innovation variance, and give one model.
        keys: one per row of the table; rows of equal keys, in whatever set, are one polynomial.
        states: initial conditions as `Parameterisation.states` counts them.
    """

    data: ChannelData
    parameterisation: Parameterisation
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
class JointMinimum:
    """Where a joint search ended.

    `normal` is the weighted [J e]'[J e] of all unknowns, `variance` the innovations' of each set's group in output
    units, `state` as in `levenberg_marquardt.Ended`.
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
    rows = [ROW_A, *range(ROW_FIRST, part.parameterisation.rows), ROW_C, ROW_D]  # the kernels' order of parameters
    maps = [(row, part.parameterisation.free(row)) for row in rows if movable(part.parameterisation.letter(row))]
    return [(row, m) for row, m in maps if m is not None]


def _unit(part: Part, row: int) -> float:
    return float(part.data.gain[(row - ROW_FIRST) // 2]) if part.parameterisation.letter(row) == "b" else 1.0


def _place(
    part: Part, movable: Callable[[str], bool], offsets: dict[Hashable, int], references: dict[Hashable, float]
) -> Place:
    maps = _maps(part, movable)
    free = np.zeros(part.parameterisation.rows, dtype=np.bool_)
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


@dataclass(frozen=True, eq=False)
class TiedPoint:
    """One table per set, the losses of the sets and what follows from them; see `levenberg_marquardt.Point`."""

    sets: "Sets"
    tables: list[FloatArray]
    criterion: float
    variance: FloatArray

    @property
    def unit(self) -> float:
        """Of a likelihood: the innovations are in units of their deviation."""
        return 1.0

    def normal(self) -> FloatArray:
        """Return the weighted [J e]'[J e] of all unknowns."""
        return self.sets.normal(self.tables, self.variance)

    def moved(self, step: FloatArray) -> "TiedPoint | None":
        """Return the point a step of all unknowns leads to; None when one of its tables is not admissible."""
        return self.sets.moved(self.tables, step)

    def gained(self, other: "TiedPoint") -> float:
        """Return how much less the criterion is there."""
        return self.criterion - other.criterion


class Sets:
    """The sets of a problem with a workspace each, kept from loss to normal matrix where memory allows."""

    def __init__(self, problem: Problem, run: Any) -> None:
        self.problem, self._run = problem, run
        self.accumulators = [
            InMemory(p.data.u, p.data.y, signals_of(p.parameterisation, place.free, p.states))
            for p, place in zip(problem.parts, problem.places, strict=True)
        ]
        self._kept = sum(a.bytes for a in self.accumulators) <= MOST_BYTES

    def each(self, work: Callable[[InMemory, FloatArray], Any], tables: Sequence[FloatArray]) -> list[Any]:
        """Return what `work` makes of every set and its table, in threads."""

        def one(item: tuple[InMemory, FloatArray]) -> Any:
            out = work(*item)
            if not self._kept:
                item[0].release()
            return out

        return list(self._run(one, zip(self.accumulators, tables, strict=True)))

    def at(self, tables: Sequence[FloatArray]) -> TiedPoint:
        """Return the point of the tables."""
        losses = self.each(lambda a, table: a.loss(table), tables)
        return TiedPoint(self, list(tables), *_judged(self.problem.parts, losses))

    def normal(self, tables: Sequence[FloatArray], variance: FloatArray) -> FloatArray:
        """Return the sum of the sets' normal matrices, each in the unknowns of all and weighted by its variance."""
        size = self.problem.size
        S = np.zeros((size + 1, size + 1))
        local = self.each(lambda a, table: a.normal(table), tables)
        for part, place, weight, own in zip(self.problem.parts, self.problem.places, variance, local, strict=True):
            m = place.index.size
            T = np.zeros((own.shape[0], m + 1))
            T[:-1, :m], T[-1, m] = place.map, 1.0
            at = np.append(place.index, size)
            S[np.ix_(at, at)] += part.data.output_size**2 / weight * (T.T @ own @ T)
        return S

    def moved(self, tables: Sequence[FloatArray], step: FloatArray) -> TiedPoint | None:
        """Return the point after a step of all unknowns."""
        out: list[FloatArray] = []
        for own, place, table in zip(self.accumulators, self.problem.places, tables, strict=True):
            there = moved(own.signals, table, place.map @ step[place.index])
            if there is None:
                return None
            out.append(there)
        return self.at(out)


def search(
    problem: Problem,
    tables: Sequence[FloatArray],
    steps: int,
    tolerance: float,
    workers: int = 1,
    damping: float = FIRST_DAMPING,
) -> JointMinimum:
    """Minimise the criterion from the given tables, one per set; every table stays admissible at every step."""
    with ThreadPoolExecutor(workers) as pool:
        sets = Sets(problem, map if workers == 1 else pool.map)
        ended = minimise(sets.at(tables), steps, tolerance, damping)
        point = ended.point
        residuals = sets.each(lambda a, table: a.residual(table), point.tables)
    return JointMinimum(
        point.tables, point.criterion, point.variance, residuals, ended.normal, ended.iterations, ended.state
    )


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


def covariance_root(problem: Problem, normal: FloatArray) -> FloatArray:
    """Return R with R R' the covariance of all unknowns."""
    p = problem.size
    size = np.sqrt(np.maximum(np.diag(normal)[:p], np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(normal[:p, :p] / np.outer(size, size))
    least = np.finfo(float).eps * max(float(values[-1]), 1e-300)
    return vectors / size[:, None] / np.sqrt(np.maximum(values, least))
