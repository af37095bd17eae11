"""What every reduction returns, and the projection they share."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import NumericalError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown import Shown
from ultraquiet.linalg import balance
from ultraquiet.linalg.even import even_states
from ultraquiet.linalg.ordered import Matrices, real_schur_values
from ultraquiet.reduce.promises import Delivered
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status

METHODS = ("truncation", "perturbation")
FAITHFUL = 0.01  # of the largest Hankel value: what the error of a reduction without a number of states may come to
Weights = Mapping[str, StateSpace] | StateSpace | None


@dataclass(frozen=True, eq=False)
class ReductionResult(Shown):
    """The outcome of a reduction.

    Attributes:
        status: `ok` when the loop is stable with the reduced system (or when no loop was asked for), no more was lost
            than allowed and what the law did for it is kept; else `unstable` or `loss`. Without a loop, `unstable`
            where a stable part became unstable.
        controller: the reduced system.
        hankel: the (weighted) Hankel values by which states were kept, largest first.
        cost_before: closed-loop norm with the full controller; nan where no loop was given.
        cost_after: the same with the reduced one, computed again from the finished controller.
        details: everything else, by name; `certificate` holds `stable`, `norm`, `before`, `after`, `loss_percent`,
            `allowed_percent`, `states`, `multiply_adds` and `budget`.
        before, after: what the full and the reduced law deliver (peak, worst direction in the band, tones, margins);
            None without a plant, or without a loop that both of them hold.
        broken: a phrase for each of them of which the reduced law loses more than is allowed.
        provenance: settings and parents.
    """

    status: Status
    controller: StateSpace
    hankel: FloatArray
    cost_before: float = float("nan")
    cost_after: float = float("nan")
    details: Mapping[str, Any] = field(default_factory=dict)
    before: Delivered | None = None
    after: Delivered | None = None
    broken: tuple[str, ...] = ()
    provenance: Provenance = field(default_factory=Provenance)

    @property
    def loss(self) -> float:
        """Relative growth of the closed-loop norm."""
        return self.cost_after / self.cost_before - 1 if self.cost_before else 0.0

    @property
    def bound(self) -> float | None:
        """What the error's H-infinity norm cannot exceed, where the method promises that of the controller alone."""
        return self.details.get("bound")


class StableSplit(NamedTuple):
    """A system split in two: matrices to be reduced, A, B, C of the part that is kept, and the first one's states.

    `rows` makes the states of the first part out of those of the system.
    """

    reducible: Matrices
    kept: tuple[FloatArray, FloatArray, FloatArray]
    rows: FloatArray


def split(system: StateSpace, slowest_hz: float = 0.0) -> StableSplit:
    """Split off the part that is unstable, integrates, or decays slower than exp(-2 pi slowest_hz t).

    Raises:
        NumericalError: poles too near to the border to be told apart.
    """
    decay = 2 * np.pi * slowest_hz
    rate_hz, n = system.rate_hz, system.states
    # orthogonal transformations keep the digits of large states only: all are made alike first
    A, B, C, d = even_states(system.A, system.B, system.C)
    # the border of decay becomes the border of stability
    shifted = A * np.exp(decay / rate_hz) if rate_hz else A + decay * np.eye(n)
    form, U, poles = real_schur_values(shifted) if n else (shifted, shifted, np.zeros(0, complex))
    stable = balance.inside(shifted, rate_hz is not None, balance.BOUNDARY)
    if all(stable(z.real, z.imag) for z in poles.tolist()):
        # nothing to split off, and the form spares the Gramians another one
        form = form / np.exp(decay / rate_hz) if rate_hz else form - decay * np.eye(n)
        nothing = (np.zeros((0, 0)), np.zeros((0, B.shape[1])), np.zeros((C.shape[0], 0)))
        return StableSplit((form, U.T @ B, C @ U, system.D), nothing, U.T / d)
    T, inverse, count = balance.stable_first(shifted, rate_hz is not None, balance.BOUNDARY)
    A, B, C = inverse @ A @ T, inverse @ B, C @ T
    reducible = (A[:count, :count], B[:count], C[:, :count], system.D)
    return StableSplit(reducible, (A[count:, count:], B[count:], C[:, count:]), inverse[:count] / d)


def joined(reduced: Matrices, kept: tuple[FloatArray, FloatArray, FloatArray]) -> Matrices:
    """Return the reduced part and the kept one side by side."""
    a, b, c, d = reduced
    if not kept[0].shape[0]:
        return reduced
    whole = np.asarray(block_diag(a, kept[0])) if a.shape[0] else kept[0]
    return whole, np.vstack([b, kept[1]]), np.hstack([c, kept[2]]), d


def counted(states: int | None, kept: int, part: int, hankel: Callable[[], FloatArray]) -> int:
    """Return how many states of a part are to stay.

    Args:
        states: asked for in all; None for the fewest that leave out no more than `FAITHFUL` of the largest Hankel
            value, as twice the sum of those left out, the usual bound on the error.
        kept: of another part, which stays anyway.
        part: states there are.
        hankel: gives their Hankel values, largest first.
    """
    if states is not None:
        return max(0, min(states - kept, part))
    values = hankel()[:part]
    left_out = 2 * np.cumsum(values[::-1])[::-1]
    return int(np.count_nonzero(left_out > FAITHFUL * values.max(initial=0.0)))


def project(
    M: Matrices, P: FloatArray, Q: FloatArray, order: int, discrete: bool, method: str
) -> tuple[Matrices, FloatArray]:
    """Reduce by the Gramians P and Q; return the reduced system and the Hankel values.

    `truncation` drops the other states, `perturbation` replaces them by their steady state, which keeps the gain at
    0 Hz (Liu and Anderson 1989, doi:10.1080/00207178908953437).

    Raises:
        NumericalError: the states to be left out have no steady state.
    """
    left, right, values = balance.balancing(P, Q, order)
    if method == "truncation" or left.shape[0] == M[0].shape[0]:
        return balance.truncate(M, left, right), values
    # the states left out: the null space of `left`, and that of `right` transposed made its dual
    beside = _null(left)
    try:
        dual = np.linalg.solve(_null(right.T).T @ beside, _null(right.T).T)
        T, inverse = np.hstack([right, beside]), np.vstack([left, dual])
        whole = (inverse @ M[0] @ T, inverse @ M[1], M[2] @ T, M[3])
        return balance.residualize(whole, left.shape[0], discrete), values
    except np.linalg.LinAlgError:
        raise NumericalError(
            "reduce: the states to be left out have no steady state; take method='truncation' or keep more states."
        ) from None


def renamed(M: Matrices, like: StateSpace, provenance: Provenance) -> StateSpace:
    """Return a system with the rate and channels of another."""
    return StateSpace(*M, like.rate_hz, like.actuators, like.sensors, provenance)


def _null(M: FloatArray) -> FloatArray:
    return np.linalg.svd(M)[2][M.shape[0] :].T
