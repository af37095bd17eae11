"""A multivariable state-space model from one record: subspace for the poles, least squares or a search for the rest."""

from dataclasses import asdict, dataclass, replace
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import ComplexArray
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.files import LongRecord
from ultraquiet.identify.record_checks import outputs_apart, usable
from ultraquiet.identify.result import Result
from ultraquiet.identify.subspace import (
    evidence,
    fit,
    hankel,
    missing_modes,
    modal_least_squares,
    order_selection,
    pole_search,
    unexcited,
)
from ultraquiet.identify.subspace.disk.long_record import identify_long_subspace
from ultraquiet.identify.subspace.modal_least_squares import FilterBank
from ultraquiet.identify.subspace.settings import SubspaceSettings
from ultraquiet.identify.subspace.start import Horizon, SubspaceStart
from ultraquiet.values import Record
from ultraquiet.values.handed_over.kinds import takes_values


@register("identify", "subspace")
@dataclass(frozen=True)
class Subspace(SubspaceSettings):
    """x+ = A x + B u + K e, y = C x + D u + e: a subspace for the poles, then least squares or a search for the rest.

    The extended observability matrix comes from the projection of future outputs on past data along future inputs,
    taken from the Gram matrix of the Hankel data (cost and memory do not grow with the record beyond one pass). A, and
    with it the poles, follow from its shift structure. B, D and initial state, and C in turn, then minimise the
    simulated error in modal coordinates; `refine` lets the poles move too, by Gauss-Newton. The noise gain K is fitted
    last, to what the simulation leaves. In bands where all inputs are silent, of which a record says nothing, the model
    answers as little as the rest allows (`unexcited`).

    Args:
        order: number of states; "auto" or None tries orders on a held-out part of the record, and leaves out of the
            best the modes that cannot be told from noise.
        horizon: block rows; the longest decay and the slowest mode must show within it. None tries several and keeps
            the one whose model simulates best.
        weight: of the projection: "moesp", "n4sid" or "cva".
        feedthrough: whether D is estimated; otherwise zero. None estimates it and keeps it where the record tells it
            from noise.
        offset: whether a constant at each output is fitted.
        refine: whether a prediction-error search follows.
        focus: what it lowers: the simulated error, with the noise model beside it, or the one-step error of all
            together, which is better where the model is as rich as the plant, and biased where it is not.
        weighted: whether the search weighs the outputs by the inverse covariance of their errors (maximum likelihood,
            log det) or alike.
        max_iterations: steps of the search.

    Returns of `identify`: `Result` whose model is an `InnovationForm` in real modal blocks. `loss` is of the one-step
    errors, `fit_percent` of the simulated output. `not white` says that the errors still hold something of the inputs,
    a mode that the model has not, or of their own past when the one-step errors were the aim. `details`: horizon,
    order, singular values.

    Reference: Verhaegen 1994, doi:10.1016/0005-1098(94)90229-1; Van Overschee and De Moor 1996, chapter 4; Ljung,
    System Identification, 2nd ed., section 10.6.

    >>> import numpy as np, ultraquiet as uq
    >>> plant = uq.StateSpace([[0.9, 0.3], [-0.3, 0.9]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.2]], rate_hz=100.0)
    >>> u = np.random.default_rng(0).standard_normal((1, 2000))
    >>> result = uq.identify.Subspace(order=2).identify(uq.Record(u, plant.simulate(u), rate_hz=100.0))
    >>> result.model.poles().round(4)
    array([0.9+0.3j, 0.9-0.3j])
    """

    name: ClassVar[str] = "subspace"

    @takes_values
    def identify(self, record: Record | LongRecord) -> Result:
        """Return the state-space model of all channels of the record.

        A `files.LongRecord` is read from its file in blocks, in a few passes; see `identify_long_subspace`.

        Raises:
            InputError: too few samples for the order, a constant input or output, inputs that are copies of each
                other, outputs too where their errors are weighed, a horizon too short for the order.
        """
        if isinstance(record, LongRecord):
            return identify_long_subspace(self, record)
        data, heard, start = self.allowing_feedthrough()._begun(record)
        settled, start = self.of_start(start)
        return settled._finished(record, data, heard, start)

    def _begun(self, record: Record) -> tuple[fit.Scaled, fit.Scaled, SubspaceStart]:
        """Return the data scaled, the same topped up where they are silent, and the modes of the best horizon."""
        self.horizons(record, self.given_order or 1)
        usable("Subspace", record, self.given_order or 1, 0)
        evidence.independent("Subspace", record)
        if self.refine and self.weighted:
            outputs_apart("Subspace", record)
        data = fit.Scaled.of(record)
        heard = unexcited.topped_up(data, unexcited.silent_bands(data.u))
        order = order_selection.chosen(self, record) if self.given_order is None else self.given_order
        matrices = (hankel.factor(heard.centred_u, heard.y, rows) for rows in self.horizons(record, order))
        horizons = [Horizon.of(factor, self.weight) for factor in matrices]
        start = self._started(heard, horizons, order)
        wide = [horizon for horizon in horizons if horizon.most >= start.states]
        if self.given_order is None and start.states != order and wide:
            # Modes left out or put in are not where a search for that many would have them.
            start = min(start, self._started(heard, wide, start.states), key=lambda start: start.loss)
        return data, heard, start

    def _started(self, data: fit.Scaled, horizons: list[Horizon], order: int) -> SubspaceStart:
        """Return the best modes over all horizons, faint ones replaced by those that they miss."""

        def bank_at(poles: ComplexArray) -> FilterBank:
            return FilterBank(poles, data.u, data.y, bool(self.feedthrough), self.offset)

        starts = [SubspaceStart.of(horizon, order, bank_at) for horizon in horizons]
        if self.given_order is None:
            starts = [start.pruned() for start in starts]
        return self._replenished(data, min(starts, key=lambda start: start.loss))

    def _replenished(self, data: fit.Scaled, start: SubspaceStart) -> SubspaceStart:
        if self.refine:
            return start
        bank, modes = missing_modes.replenished(start.bank, start.modes, pole_search.sought(self, data))
        if not np.array_equal(modes.poles, start.modes.poles):  # as of a record on disk, sought there on a stretch
            modes = modal_least_squares.alternate(bank, modes.c, missing_modes.ROUNDS)
        return replace(start, bank=bank, modes=modes, loss=modal_least_squares.cost(bank, modes))

    def _finished(self, record: Record, data: fit.Scaled, heard: fit.Scaled, start: SubspaceStart) -> Result:
        """Return the result of a search on `heard`, the data topped up where they are silent, judged on the data."""
        system, steps, converged = self._searched(data, heard, start)
        provenance = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        predicts = self.focus == "prediction" and self.refine
        search = evidence.SearchSummary(steps, converged, predicts, self.refine, self.weighted)
        details = {"horizon": start.horizon.rows, "order": len(system.A), "singular_values": start.horizon.values}
        result = evidence.judged(system, record, data, search, provenance, details)
        return missing_modes.told(result, system, data, record.rate_hz, predicts)

    def _searched(self, data: fit.Scaled, heard: fit.Scaled, start: SubspaceStart) -> fit.SystemFit:
        """Return the system with its noise gain, in scaled units."""
        if self.refine:
            system, steps, converged = pole_search.refined(self, heard, start.modes)
        else:
            system, steps, converged = fit.system(start.settled()), 0, True
        system = replace(system, K=fit.noise_gain(system, start.innovations(data), data))
        if self.refine and self.focus == "prediction":
            system, more, converged = fit.refined_prediction(system, heard, self.options())
            steps += more
        return fit.SystemFit(system, steps, converged)


def fitted(settings: Subspace, record: Record) -> fit.SystemFit:
    """Return what `Subspace.identify` finds, in scaled units and without evidence.

    Raises:
        InputError: as `Subspace.identify`.
    """
    data, heard, start = settings.allowing_feedthrough()._begun(record)
    settled, start = settings.of_start(start)
    return settled._searched(data, heard, start)
