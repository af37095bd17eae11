"""Reduction of a controller by what its states do for the closed loop."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np

from ultraquiet._base.constraints import frequency_array, one_of, positive, rising_band, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.linalg.cost import largest_order, multiply_adds
from ultraquiet.reduce._abstract import METHODS, ReductionResult, Weights, renamed
from ultraquiet.reduce.candidates import Candidates, ReducedLaw
from ultraquiet.reduce.certificate import NORMS, certified, fits, held, judging_plant
from ultraquiet.reduce.promises import LOSS_DB, Judge, Promise
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

# Numbers in a law, up to which descents are sent off from projections that lose the loop, most of them in vain: of
# twice as many each takes a quarter of a minute.
TUNABLE = 4000
NEAR = 60  # of a law's states: how closely the number that would be enough is told
STEPS_UP = 20  # of the states, at most, from the fewest that keep the peak, band and tones to those that keep margins


@register("reduce", "closed-loop-weighted")
@dataclass(frozen=True)
class ClosedLoopWeighted:
    """Keep the controller states that matter most for the weighted closed loop, and certify the loop they leave.

    F(P, K + dK) - F(P, K) = P12 (I - K P22)^-1 dK (I - P22 K)^-1 P21 to first order: the reduction is weighted by both
    factors. The controllability weight is the covariance of K's state in the loop, the observability weight the energy
    that K's state leaves in the cost of the loop. Where that costs more than `loss`, or the loop itself, the reduced
    controller's parameters are moved downhill, first on this error, then on the norm of the loop. Where the loop is
    lost all the same, states leave a few at a time, weighted anew by the loop with the law so far.

    Args:
        states: states to keep, rounded down to a multiple of the copies when the controller is the same law on several
            channels (it stays that). None leaves the order to `budget` and `loss`.
        budget: multiply-adds that a step of the law may cost, n (ny + nu + 2) + ny nu in modal form: the largest order
            within it is taken, or with `loss` the smallest that keeps the loss, and that must fit.
        loss: relative growth of the closed-loop norm allowed. Alone it finds the fewest states. A result that costs
            more has the status `loss`.
        loss_db: what may be lost, in dB, of the peak of S, of the worst direction over the band and at each tone, and
            come to the largest gain of K S; a tenth of the disk margins at both ends may go with it. Without `states`,
            `budget` and `loss` it finds the fewest states. A result that loses more of
            what the full law does has the status `loss`.
        band_hz, tones_hz: where; as the law's own design states it when absent, and without a statement the band is
            where the loop quietens every direction by half of what it reaches at best, in dB.
        method: `perturbation` (gain at 0 Hz kept) or `truncation`, whichever is tried first.
        norm: `peak` (H-infinity) or `mean-square` (H2, what LQG minimises).
        steps: most steps of each descent; 0 leaves the projection as it is.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> A, B, C = [[0.5, 0.0], [0.0, 0.3]], [[1.0], [1e-4]], [[-1.0, 1e-4]]
    >>> result = ClosedLoopWeighted(states=1).reduce(StateSpace(A, B, C, [[0.0]], rate_hz=100.0), plant)
    >>> result.status.ok, result.controller.states, abs(result.loss) < 1e-6
    (True, 1, True)

    Enns 1984; Anderson and Liu 1989, doi:10.1109/9.29422; Wortelboer 1994.
    """

    states: int | None = None
    budget: int | None = None
    loss: float | None = None
    loss_db: float = LOSS_DB
    band_hz: tuple[float, float] | None = None
    tones_hz: tuple[float, ...] = ()
    method: str = "perturbation"
    norm: str = "peak"
    steps: int = 150

    def __post_init__(self) -> None:
        who = "ClosedLoopWeighted"
        if self.states is not None:
            whole(who, "states", self.states, 0)
        if self.budget is not None:
            whole(who, "budget", self.budget, 1)
        if self.states is not None and self.budget is not None:
            raise InputError(f"{who}: give 'states' or 'budget', got {self.states} and {self.budget}.")
        if self.loss is not None:
            positive(who, "loss", self.loss)
        positive(who, "loss_db", self.loss_db, "dB")
        if self.band_hz is not None:
            rising_band(who, self.band_hz)
        frequency_array(who, self.tones_hz)
        one_of(who, "method", self.method, METHODS)
        one_of(who, "norm", self.norm, NORMS)
        whole(who, "steps", self.steps, 0)

    @takes_systems
    @single_threaded
    def reduce(
        self, controller: StateSpace, plant: StateSpace | None = None, weights: Weights = None
    ) -> ReductionResult:
        """Return the reduced controller with the norms of the loop before and after.

        Args:
            controller: K, u = K y.
            plant: G.
            weights: what the loop is judged by: the mapping `details["weights"]` of a design (`performance`, `control`
                and perhaps `complementary`); one weight on the plant's outputs; a whole generalised plant; or None for
                the bare four-block cost.

        Returns:
            A `ReductionResult`; its status is `unstable` when the loop is not stable with so few states, `loss` when
            it costs more than allowed. Where states or a budget were asked for that lose the loop or break a promise,
            its sentence and `details["enough"]` say how many states would have been enough, by projection.

        Raises:
            InputError: no plant, the loop with the full controller is not stable, the weights do not fit, or the budget
                does not even hold the direct term.
        """
        if plant is None:
            raise InputError("ClosedLoopWeighted: the loop decides what is kept; give the plant, or take Balanced.")
        fits("ClosedLoopWeighted", controller, plant)
        tried = Candidates(judging_plant(plant, weights), controller, self.method, self.norm)
        nothing = self.states is None and self.budget is None and self.loss is None
        promise = self._promise(controller)
        judge = Judge(plant, controller, promise)
        best = _fewest_that_keep(tried, controller, judge) if nothing else self._chosen(tried, controller)
        provenance = Provenance(
            "ClosedLoopWeighted", asdict(self), parents=(controller.hash, plant.hash), versions=versions()
        )
        small = renamed((best.system.A, best.system.B, best.system.C, best.system.D), controller, provenance)
        result = certified(
            controller,
            small,
            best.hankel,
            P=tried.P,
            norm=self.norm,
            before=tried.before,
            allowed=self.loss,
            budget=self.budget,
            details={"way": best.way},
        )
        result = held(result, controller, plant, promise, judge)
        return result if nothing else _with_enough(result, tried, controller, judge)

    def _promise(self, controller: StateSpace) -> Promise:
        """Return what is to be kept: over the band and at the tones stated here, else as the law's design states."""
        own = Promise.of(controller, self.loss_db)
        return replace(own, band_hz=self.band_hz or own.band_hz, tones_hz=self.tones_hz or own.tones_hz)

    def _chosen(self, tried: Candidates, controller: StateSpace) -> ReducedLaw:
        nu, ny = controller.D.shape
        most, allowed = controller.states, self.loss
        if self.budget is not None:
            fitting = largest_order(self.budget, ny, nu)
            if fitting < 0:
                raise InputError(
                    f"ClosedLoopWeighted: a budget of {self.budget} multiply-adds does not hold the direct term of"
                    f" {nu} x {ny} = {nu * ny}; give more."
                )
            most = min(most, fitting)
        if self.states is not None:
            return self._at(tried, self.states, np.inf if allowed is None else allowed)
        if allowed is None:
            return self._at(tried, most, np.inf)
        return self._fewest(tried, most, allowed)

    def _at(self, tried: Candidates, count: int, allowed: float) -> ReducedLaw:
        """Return the best controller of an order: projected, then tuned where that costs too much or the loop.

        Where neither keeps the loop, states leave a few at a time.
        """
        best = tried.projected(count)
        if np.isfinite(best.cost) and best.cost <= 1 + allowed:
            return best
        kept = bool(np.isfinite(best.cost))
        if self.steps and (kept or multiply_adds(count, *tried.channels) <= TUNABLE):
            best = min(best, tried.tuned(count, self.steps, allowed), key=lambda c: c.cost)
        return best if np.isfinite(best.cost) else min(best, tried.in_steps(count), key=lambda c: c.cost)

    def _fewest(self, tried: Candidates, most: int, allowed: float) -> ReducedLaw:
        """Return the fewest states within the allowed loss (it falls with the states, nearly)."""
        best = self._at(tried, most, allowed)
        if best.cost > 1 + allowed:
            return best
        return _bisected(tried, best, most, lambda trial: bool(trial.cost <= 1 + allowed))


def _with_enough(result: ReductionResult, tried: Candidates, controller: StateSpace, judge: Judge) -> ReductionResult:
    """Return a reduction that lost the loop or broke a promise with the number of states that would have been enough.

    It is the fewest that projections need, to a sixtieth of the full law's; `details["enough"]` holds it.
    """
    if not (result.status.word is StatusWord.UNSTABLE or result.broken):
        return result
    best = _fewest_that_keep(tried, controller, judge, result.controller.states, max(1, controller.states // NEAR))
    if best.system.states >= controller.states:
        said = f"By projection no fewer than all {controller.states} states keep all that was promised."
    else:
        said = f"By projection {best.system.states} states keep all that was promised."
    status = Status(result.status.word, f"{result.status.sentence} {said}")
    return replace(result, status=status, details={**result.details, "enough": best.system.states})


def _fewest_that_keep(
    tried: Candidates, controller: StateSpace, judge: Judge, few: int = -1, near: int = 1
) -> ReducedLaw:
    """Return the fewest states that break no promise: by bisection on what is quick to judge, then up for margins."""

    def quickly(trial: ReducedLaw) -> bool:
        return bool(np.isfinite(trial.cost)) and not judge.broken(judge.of(trial.system, margins=False))

    most = controller.states
    best = _bisected(tried, tried.projected(most), most, quickly, few, near)
    high, step = best.system.states, max(1, controller.states // STEPS_UP)
    while high < controller.states and not (np.isfinite(best.cost) and not judge.broken(judge.of(best.system))):
        high = min(high + step, controller.states)
        best = tried.projected(high)
    return best


def _bisected(
    tried: Candidates, best: ReducedLaw, most: int, enough: Callable[[ReducedLaw], bool], few: int = -1, near: int = 1
) -> ReducedLaw:
    """Return the projection to the fewest states that do, more than `few` of them, found to `near`; `best` has most."""
    low, high = few, most
    while high - low > near:
        middle = (low + high) // 2
        trial = tried.projected(middle)
        if enough(trial):
            high, best = middle, trial
        else:
            low = middle
    return best
