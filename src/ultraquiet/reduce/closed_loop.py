"""Reduction of a controller by what its states do for the closed loop."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, positive, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.linalg import balance
from ultraquiet.reduce import alike
from ultraquiet.reduce._abstract import METHODS, ReductionResult, project, renamed
from ultraquiet.values.generalised import four_block, full, output_shaping
from ultraquiet.values.interconnect import gain, lft
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status

Weights = Mapping[str, StateSpace] | StateSpace | None


@register("reduce", "closed-loop-weighted")
@dataclass(frozen=True)
class ClosedLoopWeighted:
    """Keep the controller states that matter most for the weighted closed loop, and certify the loop they leave.

    F(P, K + dK) - F(P, K) = P12 (I - K P22)^-1 dK (I - P22 K)^-1 P21 to first order: the reduction is weighted by both
    factors. The controllability weight is the covariance of K's state in the loop, the observability weight the energy
    that K's state leaves in the cost of the loop.

    Args:
        states: states to keep, rounded down to a multiple of the copies when the controller is the same law on several
            channels (it stays that); None finds the fewest that cost no more than `loss`.
        loss: relative growth of the closed-loop norm allowed when `states` is None.
        method: `perturbation` (gain at 0 Hz kept) or `truncation`.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> A, B, C = [[0.5, 0.0], [0.0, 0.3]], [[1.0], [1e-4]], [[-1.0, 1e-4]]
    >>> result = ClosedLoopWeighted(states=1).reduce(StateSpace(A, B, C, [[0.0]], rate_hz=100.0), plant)
    >>> result.status.ok, result.controller.states, abs(result.loss) < 1e-6
    (True, 1, True)

    Enns 1984; Anderson and Liu 1989, doi:10.1109/9.29422; Wortelboer 1994.
    """

    states: int | None = 36
    loss: float = 0.05
    method: str = "perturbation"

    def __post_init__(self) -> None:
        if self.states is not None:
            whole("ClosedLoopWeighted", "states", self.states, 0)
        positive("ClosedLoopWeighted", "loss", self.loss)
        one_of("ClosedLoopWeighted", "method", self.method, METHODS)

    @single_threaded
    def reduce(self, controller: StateSpace, plant: StateSpace, weights: Weights = None) -> ReductionResult:
        """Return the reduced controller with the norms of the loop before and after.

        Args:
            controller: K, u = K y.
            plant: G.
            weights: what the loop is judged by: the mapping `details["weights"]` of a design (`performance`, `control`
                and perhaps `complementary`); one weight on the plant's outputs; a whole generalised plant; or None for
                the bare four-block cost.

        Returns:
            A `ReductionResult`; its status is `unstable` when the loop is not stable with so few states.

        Raises:
            InputError: the loop with the full controller is not stable, or the weights do not fit.
        """
        P = judging_plant(plant, weights)
        loop = lft(P, controller)
        if not loop.is_stable():
            raise InputError("ClosedLoopWeighted: the loop with the full controller is unstable; nothing can be kept.")
        pairs = _gramian_pairs(P, controller, loop)
        before = hinf_norm(loop)[0]
        count = self._fewest(P, controller, pairs, before) if self.states is None else self.states
        small, hankel, after = _best(P, controller, pairs, count, self.method)
        settings = {"states": self.states, "loss": self.loss, "method": self.method}
        made = Provenance("ClosedLoopWeighted", settings, parents=(controller.hash, plant.hash), versions=versions())
        result = renamed((small.A, small.B, small.C, small.D), controller, made)
        poles = lft(P, small).poles()
        return ReductionResult(
            _verdict(controller, small, before, after), result, hankel, before, after, {"poles": poles}, made
        )

    def _fewest(self, P: StateSpace, K: StateSpace, pairs: "Pairs", before: float) -> int:
        """Return the fewest states within the allowed loss, by bisection (the loss falls with the states, nearly)."""
        low, high = 0, K.states
        while high - low > 1:
            middle = (low + high) // 2
            if _best(P, K, pairs, middle, self.method)[2] <= before * (1 + self.loss):
                high = middle
            else:
                low = middle
        return high


Pairs = list[tuple[FloatArray, FloatArray]]


def judging_plant(plant: StateSpace, weights: Weights) -> StateSpace:
    """Return the generalised plant by which a loop is judged."""
    ny, nu = plant.D.shape
    one = gain(np.eye(1), plant.rate_hz)
    if isinstance(weights, Mapping):
        third = weights.get("complementary")
        return output_shaping(
            plant,
            full(weights["performance"], ny, "performance"),
            full(weights.get("control", one), nu, "control"),
            None if third is None else full(third, ny, "complementary"),
        )
    if weights is not None and weights.D.shape[0] > ny and weights.D.shape[1] > nu:
        return weights
    on_output = full(weights if weights is not None else one, ny, "weights")
    return four_block(plant, on_output, full(one, nu, "control"), np.eye(nu), np.eye(ny))


def _gramian_pairs(P: StateSpace, K: StateSpace, loop: StateSpace) -> Pairs:
    """Return pairs of Gramians of K's state: inside the loop, and Enns's cascade where K is stable by itself."""
    n = P.states
    discrete = P.rate_hz is not None
    Pc, Qo = balance.gramians(loop.A, loop.B, loop.C, discrete)
    pairs = [(Pc[n:, n:], Qo[n:, n:])]
    if K.is_stable():
        cascade = _output_cascade(P, K)
        Q = balance.gramians(cascade.A, cascade.B, cascade.C, discrete)[1]
        pairs.append((Pc[n:, n:], Q[: K.states, : K.states]))
    return pairs


def _output_cascade(P: StateSpace, K: StateSpace) -> StateSpace:
    """Return K followed by P12 (I - K P22)^-1, the way from a change of K to the cost."""
    nu, ny = K.D.shape
    p = P.D.shape[0] - ny
    outer = StateSpace(
        P.A,
        np.hstack([P.B[:, -nu:], P.B[:, -nu:]]),
        P.C,
        np.hstack([P.D[:, -nu:], P.D[:, -nu:]]),
        P.rate_hz,
    )
    after = lft(outer, K)
    A = np.block([[K.A, np.zeros((K.states, after.states))], [after.B @ K.C, after.A]])
    B = np.vstack([K.B, after.B @ K.D])
    C = np.hstack([after.D @ K.C, after.C])
    return StateSpace(A, B, C, np.zeros((p, ny)), P.rate_hz)


def _best(P: StateSpace, K: StateSpace, pairs: Pairs, count: int, method: str) -> tuple[StateSpace, FloatArray, float]:
    """Reduce by every pair and return the controller with the smallest closed-loop norm, its Hankel values and norm."""
    tries = []
    K, copies = alike.one_of_many(K)
    count //= copies
    for Pc, Qo in (tuple(alike.averaged(W, copies) for W in pair) for pair in pairs):
        for way in dict.fromkeys((method, "truncation")):
            try:
                M, hankel = project((K.A, K.B, K.C, K.D), Pc, Qo, count, P.rate_hz is not None, way)
                small = StateSpace(*M, rate_hz=K.rate_hz)
                small = alike.joined(small, copies)
                tries.append((small, hankel, hinf_norm(lft(P, small), tolerance=1e-4)[0]))
            except (np.linalg.LinAlgError, InputError, NumericalError):
                continue
    if not tries:
        raise NumericalError(f"ClosedLoopWeighted: no projection to {count} states could be formed; keep more states.")
    return min(tries, key=lambda t: t[2])


def _verdict(full_size: StateSpace, small: StateSpace, before: float, after: float) -> Status:
    kept = f"{small.states} of {full_size.states} states kept"
    if not np.isfinite(after):
        return Status("unstable", f"{kept}; the loop is unstable with so few, keep more.")
    return Status("ok", f"{kept}; the loop is stable, its weighted norm moves from {before:.4g} to {after:.4g}.")
