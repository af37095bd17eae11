"""Searches of a record in memory: past and constant are fitted before the gradient is formed, exactly."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.damping_policy import FIRST_DAMPING
from ultraquiet.identify.prediction_error.signals import FilteredSignals
from ultraquiet.identify.prediction_error.structure import GRADIENT, RESIDUAL


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
        if table is not self._table:
            self._searched(RESIDUAL, table, -1)
        return self._loss

    def residual(self, table: FloatArray) -> FloatArray:
        """Return the residual of a table."""
        self.loss(table)
        return self._workspace()[self.signals.e, self.signals.head :].copy()

    def normal(self, table: FloatArray) -> FloatArray:
        """Return [J e]'[J e] of a table in the delta basis, past and constant eliminated."""
        self.loss(table)
        return self._searched(GRADIENT, table, 0).normal

    def search(
        self, start: FloatArray, steps: int, tolerance: float, damping: float = FIRST_DAMPING
    ) -> "InMemoryMinimum":
        """Search from a table until no step promises to lower the loss or `steps` are used up.

        `levenberg_marquardt.minimise` of this record's loss, compiled.
        """
        return self._searched(RESIDUAL, start, steps, tolerance, damping)

    def _searched(
        self, first: int, table: FloatArray, most: int, tolerance: float = 0.0, damping: float = FIRST_DAMPING
    ) -> "InMemoryMinimum":
        """Search from a table; of fewer steps than none, have its loss alone."""
        from ultraquiet.identify.prediction_error.kernels.point import searched

        s = self.signals
        if first == RESIDUAL:
            self._coefficients, self._known = s.coefficients.copy(), np.zeros((s.unknown_past,) * 2)
        reached = table.copy()
        loss, normal, iterations, state, stage = searched(
            first,
            (s.model, s.past, s.gradient),
            (s.nuisance, s.nuisance[:0], s.columns),
            (s.states, s.moves),
            s.degree,
            self._coefficients,
            self._known,
            self._workspace(),
            s.e,
            (s.head, s.head + self.samples),
            reached,
            self._loss,
            most,
            tolerance,
            damping,
        )
        last = reached if iterations else table
        self._table, self._loss = last if stage == GRADIENT else None, loss
        return InMemoryMinimum(last, loss, normal, iterations, state)

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
class InMemoryMinimum:
    """Where a search ended: see `levenberg_marquardt.Ended`. The loss is the mean square of the residual."""

    table: FloatArray
    loss: float
    normal: FloatArray
    iterations: int
    state: int
