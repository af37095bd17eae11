"""A multivariable state-space model from one record: subspace for the poles, least squares or a search for the rest."""

from dataclasses import asdict, dataclass, replace
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.files import LongRecord
from ultraquiet.identify.result import Result, usable
from ultraquiet.identify.subspace import evidence, fit, hankel, modal_least_squares, order_selection, state_sequence
from ultraquiet.values import Record

CANDIDATES = (10, 20, 40, 60, 90)  # block rows tried when no horizon is given; the lowest simulated error wins
COLUMNS_PER_ROW = 2  # a Hankel matrix must be this much longer than high
ROUNDS = 60  # of alternating least squares
TRIAL_ROUNDS = 6  # of it by which horizons are compared
GAIN = 1e-5
FOCUSES = ("simulation", "prediction")


@register("identify", "subspace")
@dataclass(frozen=True)
class Subspace:
    """x+ = A x + B u + K e, y = C x + D u + e: a subspace for the poles, then least squares or a search for the rest.

    The extended observability matrix comes from the projection of future outputs on past data along future inputs,
    taken from the Gram matrix of the Hankel data (cost and memory do not grow with the record beyond one pass). A, and
    with it the poles, follow from its shift structure. B, D and initial state, and C in turn, then minimise the
    simulated error in modal coordinates; `refine` lets the poles move too, by Gauss-Newton. The noise gain K is fitted
    last, to what the simulation leaves.

    Args:
        order: number of states; None tries orders on a held-out part of the record, and leaves out of the best the
            modes that cannot be told from noise.
        horizon: block rows; the longest decay and the slowest mode must show within it. None tries several and keeps
            the one whose model simulates best.
        weight: of the projection: "moesp", "n4sid" or "cva".
        feedthrough: whether D is estimated; otherwise zero.
        offset: whether a constant at each output is fitted.
        refine: whether a prediction-error search follows.
        focus: what it lowers: the simulated error, with the noise model beside it, or the one-step error of all
            together, which is better where the model is as rich as the plant, and biased where it is not.
        weighted: whether the search weighs the outputs by the inverse covariance of their errors (maximum likelihood,
            log det) or alike.
        max_iterations: steps of the search.

    Returns of `identify`: `Result` whose model is an `InnovationForm` in real modal blocks. `loss` is of the one-step
    errors, `fit_percent` of the simulated output. `not white` says that the errors still hold something of the inputs,
    or of their own past when the one-step errors were the aim. `details`: horizon, order, singular values.

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

    order: int | None = 30
    horizon: int | None = None
    weight: str = "moesp"
    feedthrough: bool = True
    offset: bool = True
    refine: bool = False
    focus: str = "simulation"
    weighted: bool = True
    max_iterations: int = 50

    def __post_init__(self) -> None:
        who = "Subspace"
        if self.order is not None:
            whole(who, "order", self.order, 1, 500)
        if self.horizon is not None:
            whole(who, "horizon", self.horizon, 2, 1000)
        one_of(who, "weight", self.weight, hankel.WEIGHTS)
        one_of(who, "focus", self.focus, FOCUSES)
        whole(who, "max_iterations", self.max_iterations, 1)

    def identify(self, record: Record | LongRecord) -> Result:
        """Return the state-space model of all channels of the record.

        A `files.LongRecord` is read from its file in blocks, in a few passes; see `identify_long_subspace`.

        Raises:
            InputError: too few samples for the order, a constant input or output, inputs that are copies of each
                other, a horizon too short for the order.
        """
        if isinstance(record, LongRecord):
            from ultraquiet.identify.subspace.long_record import identify_long_subspace

            return identify_long_subspace(self, record)
        self.horizons(record, self.order or 1)
        usable("Subspace", record, self.order or 1, 0)
        evidence.independent("Subspace", record)
        data = fit.Scaled.of(record)
        order = order_selection.chosen(self, record) if self.order is None else self.order
        found = min((self._modes(data, rows, order) for rows in self.horizons(record, order)), key=lambda s: s.loss)
        return self._finished(record, data, found)

    def horizons(self, record: Record | LongRecord, order: int) -> list[int]:
        """Return the numbers of block rows to try."""
        width = len(record.actuators) + len(record.sensors)
        least = order // len(record.sensors) + 2
        fits = record.samples // (2 * width * COLUMNS_PER_ROW)
        wanted = [self.horizon] if self.horizon else sorted({max(least, rows) for rows in CANDIDATES})
        if self.horizon is not None and self.horizon < least:
            raise InputError(f"Subspace: order {order} needs at least {least} block rows, got {self.horizon}.")
        usable_rows = [rows for rows in wanted if rows <= fits]
        if not usable_rows:
            needed = min(wanted) * 2 * width * COLUMNS_PER_ROW
            raise InputError(
                f"Subspace: order {order} with {min(wanted)} block rows needs at least {needed} samples, the "
                f"record has {record.samples}; record longer or lower order or horizon."
            )
        return usable_rows

    def _modes(self, data: fit.Scaled, rows: int, order: int) -> "Start":
        """Return the modes found with `rows` block rows."""
        held = hankel.factor(data.centred_u, data.y, rows)
        basis, values = hankel.directions(held, self.weight)
        A, C = hankel.transition(basis, values, order, len(data.y))
        poles, directions, _ = fit.modes_of(A, C)
        bank = modal_least_squares.Bank(poles, data.u, data.y, self.feedthrough, self.offset)
        modes = modal_least_squares.alternate(bank, directions, TRIAL_ROUNDS, GAIN)
        if self.order is None:
            bank, modes = modal_least_squares.pruned(bank, modes)
        return Start(order_selection.cost(bank, modes), rows, modes, held, basis, values, order, bank)

    def _finished(self, record: Record, data: fit.Scaled, start: "Start") -> Result:
        modes = start.modes
        if start.bank is not None and not self.refine:
            modes = modal_least_squares.alternate(start.bank, modes.c, ROUNDS, GAIN)
        system, steps, converged = fit.system(modes), 0, True
        options = fit.Options(self.feedthrough, self.offset, self.weighted, self.max_iterations)
        if self.refine:
            system, steps, converged = fit.refined_simulation(system, data, options)
        system = replace(system, K=fit.noise_gain(system, start.innovations(data), data))
        if self.refine and self.focus == "prediction":
            system, more, converged = fit.refined_prediction(system, data, options)
            steps += more
        made = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        search = evidence.Search(steps, converged, self.focus == "prediction" and self.refine)
        details = {"horizon": start.rows, "order": len(system.A), "singular_values": start.values}
        return evidence.judged(system, record, data, search, made, details)


@dataclass(frozen=True, eq=False)
class Start:
    """What one horizon gave: its loss (see `state_order.cost`), modes, and where they came from."""

    loss: float
    rows: int
    modes: modal_least_squares.Modes
    held: hankel.Factor
    basis: FloatArray
    values: FloatArray
    order: int
    bank: modal_least_squares.Bank | None = None

    def innovations(self, data: fit.Scaled) -> FloatArray:
        """Return the one-step errors of the Kalman filter that the state sequence gives; simulated ones without it."""
        made = state_sequence.realised(self.held, self.basis, self.values, self.order)
        rest = np.zeros(self.order), np.zeros(len(data.y))
        filtered = fit.System(made.A, made.B, made.C, made.D, made.K, *rest)
        if filtered.predicts():
            return filtered.errors(data.centred_u, data.y)
        return data.y - fit.system(self.modes).simulated(data.u)
