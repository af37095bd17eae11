"""Normal equations of a record in memory: past and constant are fitted before the gradient is formed, exactly."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.levenberg_marquardt import FIRST_DAMPING, Ended, minimise
from ultraquiet.identify.prediction_error.signals import FilteredSignals


class InMemory:
    """One output of a record with its inputs and the workspace in which its residual and products are formed.

    The workspace holds the signals of the table seen last; asked for another one's, they are formed again.
    """

    def __init__(self, u: FloatArray, y: FloatArray, signals: FilteredSignals) -> None:
        self.samples, self.signals = y.size, signals
        self._u, self._y = u, y
        self._work: FloatArray | None = None
        self._table: FloatArray | None = None
        self._loss, self._known = np.nan, np.zeros((0, 0))

    @property
    def bytes(self) -> int:
        """Size of the workspace."""
        return 8 * self.signals.rows * (self.signals.head + self.samples)

    def release(self) -> None:
        """Give the workspace back."""
        self._work = self._table = None

    def loss(self, table: FloatArray) -> float:
        """Return the mean square of the residual of a table, past and constant fitted."""
        from ultraquiet.identify.prediction_error.kernels.filters import filtered
        from ultraquiet.identify.prediction_error.kernels.normal_equations import add_products, damped_step
        from ultraquiet.identify.prediction_error.kernels.table import add_expanded

        if table is self._table:
            return self._loss
        self._table = None
        s, work = self.signals, self._workspace()
        first, stop = s.head, s.head + self.samples
        coefficients = s.with_table(table)
        filtered(s.model, coefficients, work, first, stop)
        q = s.unknown_past
        if q:
            G = np.zeros((q + 1, q + 1))
            add_products(work, s.nuisance, 0, first, stop, G)
            self._known = G[:q, :q]
            x, _ = damped_step(G, 0.0)
            add_expanded(x, 1.0, s.states, coefficients)
            filtered(s.past, coefficients, work, first, stop)
        e = work[s.e, first:]
        self._coefficients, self._table, self._loss = coefficients, table, float(np.dot(e, e) / self.samples)
        return self._loss

    def residual(self, table: FloatArray) -> FloatArray:
        """Return the residual of a table."""
        self.loss(table)
        return self._workspace()[self.signals.e, self.signals.head :].copy()

    def normal(self, table: FloatArray) -> FloatArray:
        """Return [J e]'[J e] of a table in the delta basis, past and constant eliminated."""
        from ultraquiet.identify.prediction_error.kernels.filters import filtered
        from ultraquiet.identify.prediction_error.kernels.normal_equations import add_products, reduced

        self.loss(table)
        s, work = self.signals, self._workspace()
        first, stop, q = s.head, s.head + self.samples, s.unknown_past
        filtered(s.gradient, self._coefficients, work, first, stop)
        width = int(s.columns[:, 2].sum())
        G = np.zeros((width, width))
        G[:q, :q] = self._known
        add_products(work, s.columns, q, first, stop, G)
        return reduced(G, q)

    def _workspace(self) -> FloatArray:
        if self._work is None:
            s = self.signals
            self._work = np.zeros((s.rows, s.head + self.samples))
            self._work[: len(self._u), s.head :] = self._u
            self._work[s.y, s.head :] = self._y
            self._work[s.pulse, s.head] = 1.0
            self._work[s.ones, s.head :] = 1.0
        return self._work


def moved(signals: FilteredSignals, table: FloatArray, step: FloatArray) -> FloatArray | None:
    """Return a table after a step in the delta basis; None when it is not admissible."""
    from ultraquiet.identify.prediction_error.kernels.table import add_expanded, admissible

    out = table.copy()
    add_expanded(step, 1.0, signals.moves, out)
    return out if admissible(out, signals.degree) else None


@dataclass(frozen=True, eq=False)
class InMemoryPoint:
    """A table and its loss, the mean square of the residual."""

    data: InMemory
    table: FloatArray
    criterion: float

    @classmethod
    def of(cls, data: InMemory, table: FloatArray) -> "InMemoryPoint":
        """Return the point of a table."""
        return cls(data, table, data.loss(table))

    @property
    def unit(self) -> float:
        """The innovation's variance."""
        return self.criterion

    def normal(self) -> FloatArray:
        """Return [J e]'[J e]."""
        return self.data.normal(self.table)

    def moved(self, step: FloatArray) -> "InMemoryPoint | None":
        """Return the point a step leads to."""
        table = moved(self.data.signals, self.table, step)
        return None if table is None else InMemoryPoint.of(self.data, table)

    def gained(self, other: "InMemoryPoint") -> float:
        """Return how much smaller the sum of squares is there."""
        return self.data.samples * (self.criterion - other.criterion)


def search(
    data: InMemory, start: FloatArray, steps: int, tolerance: float, damping: float = FIRST_DAMPING
) -> "Ended[InMemoryPoint]":
    """Minimise the mean square of the residual from a table."""
    return minimise(InMemoryPoint.of(data, start.copy()), steps, tolerance, damping)
