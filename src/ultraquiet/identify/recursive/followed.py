"""One output followed through a record: where it starts, how it is read, and what its predictions are worth."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.files import LongRecord
from ultraquiet.identify import chance
from ultraquiet.identify.feedback import free_of_inputs_in
from ultraquiet.identify.prediction_error import fit as one_fit
from ultraquiet.identify.prediction_error.damping_policy import CONVERGED
from ultraquiet.identify.recursive.estimator import Recursion
from ultraquiet.identify.recursive.trajectory import Trajectory
from ultraquiet.linalg import portmanteau
from ultraquiet.linalg.lagged import Lagged
from ultraquiet.values import PolynomialModel, Record, Status, StatusWord

CUT_SHORT_SHARE = 0.01  # of steps cut short at the edge of stability, beyond which the verdict says so


@dataclass(frozen=True, eq=False)
class Followed:
    """One output followed to its end."""

    model: PolynomialModel
    status: Status
    fit_percent: float
    covariance: FloatArray
    whiteness_p: float
    correlation_p: float
    trajectory: Trajectory
    steps_cut_short: int


class LevelsOfSignals(NamedTuple):
    """Constants about which inputs `(nu, 1)` and one output move."""

    inputs: FloatArray
    output: float

    @classmethod
    def of(cls, piece: Record, output: int) -> "LevelsOfSignals":
        """Return the means of a record's beginning."""
        return cls(piece.inputs.mean(axis=1, keepdims=True), float(piece.outputs[output].mean()))

    @classmethod
    def none(cls, inputs: int) -> "LevelsOfSignals":
        """Return nothing to leave out."""
        return cls(np.zeros((inputs, 1)), 0.0)

    def left(self, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the signals without their levels."""
        return u - self.inputs, y - self.output


def with_evidence(running: Recursion, trajectory: Trajectory, sums: Lagged, fit_percent: float) -> Followed:
    """Return the output followed, its verdict drawn from the errors of the predictions as they were made.

    Args:
        running: the estimator at the record's end.
        trajectory: the way there.
        sums: products of these errors, the inputs and the output.
        fit_percent: of the last model, simulated.
    """
    n, s = sums.samples, running.structure
    r = sums.products(centred=True) / n
    white = portmanteau.ljung_box_of(r[1:, 0, 0] / r[0, 0, 0], n, s.a + s.c + s.d).p_value
    nu = r.shape[1] - 2
    evidence = white, free_of_inputs_in(r[:, :-1, :-1], n, s.delay > 0)
    status = one_fit.verdict(CONVERGED, 0, evidence)
    if running.held > CUT_SHORT_SHARE * n:
        status = Status(
            StatusWord.NOT_CONVERGED,
            f"{running.held} of {n} steps were cut short at the edge of stability: start from a batch fit, or use a "
            f"longer memory.",
        )
    elif not fit_percent >= 0:
        status = Status(
            StatusWord.POOR_FIT,
            "The last model's simulated output is farther from the record than the mean: it is unstable or lost.",
        )
    told = chance.explained_of(sums, -1, 0)
    status = chance.unless_silent(status, told, n, len(running.coefficients) + nu * s.longest + 1, evidence[1])
    m = running.model
    loss = float(sums.products()[0, 0, 0]) / n
    model = PolynomialModel(m.b, m.f, m.rate_hz, m.a, m.c, m.d, loss)
    return Followed(model, status, fit_percent, running.covariance, *evidence, trajectory, running.held)


def starting_piece(record: Record | LongRecord, samples: int) -> Record:
    """Return the record's beginning; all of a record in memory that needs no start, for its checks."""
    if isinstance(record, LongRecord):
        return record.part(0, samples or min(record.samples, 1 << 16))
    return record.part(0, samples) if samples else record


def blocks_of(record: Record | LongRecord, output: int, every: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield inputs and one output, `every` samples at a time."""
    if isinstance(record, LongRecord):
        large = every * max(1, (1 << 16) // every)
        for u, y in record.pick(outputs=[output]).blocks(large):
            for at in range(0, u.shape[1], every):
                yield u[:, at : at + every], y[:, at : at + every]
        return
    for at in range(0, record.samples, every):
        yield record.inputs[:, at : at + every], record.outputs[output : output + 1, at : at + every]
