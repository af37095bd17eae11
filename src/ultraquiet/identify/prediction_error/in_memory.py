"""Normal equations of a record in memory: past and constant are fitted before the gradient is formed, exactly."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.levenberg_marquardt import FIRST_DAMPING, Ended, minimise
from ultraquiet.identify.prediction_error.signals import FilteredSignals
from ultraquiet.identify.prediction_error.structure import END, GRADIENT, RESIDUAL


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
        if table is self._table:
            return self._loss
        self._table = None
        self._coefficients = self.signals.with_table(table)
        self._known = np.zeros((self.signals.unknown_past,) * 2)
        total, _ = self._evaluated(RESIDUAL, GRADIENT)
        self._table, self._loss = table, total / self.samples
        return self._loss

    def residual(self, table: FloatArray) -> FloatArray:
        """Return the residual of a table."""
        self.loss(table)
        return self._workspace()[self.signals.e, self.signals.head :].copy()

    def normal(self, table: FloatArray) -> FloatArray:
        """Return [J e]'[J e] of a table in the delta basis, past and constant eliminated."""
        self.loss(table)
        return self._evaluated(GRADIENT, END)[1]

    def _evaluated(self, first: int, last: int) -> tuple[float, FloatArray]:
        from ultraquiet.identify.prediction_error.kernels.point import evaluated

        s = self.signals
        return evaluated(
            (first, last),
            (s.model, s.past, s.gradient),
            (s.nuisance, s.nuisance[:0], s.columns),
            s.states,
            self._coefficients,
            self._known,
            self._workspace(),
            s.e,
            s.head,
            s.head + self.samples,
        )

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
