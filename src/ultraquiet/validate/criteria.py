"""Which of several models of one record to take: information criteria, side by side."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import information
from ultraquiet.linalg.information import NAMES, Criteria
from ultraquiet.validate.gradient import coefficients
from ultraquiet.values import PolynomialMatrix, Record, StateSpace, Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values


class Fitted(Protocol):
    """What the criteria need of a result."""

    @property
    def model(self) -> Any:
        """The model."""
        ...

    @property
    def loss(self) -> FloatArray:
        """`(ny,)` mean squared one-step error."""
        ...

    @property
    def status(self) -> Status:
        """The verdict."""
        ...


@takes_values
def information_criteria(result: Fitted, record: Record) -> Criteria:
    """Return FPE, AIC, AICc, BIC and MDL of a result on the record it was made from, one value an output.

    V is the mean squared one-step error, n the samples, p the coefficients of the output's model, beside which the
    initial conditions count that were fitted to this record (`Result.past`); see
    `ultraquiet.linalg.information.criteria` for the equations. Every output of a state-space model shares its
    coefficients: n (nu + 2 ny) + ny nu of them (A in canonical form, B, K, C, D), a share of 1 / ny each.

    Args:
        result: of any method.
        record: the one it was identified from.

    Raises:
        InputError: a result that has another number of outputs than the record, or one record per actuator.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 1000))
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=1.0)
    >>> record = uq.Record(u, lag.state_space().simulate(u[None])[0] + 0.1 * e, 1.0)
    >>> first, fifth = (information_criteria(uq.identify.OutputError(order=n).identify(record), record) for n in (1, 5))
    >>> bool(first.bic[0] < fifth.bic[0])
    True
    """
    if not (hasattr(result, "loss") and hasattr(result, "model")):
        raise InputError(
            f"information_criteria: it needs what an identification returned, with its loss, got "
            f"{type(result).__name__}."
        )
    loss = np.asarray(result.loss)
    if loss.shape != (len(record.sensors),):
        raise InputError(
            f"information_criteria: the losses {loss.shape} do not belong to a record of {len(record.sensors)} "
            f"outputs; give a result of this record alone."
        )
    return information.criteria(loss, record.samples, parameters(result.model), getattr(result, "past", 0.0))


def parameters(model: PolynomialMatrix | StateSpace) -> FloatArray:
    """Return how many free coefficients each output's model has, `(ny,)`."""
    if isinstance(model, StateSpace):
        ny, nu = model.D.shape
        return np.full(ny, (model.states * (nu + 2 * ny) + ny * nu * bool(np.any(model.D))) / ny)
    return np.array([sum(coefficients(m).size for m in row) for row in model.rows], dtype=float)


@dataclass(frozen=True)
class Selection:
    """Several models of one record, ranked.

    Attributes:
        rows: one plain row per model, best first: name, parameters, loss (geometric mean over outputs), the criteria
            (sums over outputs; geometric means for FPE and MDL), and the verdict.
        criterion: by which they are ranked.
        best: name of the first.
    """

    rows: tuple[dict[str, Any], ...]
    criterion: str

    @property
    def best(self) -> str:
        """Name of the model that the criterion prefers."""
        return str(self.rows[0]["name"])


@takes_values
def select(results: Mapping[str, Fitted], record: Record, criterion: str = "bic") -> Selection:
    """Rank models identified from one record by an information criterion.

    AIC and FPE aim at the best prediction and often keep a spare order; BIC and MDL aim at the true order and find it
    once the record is long. A search that did not converge is ranked behind all that did.

    Args:
        results: by name.
        record: from which all of them were identified.
        criterion: `fpe`, `aic`, `aicc`, `bic` or `mdl`.

    Raises:
        InputError: no results, an unknown criterion, results of another record's outputs.
    """
    one_of("select", "criterion", criterion, NAMES)
    if not isinstance(results, Mapping):
        raise InputError(f"select: 'results' must be results by name, {{'a': ...}}, got {type(results).__name__}.")
    if not results:
        raise InputError("select: no results were given.")
    rows = [_row(name, result, record) for name, result in results.items()]
    rows.sort(key=lambda row: (row["status"] == StatusWord.NOT_CONVERGED, row[criterion]))
    return Selection(tuple(rows), criterion)


def _row(name: str, result: Fitted, record: Record) -> dict[str, Any]:
    criteria = information_criteria(result, record)
    row = {
        "name": name,
        "parameters": int(np.sum(parameters(result.model))),
        "loss": float(np.exp(np.mean(np.log(result.loss)))),
    }
    for key in NAMES:
        value = getattr(criteria, key)
        row[key] = float(np.exp(np.mean(np.log(value))) if key in ("fpe", "mdl") else np.sum(value))
    return {**row, "status": result.status.word}
