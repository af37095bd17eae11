"""What every identification returns, and the worst of several verdicts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown import Shown, counted
from ultraquiet.values import PolynomialMatrix, Record, StateSpace, Status, StatusWord
from ultraquiet.values.confidence.response_spread import ResponseSpread

# A verdict errs once in a thousand good models.
SIGNIFICANCE = 1e-3
# Share of an output's power below which an error is none of a measurement: 100 dB down, less than 16 bits tell apart.
NO_NOISE = 1e-10


def noiseless(share: float) -> Status | None:
    """Return `ok` where an error is so small a share of its output's power that there is no noise to test, else None.

    What is left of a simulated record is rounding, and what a search does within it: neither white nor a minimum.
    """
    if not share <= NO_NOISE:
        return None
    said = f"The residual is {np.sqrt(share):.1e} of the output: the record holds no noise to test."
    return Status(StatusWord.OK, said)


def shares_of(errors: FloatArray, y: FloatArray) -> FloatArray:
    """Return the share `(ny,)` of each output's power that an error has, both `(ny, n)`."""
    return np.mean(errors**2, axis=1) / np.maximum(np.var(y, axis=1), np.finfo(float).tiny)


@dataclass(frozen=True, eq=False, kw_only=True)
class Result(Shown):
    """An identified model and what it is worth.

    Attributes:
        model: `PolynomialMatrix` of one MISO model per output, or a `StateSpace` from a subspace method.
        status: `ok`, `not converged` or `not white`, with a sentence; the worst of the outputs.
        fit_percent: `(ny,)` 100 (1 - ||y - y_sim|| / ||y - mean y||) of the simulated output on the record itself, its
            past before the first sample and a constant fitted.
        loss: `(ny,)` mean squared one-step residual, squared output units.
        covariance: `(ny, p, p)` of the coefficients in the order a, b_1, f_1, b_2, f_2, ..., c, d (without the ones).
        whiteness_p, correlation_p: `(ny,)` p-values that the residual is white, and free of the inputs.
        iterations: `(ny,)` accepted steps of the search.
        statuses: one verdict an output.
        details: numbers that belong to one method alone.
        spread: how far the response may lie off (`validate.response_band` draws it) of a model without coefficients;
            found when it is first asked. None where `covariance` says it, or nothing does.
        past: of each output, `(ny,)` or one number, the initial conditions that were fitted beside the coefficients, a
            constant among them; zero where the past is taken as zero or left out.
        no_band: "no band: ..." and why, where chance's share in the response is not known; else empty.
    """

    model: PolynomialMatrix | StateSpace
    status: Status
    fit_percent: FloatArray
    loss: FloatArray
    covariance: FloatArray
    whiteness_p: FloatArray
    correlation_p: FloatArray
    iterations: np.ndarray[Any, np.dtype[np.int64]]
    statuses: tuple[Status, ...]
    provenance: Provenance
    details: Mapping[str, Any]
    spread: ResponseSpread | None = None
    no_band: str = ""
    past: FloatArray | float = 0.0

    def _in_a_line(self) -> str:
        fit = " ".join(f"{each:.4g}" for each in np.ravel(self.fit_percent)[:6]) + " ..." * (self.fit_percent.size > 6)
        return f"{type(self.model).__name__} of {counted(self.fit_percent.size, 'output')}, fit {fit} %"

    def state_space(self) -> StateSpace:
        """Return the path from inputs to outputs as a well-conditioned system."""
        return self.model if isinstance(self.model, StateSpace) else self.model.state_space()


@runtime_checkable
class Identification(Protocol):
    """A settings object with the verb `identify`."""

    def identify(self, record: Record) -> Result:
        """Return the model of the record."""
        ...


SEVERITY = (
    StatusWord.OK,
    StatusWord.NOT_WHITE,
    StatusWord.UNKNOWN_IN_PART,
    StatusWord.POOR_FIT,
    StatusWord.NOT_CONVERGED,
)


def worst(statuses: list[Status]) -> Status:
    """Return the most severe of several verdicts, with how many share it."""
    chosen = max(statuses, key=lambda s: SEVERITY.index(s.word))
    share = sum(s.word == chosen.word for s in statuses)
    if len(statuses) == 1 or chosen.ok:
        return chosen
    return Status(chosen.word, f"{share} of {len(statuses)} channels; the first: {chosen.sentence}")
