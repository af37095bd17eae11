"""The signals of one output's prediction error: which filters make them, and which of them are columns.

Every signal is a row of a workspace `(signals, head + samples)`: inputs, output, a pulse at the first sample, ones,
then what `kernels.filters.filtered` makes of them:

    driven_j = u_j / F_j,  part_j = B_j driven_j,  rest = A y - sum_j part_j,  e = (D / C) rest,

the columns of initial conditions and constant, and the filtered signals whose shifts are minus the gradient of e:

    a: (D/C) y,  b_j: -(D/C) driven_j,  f_j: (D/C) part_j / F_j,  c: -e / C,  d: rest / C.

Past inputs reach the output as a free response x / F_j, the noise filter's past as x / C: both are linear in what is
not known, so they are eliminated exactly at every step instead of being taken as zero. A signal that no polynomial
changes is not made again: its row is that of its source.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, ROW_FIRST, IntArray

# What a step of `kernels.filters.filtered` does, and the least head it needs.
MOVING, ADDED, ALL_POLE = 1, 2, 4
LEAST_HEAD = 8
ALWAYS = -1  # the owner of steps that make no free response
Step = tuple[int, int, int, int, int, int, int, int]


@dataclass(frozen=True, eq=False)
class FilteredSignals:
    """Rows, filters and columns of one table's prediction error.

    Attributes:
        degree: free coefficients of each row of the table.
        rows, head: of the workspace, whose first rows are the inputs.
        y, pulse, ones, e: rows of the workspace.
        model: steps from inputs and output to e and the columns of the past.
        past: steps that take a fitted past out of e, parts and rest.
        gradient: steps to the gradient's signals.
        through: steps from inputs, output and a given past to e, the columns of the past and the gradient's signals.
        owners: for each of these the column of the past it serves, or ALWAYS.
        responses: for each column of the past but the constant's the rows that only it needs.
        nuisance, columns: columns of the past, those and the gradient's; the residual's is the last of either.
        states: rows and places of the past's coefficients, for `kernels.table.add_expanded`.
        moves: where a step of the parameters goes, likewise.
        coefficients: the coefficient rows with everything in them but table and past.
    """

    degree: IntArray
    rows: int
    head: int
    y: int
    pulse: int
    ones: int
    e: int
    model: IntArray
    past: IntArray
    gradient: IntArray
    through: IntArray
    owners: IntArray
    responses: tuple[list[int], ...]
    nuisance: IntArray
    columns: IntArray
    states: IntArray
    moves: IntArray
    coefficients: FloatArray

    def with_table(self, table: FloatArray) -> FloatArray:
        """Return the coefficient rows with a table in them and no past."""
        out = self.coefficients.copy()
        width = min(out.shape[1], table.shape[1])
        out[: len(table), :width] = table[:, :width]
        return out

    @property
    def unknown_past(self) -> int:
        """Number of unknown initial conditions, the constant counted."""
        return int(self.states[:, 2].sum())


def signals_of(parameterisation: Parameterisation, free: "np.ndarray[Any, Any]", states: IntArray) -> FilteredSignals:
    """Return the signals of a table of which `free` rows move, with so many unknown initial conditions of each row."""
    return _signals(
        *(tuple(int(k) for k in row) for row in (parameterisation.degree(), parameterisation.lag(), free, states))
    )


@lru_cache(maxsize=256)
def _signals(
    degree: tuple[int, ...], lag: tuple[int, ...], free: tuple[int, ...], states: tuple[int, ...]
) -> FilteredSignals:
    plan = _Plan(degree, lag, free, states)
    plan.model()
    plan.columns_of_the_past()
    plan.gradient()
    return plan.finished()


class _Plan:
    """Hands out rows and writes down steps and columns."""

    def __init__(
        self, degree: tuple[int, ...], lag: tuple[int, ...], free: tuple[int, ...], states: tuple[int, ...]
    ) -> None:
        self.degree, self.lag, self.free, self.counts = degree, lag, free, states
        self.inputs = nu = (len(degree) - ROW_FIRST) // 2
        self.y, self.pulse, self.ones, self.rest, self.e = range(nu, nu + 5)
        self.used = nu + 5
        # Rows of coefficients: the table, those of the past (every F, C, the constant), one and minus one.
        self.plus = len(degree) + nu + 2
        self.minus = self.plus + 1
        self.made: list[Step] = []
        self.fitted: list[Step] = []
        self.slopes: list[Step] = []
        self.through: list[tuple[int, Step]] = []
        self.nuisance: list[tuple[int, int, int, int]] = []
        self.columns: list[tuple[int, int, int, int]] = []

    def new(self) -> int:
        self.used += 1
        return self.used - 1

    def divided(self, steps: list[Step], source: int, row: int) -> int:
        """Return the row of source / P[row]."""
        if self.degree[row] == 0:
            return source
        steps.append((ALL_POLE, source, self.new(), 0, 0, 0, row, self.degree[row]))
        return self.used - 1

    def whitened(self, steps: list[Step], source: int) -> int:
        """Return the row of (D / C) source."""
        c, d = self.degree[ROW_C], self.degree[ROW_D]
        if c == 0 and d == 0:
            return source
        what = (MOVING if d else 0) | (ALL_POLE if c else 0)
        steps.append((what, source, self.new(), ROW_D, d + 1, 0, ROW_C, c))
        return self.used - 1

    def model(self) -> None:
        """Write paths, rest and residual; the free responses of a given past among them for `through`."""
        a, c, d = self.degree[:ROW_FIRST]
        first: list[Step] = [(MOVING, self.y, self.rest, ROW_A, a + 1, 0, 0, 0)]
        self.driven, self.parts = [], []
        for j in range(self.inputs):
            b, f = ROW_FIRST + 2 * j, ROW_FIRST + 2 * j + 1
            self.driven.append(self.divided(first, j, f))
            self.parts.append(self.new())
            first.append((MOVING, self.driven[j], self.parts[j], b, self.degree[b], self.lag[b], 0, 0))
        take = [(ADDED, part, self.rest, self.minus, 1, 0, 0, 0) for part in self.parts]
        self.made = [*first, *take, (MOVING | (ALL_POLE if c else 0), self.rest, self.e, ROW_D, d + 1, 0, ROW_C, c)]
        self.through = [(ALWAYS, step) for step in first]
        for j, part in enumerate(self.parts):
            self.through += [(j, step) for step in self.free_response(j)]
            self.through += [(ALWAYS, (ADDED, part, self.rest, self.minus, 1, 0, 0, 0))]
        if self.counts[-1]:
            self.through.append((ALWAYS, self.constant))
        self.through.append((ALWAYS, (MOVING, self.rest, self.e, ROW_D, d + 1, 0, 0, 0)))
        if self.counts[ROW_C]:
            row = self.past_row(self.inputs)
            self.through.append((self.inputs, (ADDED, self.pulse, self.e, row, self.counts[ROW_C], 0, 0, 0)))
        if c:
            self.through.append((ALWAYS, (ALL_POLE, self.e, self.e, 0, 0, 0, ROW_C, c)))

    def past_row(self, owner: int) -> int:
        return len(self.degree) + owner

    @property
    def constant(self) -> Step:
        return (ADDED, self.ones, self.rest, self.past_row(self.inputs + 1), 1, 0, 0, 0)

    def free_response(self, j: int) -> list[Step]:
        """Return steps that make minus the free response of path j and take it into its part."""
        f = ROW_FIRST + 2 * j + 1
        if not self.counts[f]:
            return []
        out = self.new()
        steps: list[Step] = [
            (MOVING | ALL_POLE, self.pulse, out, self.past_row(j), self.counts[f], 0, f, self.degree[f]),
            (ADDED, out, self.parts[j], self.minus, 1, 0, 0, 0),
        ]
        self.fitted += [*steps, (ADDED, out, self.rest, self.plus, 1, 0, 0, 0)]
        return steps

    def columns_of_the_past(self) -> None:
        """Write the columns of initial conditions (every F, then C) and of the constant, and how they are taken out."""
        counts = [*self.counts[ROW_FIRST + 1 : -1 : 2], self.counts[ROW_C], self.counts[-1]]
        for owner, count in enumerate(counts):
            steps: list[Step] = []
            row = 0
            if count and owner < self.inputs:
                row = self.whitened(steps, self.divided(steps, self.pulse, ROW_FIRST + 1 + 2 * owner))
            elif count and owner == self.inputs:
                row = self.divided(steps, self.pulse, ROW_C)
            elif count:
                row = self.whitened(steps, self.ones)
                self.fitted.append(self.constant)
            self.made += steps
            self.through += [(owner if owner <= self.inputs else ALWAYS, step) for step in steps]
            self.nuisance.append((row, 0, count, 1))
            if count:
                self.fitted.append((ADDED, row, self.e, self.past_row(owner), count, 0, 0, 0))
        self.columns = list(self.nuisance)

    def gradient(self) -> None:
        """Write the filtered signals whose shifts are minus the gradient."""
        for row in gradient_order(len(self.degree)):
            if not self.free[row] or self.degree[row] == 0:
                continue
            j, sign = (row - ROW_FIRST) // 2, 1
            if row == ROW_A:
                signal = self.whitened(self.slopes, self.y)
            elif row == ROW_C:
                signal, sign = self.divided(self.slopes, self.e, ROW_C), -1
            elif row == ROW_D:
                signal = self.divided(self.slopes, self.rest, ROW_C)
            elif (row - ROW_FIRST) % 2 == 0:
                signal, sign = self.whitened(self.slopes, self.driven[j]), -1
            else:
                signal = self.whitened(self.slopes, self.divided(self.slopes, self.parts[j], row))
            self.columns.append((signal, self.lag[row], self.degree[row], sign))
        self.through += [(ALWAYS, step) for step in self.slopes]

    def responses(self, owner: int) -> list[int]:
        """Return the rows of free responses that serve one column of the past."""
        free_rows = [step[2] for who, step in self.through if who == owner]
        return [row for row in {self.nuisance[owner][0], *free_rows} if row not in (*self.parts, self.e)]

    def finished(self) -> FilteredSignals:
        residual = (self.e, 0, 1, 1)
        columns = _table([*self.columns, residual], 4)
        counts = [column[2] for column in self.nuisance]
        width = max(*self.degree, *counts) + 1
        coefficients = np.zeros((self.minus + 1, width))
        coefficients[self.plus, 0], coefficients[self.minus, 0] = 1.0, -1.0
        steps = _table([step for _, step in self.through], 8)
        reach = max(int((columns[:, 1] + columns[:, 2]).max()), int((steps[:, 4] + steps[:, 5]).max()), width)
        moves = [
            (row, int(row < ROW_FIRST or (row - ROW_FIRST) % 2 == 1), self.degree[row])
            for row in gradient_order(len(self.degree))
            if self.free[row] and self.degree[row]
        ]
        return FilteredSignals(
            _table(self.degree),
            self.used,
            reach + LEAST_HEAD,
            self.y,
            self.pulse,
            self.ones,
            self.e,
            _table(self.made, 8),
            _table(self.fitted, 8),
            _table(self.slopes, 8),
            steps,
            _table([owner for owner, _ in self.through]),
            tuple(self.responses(owner) for owner in range(self.inputs + 1)),
            _table([*self.nuisance, residual], 4),
            columns,
            _table([(self.past_row(owner), 0, count) for owner, count in enumerate(counts)], 3),
            _table(moves, 3),
            coefficients,
        )


def _table(rows: Any, width: int = 0) -> IntArray:
    """Return integers as the kernels take them, also when there are none."""
    out = np.array(rows, dtype=np.int64)
    return np.ascontiguousarray(out.reshape(-1, width) if width else out)


def gradient_order(rows: int) -> list[int]:
    """Return the rows of a table in the order of the parameters: a, the b and f of each input, c, d."""
    return [ROW_A, *range(ROW_FIRST, rows), ROW_C, ROW_D]
