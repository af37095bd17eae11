"""What every reduction returns, and the projection they share."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.provenance import Provenance
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status

METHODS = ("truncation", "perturbation")


@dataclass(frozen=True, eq=False)
class ReductionResult:
    """The outcome of a reduction.

    Attributes:
        status: `ok` when the loop is stable with the reduced system (or when no loop was asked for).
        controller: the reduced system.
        hankel: the (weighted) Hankel values by which states were kept, largest first.
        cost_before: closed-loop norm with the full controller; nan where no loop was given.
        cost_after: the same with the reduced one.
        details: everything else, by name.
        provenance: settings and parents.
    """

    status: Status
    controller: StateSpace
    hankel: FloatArray
    cost_before: float = float("nan")
    cost_after: float = float("nan")
    details: Mapping[str, Any] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)

    @property
    def loss(self) -> float:
        """Relative growth of the closed-loop norm."""
        return self.cost_after / self.cost_before - 1


def project(
    M: Matrices, P: FloatArray, Q: FloatArray, order: int, discrete: bool, method: str
) -> tuple[Matrices, FloatArray]:
    """Reduce by the Gramians P and Q; return the reduced system and the Hankel values.

    `truncation` drops the other states, `perturbation` replaces them by their steady state, which keeps the gain at
    0 Hz (Liu and Anderson 1989, doi:10.1080/00207178908953437).
    """
    left, right, values = balance.balancing(P, Q, order)
    if method == "truncation" or left.shape[0] in {0, M[0].shape[0]}:
        return balance.truncate(M, left, right), values
    # the states left out: the null space of `left`, and that of `right` transposed made its dual
    beside = _null(left)
    dual = np.linalg.solve(_null(right.T).T @ beside, _null(right.T).T)
    T, inverse = np.hstack([right, beside]), np.vstack([left, dual])
    whole = (inverse @ M[0] @ T, inverse @ M[1], M[2] @ T, M[3])
    return balance.residualize(whole, left.shape[0], discrete), values


def renamed(M: Matrices, like: StateSpace, made: Provenance) -> StateSpace:
    """Return a system with the rate and channels of another."""
    return StateSpace(*M, like.rate_hz, like.actuators, like.sensors, made)


def _null(M: FloatArray) -> FloatArray:
    return np.linalg.svd(M)[2][M.shape[0] :].T
