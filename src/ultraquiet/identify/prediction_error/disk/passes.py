"""Passes over a record longer than memory: residual, gradient and products of one output, block by block."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.progress import task
from ultraquiet.files import LongRecord
from ultraquiet.identify.long_record_statistics import LongRecordStatistics
from ultraquiet.identify.prediction_error.in_memory import moved
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.signals import FilteredSignals, signals_of
from ultraquiet.identify.prediction_error.structure import (
    ROW_A,
    ROW_C,
    ROW_D,
    Structure,
    b_rows,
    f_rows,
    free_rows,
)

# Samples filtered at once: what all their signals take stays within the cache.
CELL = 4096
GONE = 1e-18  # a free response that has decayed to this share of its peak adds nothing more to any sum

Watch = Callable[[FloatArray, FloatArray, FloatArray], None]


class Stream:
    """One output of a long record with its inputs, each scaled to unit deviation as it is read."""

    def __init__(self, record: LongRecord, output: int, seen: LongRecordStatistics) -> None:
        self.record = record.pick(outputs=[output])
        self.input_size = seen.input_size
        self.output_size = float(seen.output_size[output])
        self.gain = self.output_size / self.input_size
        self.passes = 0

    def products(
        self,
        table: FloatArray,
        x: FloatArray,
        signals: FilteredSignals,
        title: str,
        watch: Watch | None = None,
        color: FloatArray | None = None,
    ) -> FloatArray:
        """Return the products of nuisance, gradient and residual columns at (table, x).

        `watch` is handed inputs, output and residual of every block; with a polynomial `color` inputs and output are
        filtered by its inverse first.
        """
        from scipy.signal import lfilter

        run = Pass(signals, table, x)
        scale_u, scale_y = 1.0 / self.input_size[:, None], 1.0 / self.output_size
        state = np.zeros((self.input_size.size + 1, 0 if color is None else color.size - 1))
        self.passes += 1
        with task(f"{title}, pass {self.passes}", self.record.samples) as progress:
            for inputs, outputs in self.record.blocks():
                u, y = inputs * scale_u, outputs[0] * scale_y
                if color is not None:
                    both, state = lfilter([1.0], color, np.vstack([u, y]), axis=1, zi=state)
                    u, y = np.ascontiguousarray(both[:-1]), np.ascontiguousarray(both[-1])
                e = run.add(u, y)
                if watch is not None:
                    watch(u, y, e)
                progress.advance(y.size)
        return run.products()


class Pass:
    """One pass over a record in pieces: every signal keeps the end of the piece before in front of it.

    The past before the record is not projected out of each signal, which would need the record twice: it is a vector x
    of unknowns, given, whose columns enter the products beside the gradient's.
    """

    def __init__(self, signals: FilteredSignals, table: FloatArray, x: FloatArray) -> None:
        from ultraquiet.identify.prediction_error.kernels.table import add_expanded

        self._signals = signals
        self._coefficients = signals.with_table(table)
        add_expanded(x, -1.0, signals.states, self._coefficients)
        self._work = np.zeros((signals.rows, signals.head + CELL))
        self._used = 0
        self._begun = False
        nuisance = len(signals.nuisance) - 1
        self._peak = np.zeros(nuisance)
        self._alive = signals.nuisance[:-1, 2] > 0
        width = int(signals.columns[:, 2].sum())
        self._sum = np.zeros((width, width))
        self._choose()

    def _choose(self) -> None:
        """Take up the steps and columns that still matter."""
        s, dead = self._signals, np.flatnonzero(~self._alive)
        self._steps = np.ascontiguousarray(s.through[~np.isin(s.owners, dead)])
        self._columns = s.columns.copy()
        self._columns[dead, 2] = 0
        self._index = np.flatnonzero(~np.isin(np.repeat(np.arange(len(s.columns)), s.columns[:, 2]), dead))
        self._live = np.zeros((self._index.size, self._index.size))

    def add(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Filter the next piece, add its products and return its residual."""
        from ultraquiet.identify.prediction_error.kernels import filters, normal_equations

        s, work, e = self._signals, self._work, np.empty(y.size)
        for start in range(0, y.size, CELL):
            stop = min(y.size, start + CELL)
            work[:, : s.head] = work[:, self._used : self._used + s.head]
            self._used = stop - start
            end = s.head + self._used
            work[: len(u), s.head : end], work[s.y, s.head : end] = u[:, start:stop], y[start:stop]
            work[s.pulse, s.head : end], work[s.ones, s.head : end] = 0.0, 1.0
            work[s.pulse, s.head] = 0.0 if self._begun else 1.0
            self._begun = True
            filters.filtered(self._steps, self._coefficients, work, s.head, end)
            normal_equations.add_products(work, self._columns, 0, s.head, end, self._live)
            e[start:stop] = work[s.e, s.head : end]
            self._fade(end)
        return e

    def _fade(self, end: int) -> None:
        """Drop free responses once all that filters and columns still reach of them has decayed."""
        s, before = self._signals, self._alive.copy()
        for owner in np.flatnonzero(self._alive[:-1]):
            rows = s.responses[owner]
            self._peak[owner] = max(self._peak[owner], np.abs(self._work[rows, s.head : end]).max())
            self._alive[owner] = np.abs(self._work[rows, end - s.head : end]).max() >= GONE * self._peak[owner]
        if not np.array_equal(before, self._alive):
            self._keep()
            self._choose()

    def _keep(self) -> None:
        self._sum[np.ix_(self._index, self._index)] += self._live

    def products(self) -> FloatArray:
        """Return the products of all pieces, and begin anew."""
        self._keep()
        self._live[:] = 0.0
        return self._sum


@dataclass(frozen=True, eq=False)
class LongRecordPoint:
    """A table and the unknown past, their products, and the loss with the best past."""

    data: Stream
    signals: FilteredSignals
    title: str
    table: FloatArray
    x: FloatArray
    G: FloatArray
    reduced: FloatArray
    criterion: float

    @classmethod
    def of(
        cls, data: Stream, signals: FilteredSignals, title: str, table: FloatArray, x: FloatArray | None = None
    ) -> "LongRecordPoint":
        """Return the point of a table and a past, from one pass; given none, with the best, from two.

        The gradient beside another past than the best is not that of the loss: by it no step need gain anything.
        """
        if x is None:
            x = cls.of(data, signals, title, table, np.zeros(signals.unknown_past)).past()
        from ultraquiet.identify.prediction_error.kernels.normal_equations import reduced

        G = data.products(table, x, signals, title)
        S = reduced(G, x.size)
        return cls(data, signals, title, table, x, G, S, float(S[-1, -1]) / data.record.samples)

    @property
    def unit(self) -> float:
        """The innovation's variance."""
        return self.criterion

    def normal(self) -> FloatArray:
        """Return [J e]'[J e]."""
        return self.reduced

    def moved(self, step: FloatArray) -> "LongRecordPoint | None":
        """Return the point a step leads to, the past moved along."""
        table = moved(self.signals, self.table, step)
        return None if table is None else self.of(self.data, self.signals, self.title, table, self.past(step))

    def gained(self, other: "LongRecordPoint") -> float:
        """Return how much smaller the sum of squares is there."""
        return self.data.record.samples * (self.criterion - other.criterion)

    def past(self, step: FloatArray | None = None) -> FloatArray:
        """Return the past that goes best with the table after a step of the parameters."""
        from ultraquiet.identify.prediction_error.kernels.normal_equations import RIDGE

        G, q = self.G, self.x.size
        scale = np.where(np.diag(G) > 0.0, 1.0 / np.sqrt(np.maximum(np.diag(G), np.finfo(float).tiny)), 1.0)
        M = G * np.outer(scale, scale)
        right = M[:q, -1] if step is None else M[:q, -1] + M[:q, q:-1] @ (step * scale[-1] / scale[q:-1])
        return self.x + np.linalg.solve(M[:q, :q] + np.sqrt(RIDGE) * np.eye(q), right) * scale[:q] / scale[-1]


def signals_through(
    structure: Structure, nu: int, fitted: tuple[bool, bool], free: Sequence[int] | None = None
) -> FilteredSignals:
    """Return the signals of a structure, by default with every row free."""
    rows = [ROW_A, *b_rows(nu), *f_rows(nu), ROW_C, ROW_D] if free is None else free
    parameterisation = Parameterisation.alike(structure, nu)
    return signals_of(parameterisation, free_rows(nu, rows), parameterisation.states(*fitted))
