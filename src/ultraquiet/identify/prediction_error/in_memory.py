"""Searches of a record in memory: past and constant are fitted before the gradient is formed, exactly."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.damping_policy import FIRST_DAMPING, RUNNING
from ultraquiet.identify.prediction_error.signals import FilteredSignals
from ultraquiet.identify.prediction_error.structure import GRADIENT, RESIDUAL

LOSS_ALONE = -1  # steps of a search that ends with the loss of its start
SAMPLES_AT_ONCE = 1 << 20  # times steps of one compiled call: a second or so, which an interrupt waits for


class InMemory:
    """One output of a record with its inputs and the workspace in which its residual and products are formed.

    The workspace holds the signals of the table seen last; asked for another one's, they are formed again.
    """

    def __init__(self, u: FloatArray, y: FloatArray, signals: FilteredSignals) -> None:
        self.samples, self.signals = y.size, signals
        self._u, self._y = u, y
        self._work: FloatArray | None = None
        self._table: FloatArray | None = None
        self._rows, self._known = signals.coefficients.copy(), np.zeros((signals.unknown_past,) * 2)
        self._so_far = np.nan, FIRST_DAMPING, 0  # loss, damping, steps in a row that gained little

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
            self._searched(RESIDUAL, table.copy(), LOSS_ALONE)
            self._table = table
        return self._so_far[0]

    def residual(self, table: FloatArray) -> FloatArray:
        """Return the residual of a table."""
        self.loss(table)
        return self._workspace()[self.signals.e, self.signals.head :].copy()

    def normal(self, table: FloatArray) -> FloatArray:
        """Return [J e]'[J e] of a table in the delta basis, past and constant eliminated."""
        self.loss(table)
        normal, _, _ = self._searched(GRADIENT, table.copy(), 0)
        self._table = table
        return normal

    def search(
        self, start: FloatArray, steps: int, tolerance: float, damping: float = FIRST_DAMPING
    ) -> "InMemoryMinimum":
        """Search from a table until no step promises to lower the loss or `steps` are used up.

        `levenberg_marquardt.minimise` of this record's loss, compiled; a call of it ends soon, for nothing stops it.
        """
        table, stage, iterations, at_once = start.copy(), RESIDUAL, 0, max(4, SAMPLES_AT_ONCE // self.samples)
        self._so_far = np.nan, damping, 0
        while True:
            normal, more, state = self._searched(stage, table, min(at_once, steps - iterations), tolerance)
            stage, iterations = GRADIENT, iterations + more
            if state != RUNNING or iterations >= steps:
                return InMemoryMinimum(table, self._so_far[0], normal, iterations, state)

    def _searched(
        self, first: int, table: FloatArray, most: int, tolerance: float = 0.0
    ) -> tuple[FloatArray, int, int]:
        """Move a table to the end of a search of at most so many steps; return normal matrix, iterations and state."""
        from ultraquiet.identify.prediction_error.kernels.point import searched

        s, self._table = self.signals, None
        self._so_far, normal, iterations, state, stage = searched(
            first,
            (s.model, s.past, s.gradient),
            (s.nuisance, s.nuisance[:0], s.columns),
            (s.states, s.moves),
            s.degree,
            s.coefficients,
            self._rows,
            self._known,
            self._workspace(),
            s.e,
            (s.head, s.head + self.samples),
            table,
            self._so_far,
            most,
            tolerance,
        )
        self._table = table if stage == GRADIENT else None
        return normal, iterations, state

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
