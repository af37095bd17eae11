"""What the regularised methods share: an output's posterior, and a result that reduces it to few states."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.identify.regularised import marginal_likelihood
from ultraquiet.identify.result import Result
from ultraquiet.linalg.finite_response import HankelForm, response_of
from ultraquiet.values import PolynomialMatrix, Record, StateSpace, Status, StatusWord

KERNELS = ("tc", "dc", "ss")
LEAST_LINES = 4  # parameters that an input must carry: a steady tone carries two, and the prior would invent the rest
TEST_LAGS = 40
GUESSED = 0.5  # deviation of a response over its size from which on it is a guess: 0.1 of a record with little signal


@dataclass(frozen=True, eq=False, kw_only=True)
class ResponseResult(Result):
    """`Result` of a regularised fit; `covariance` is that of the posterior.

    `details` holds per output the hyper-parameters `eta`, block by block (logarithm of scale over innovation variance,
    logarithm of decay per sample, for DC the inverse hyperbolic tangent of the neighbours' correlation), and for the
    impulse response `response` and `deviation`, `(ny, nu, taps)`.
    """

    def state_space(self, states: int | None = None) -> StateSpace:
        """Return the balanced truncation whose response differs from the estimate by less than it is uncertain.

        Args:
            states: their number instead; the truncation is stable at any.
        """
        assert isinstance(self.model, PolynomialMatrix)
        response = self.details.get("response")
        if response is None:
            return super().state_space()
        full = np.concatenate([np.zeros((*response.shape[:2], int(self.details["delay"]))), response], axis=2)
        form = HankelForm(full)
        chosen = _enough(form, full, float(np.sum(self.details["deviation"] ** 2))) if states is None else states
        A, B, C, D = form.system(chosen)
        m = self.model
        return StateSpace(A, B, C, D, m.rate_hz, m.actuators, m.sensors, self.provenance)


def _enough(form: HankelForm, response: FloatArray, variance: float) -> int:
    """Return the least number of states whose response misses the given one by no more than its variance in sum."""
    low, high = 0, form.rank
    while low < high:
        middle = (low + high) // 2
        miss = float(np.sum((response_of(form.system(middle), response.shape[2]) - response) ** 2))
        low, high = (low, middle) if miss <= variance else (middle + 1, high)
    return high


@dataclass(frozen=True)
class RegularisedFit:
    """What both methods share."""

    name: ClassVar[str]

    def _fit(
        self, record: Record, i: int, signals: FloatArray, lags: list[int], taps: list[int], kernel: str, start: int
    ) -> tuple[FloatArray, FloatArray, marginal_likelihood.Posterior]:
        """Return coefficients and covariance of one output in units of the record, and the posterior in scaled ones."""
        size = np.maximum(signals.std(axis=1), np.finfo(float).tiny)
        y_size = float(record.outputs[i].std())
        scaled = signals / size[:, None]
        R = marginal_likelihood.compressed(scaled, lags, taps, record.outputs[i] / y_size, start)
        try:
            posterior = marginal_likelihood.estimate(R, record.samples - start - 1, taps, kernel)
        except np.linalg.LinAlgError as error:
            raise InputError(
                f"{type(self).__name__}: output '{record.sensors[i].name}' leaves normal equations of no full rank: it "
                f"grows without bound, or follows exactly from its own past; check that the plant is stable."
            ) from error
        unit = np.repeat(y_size / size, taps)
        return posterior.mean * unit, posterior.covariance * np.outer(unit, unit), posterior


def unsettled() -> Status:
    """Return the verdict on a prior that was not found."""
    return Status(
        StatusWord.NOT_CONVERGED, "The search for the prior ended away from a maximum of the marginal likelihood."
    )


def unless_guessed(status: Status, size: float, variance: float) -> Status:
    """Return the verdict on all responses of one output together, no praise where their deviation is of their size.

    Args:
        status: the verdict on what is left of the output.
        size: squared norm of the responses, each in units of output per standard deviation of its input.
        variance: what the posterior leaves of it, in the same units.
    """
    unknown = float(np.sqrt(max(variance, 0.0) / max(size, np.finfo(float).tiny)))
    if not status.ok or unknown <= GUESSED:
        return status
    return Status(
        StatusWord.UNKNOWN_IN_PART,
        f"The response is known to within {unknown:.0%} of its size alone: the inputs excite a part of it, and the "
        f"rest is the prior's; excite a band (noise, chirp, many tones).",
    )
