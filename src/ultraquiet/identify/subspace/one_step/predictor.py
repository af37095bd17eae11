"""A state-space model from data of a closed loop: subspace of the one-step predictor, which looks at the past alone."""

from dataclasses import asdict, dataclass, replace
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import whole, yes_or_no
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.identify.record_checks import outputs_apart, usable
from ultraquiet.identify.result import Result
from ultraquiet.identify.searched_order import Auto, SearchedOrder
from ultraquiet.identify.subspace import evidence, fit, missing_modes
from ultraquiet.identify.subspace.method import Subspace
from ultraquiet.identify.subspace.one_step import other_starts
from ultraquiet.identify.subspace.one_step.past_regression import (
    LONGEST,
    SAMPLES_PER_COLUMN,
    PastRegression,
    PredictorStates,
)
from ultraquiet.values import Record
from ultraquiet.values.handed_over.kinds import takes_values


@register("identify", "predictor-subspace")
@dataclass(frozen=True)
class PredictorSubspace(SearchedOrder):
    """x+ = A x + B u + K e, y = C x + D u + e from records in open or closed loop: the optimised predictor form.

    A long autoregression with inputs y(t) = sum_{j=1}^{p} Theta_j [u; y](t - j) + e(t) is consistent whatever makes the
    inputs, for the past holds nothing of e(t). Its coefficients are the pulse response of the predictor (A - K C), so
    the matrix of Theta_{i+j} times the past is observability times state; a singular value decomposition gives the
    state, two regressions on it the model. All of it is read off one Gram matrix of the record's shifts. Where noise
    only reads off the outputs the predictor remembers as long as the plant, and no past that a record bears is enough:
    a stable plant is also sought from its simulated error, with states for the noise beside it (`other_starts`), and
    Schwarz's criterion of the one-step error says which model stays.

    Args:
        order: number of states, of plant and noise; "auto" or None takes the least BIC, of the regression on the states
            or of a plant as `Subspace` orders it.
        horizon: samples of past p; it must span the predictor's memory, which is shorter than the plant's. None takes
            that of least AIC of the autoregression.
        feedthrough: whether D is estimated. In a closed loop this asks for a controller that does not answer within the
            same sample; otherwise D must be zero.
        offset: whether a constant at each output is fitted.
        refine: whether a search lowers the one-step error of all parameters together, from every start.
        weighted: as in `Subspace`.
        stable: whether the plant is known to be stable; False admits a plant that only its loop holds.
        max_iterations: steps of the search.

    Returns of `identify`: `Result` whose model is an `InnovationForm`, its K zero where the outputs carry white noise
    alone; evidence and loss are of the one-step error. `not white` where that error plainly shows a mode left out.

    Reference: Chiuso, Automatica 43 (2007) 1034, doi:10.1016/j.automatica.2006.12.009; Jansson, SSARX, IFAC 2003,
    doi:10.1016/S1474-6670(17)34969-8.

    >>> import numpy as np, ultraquiet as uq
    >>> plant = uq.StateSpace([[0.9, 0.3], [-0.3, 0.9]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.0]], rate_hz=100.0)
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((1, 4000))
    >>> y = plant.simulate(u) + 0.1 * rng.standard_normal((1, 4000))
    >>> result = uq.identify.PredictorSubspace(order=2).identify(uq.Record(u, y, rate_hz=100.0))
    >>> result.model.poles().round(2)
    array([0.9+0.3j, 0.9-0.3j])
    """

    name: ClassVar[str] = "predictor-subspace"

    order: int | Auto | None = None
    horizon: int | None = None
    feedthrough: bool = False
    offset: bool = True
    refine: bool = True
    weighted: bool = True
    stable: bool = True
    max_iterations: int = 100

    def __post_init__(self) -> None:
        self.settle_order(500)
        if self.horizon is not None:
            whole("PredictorSubspace", "horizon", self.horizon, 1, 1000)
        for name in ("feedthrough", "offset", "refine", "weighted", "stable"):
            yes_or_no("PredictorSubspace", name, getattr(self, name))
        whole("PredictorSubspace", "max_iterations", self.max_iterations, 1)

    @takes_values
    def identify(self, record: Record) -> Result:
        """Return the model of all channels of the record.

        Raises:
            InputError: too few samples for order and horizon, a constant input or output, inputs or outputs that
                are copies of each other.
        """
        longest = self._longest(record)
        # Every state brings a column of B and a row of C at least.
        wires = len(record.actuators) + len(record.sensors)
        usable("PredictorSubspace", record, (self.given_order or 2) * wires // len(record.sensors), longest)
        evidence.independent("PredictorSubspace", record)
        outputs_apart("PredictorSubspace", record)
        data = fit.Scaled.of(record)
        regression = PastRegression.of(data, longest, self.feedthrough)
        past = self.horizon or regression.memory(1 + (self.given_order or 1) // len(record.sensors))
        states = regression.states(past)
        start = self._start(states)
        found = fit.SystemFit(start, 0, True)
        if self.refine:
            options = fit.Options(self.feedthrough, self.offset, self.weighted, self.max_iterations)
            own = fit.refined_prediction(start, data, options, self.stable)
            others = other_starts.from_simulation(self._simulating(), record, data, options) if self.stable else []
            found = other_starts.best([own, *others], data, self.weighted)
        provenance = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        details = {"horizon": past, "order": len(found.system.A), "singular_values": states.values}
        search = evidence.SearchSummary(found.steps, found.converged, True, self.refine, self.weighted)
        result = evidence.judged(found.system, record, data, search, provenance, details)
        return missing_modes.told(result, found.system, data, record.rate_hz, predicts=True)

    def _start(self, states: PredictorStates) -> fit.System:
        start = states.model(min(self.given_order or states.order(), len(states.values)))
        if self.stable:
            start = fit.with_poles_inside(start)
        return replace(start, K=start.K if start.predicts() else np.zeros_like(start.K))

    def _simulating(self) -> Subspace:
        """Return the method that fits the plant by its simulated error, on the same terms."""
        return Subspace(
            order=self.order,
            feedthrough=self.feedthrough,
            offset=self.offset,
            refine=True,
            weighted=self.weighted,
            max_iterations=self.max_iterations,
        )

    def _longest(self, record: Record) -> int:
        width = len(record.actuators) + len(record.sensors)
        most = record.samples // (SAMPLES_PER_COLUMN * width) - 1
        least = self.horizon or 1 + (self.given_order or 1) // len(record.sensors)
        if most < least:
            needed = (least + 1) * SAMPLES_PER_COLUMN * width
            raise InputError(
                f"PredictorSubspace: a past of {least} samples needs at least {needed} samples, the record has "
                f"{record.samples}; record longer or lower order or horizon."
            )
        return self.horizon or min(most, max(LONGEST, least))
