"""From the fits of single outputs or channels to one result."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.shown import Shown
from ultraquiet.identify.prediction_error.fit import Fit
from ultraquiet.identify.prediction_error.settings import PolynomialSettings
from ultraquiet.identify.result import Result, worst
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, StateSpace, Status, StatusWord


def gather(model: PolynomialMatrix, fits: list[Fit], made: Provenance) -> Result:
    """Put the fits of several outputs into one result."""
    return Result(
        model=model,
        status=worst([f.status for f in fits]),
        fit_percent=np.array([f.fit_percent for f in fits]),
        loss=np.array([f.loss for f in fits]),
        covariance=np.stack([f.covariance for f in fits]),
        whiteness_p=np.array([f.whiteness_p for f in fits]),
        correlation_p=np.array([f.correlation_p for f in fits]),
        iterations=np.array([f.iterations for f in fits]),
        statuses=tuple(f.status for f in fits),
        provenance=made,
        details={"starts": tuple(f.starts for f in fits), "repaired": tuple(f.repaired for f in fits)},
        past=np.array([float(f.past) for f in fits]),
    )


@dataclass(frozen=True, eq=False)
class MatrixResult(Shown):
    """A transfer matrix of single-channel models, each with its evidence.

    Attributes:
        model: `(ny, nu)` models, record k giving column k.
        status: the worst verdict of all channels, and how many share it.
        statuses: `(ny, nu)` verdicts.
        fit_percent, loss: `(ny, nu)` as in `Result`.
        covariance: `(ny, nu, p, p)` of the coefficients in the order b, f, c, d (a first for ARX and ARMAX), NaN
            beyond the p of a channel whose orders are smaller.
        whiteness_p, correlation_p: `(ny, nu)` p-values.
        iterations: `(ny, nu)`.
    """

    model: PolynomialMatrix
    status: Status
    statuses: tuple[tuple[Status, ...], ...]
    fit_percent: FloatArray
    loss: FloatArray
    covariance: FloatArray
    whiteness_p: FloatArray
    correlation_p: FloatArray
    iterations: np.ndarray[Any, np.dtype[np.int64]]
    provenance: Provenance

    def state_space(self) -> StateSpace:
        """Return the matrix as one well-conditioned system."""
        return self.model.state_space()


def columns(settings: PolynomialSettings, records: Sequence[Record]) -> list[Record]:
    """Return each record with its excited input alone, after checking that they form one matrix."""
    if not records:
        raise InputError("identify_matrix: no records were given; one per actuator is needed.")
    picked = [excited(k, record, len(records)) for k, record in enumerate(records)]
    for k, record in enumerate(picked):
        same_rate("identify_matrix", "record 1", picked[0].rate_hz, f"record {k + 1}", record.rate_hz)
        if len(record.sensors) != len(picked[0].sensors):
            raise InputError(
                f"identify_matrix: record {k + 1} has {len(record.sensors)} outputs but the first has "
                f"{len(picked[0].sensors)}; all must read the same sensors."
            )
        settings.check(record)
    return picked


def excited(k: int, record: Record, count: int) -> Record:
    """Return the record of actuator k with its input alone, after checking that no other of the `count` moves."""
    if len(record.actuators) == 1:
        return record
    if len(record.actuators) != count:
        raise InputError(
            f"identify_matrix: record {k + 1} has {len(record.actuators)} inputs but {count} records were given; "
            f"one record per actuator is needed."
        )
    moving = [j for j, u in enumerate(record.inputs) if np.ptp(u) > 0.0]
    if moving != [k]:
        names = ", ".join(f"'{record.actuators[j].name}'" for j in moving) or "none"
        raise InputError(
            f"identify_matrix: record {k + 1} must excite '{record.actuators[k].name}' alone, it excites {names}; "
            f"put the records in the actuators' order."
        )
    return record.pick([k])


def whole(method: PolynomialSettings, grid: list[list[Fit]], records: Sequence[Record]) -> MatrixResult:
    """Put the fits of all channels, made by one method from one record per actuator, into one result."""
    parents = tuple(record.hash for record in records)
    made = Provenance(method.name, asdict(method), parents=parents, versions=versions())
    return assemble(grid, columns(method, records), made)


def assemble(grid: list[list[Fit]], picked: list[Record], made: Provenance) -> MatrixResult:
    """Put the fits of all channels into one result."""
    models: list[list[PolynomialModel]] = [[f.model for f in row] for row in grid]
    model = PolynomialMatrix(models, [r.actuators[0] for r in picked], picked[0].sensors, made)

    def table(name: str) -> Any:
        return np.array([[getattr(f, name) for f in row] for row in grid])

    size = max(f.covariance.shape[0] for row in grid for f in row)
    covariance = np.full((len(grid), len(grid[0]), size, size), np.nan)
    for i, row in enumerate(grid):
        for k, f in enumerate(row):
            covariance[i, k, : f.covariance.shape[0], : f.covariance.shape[0]] = f.covariance

    statuses = _verdicts(grid)
    return MatrixResult(
        model,
        worst([status for row in statuses for status in row]),
        statuses,
        table("fit_percent"),
        table("loss"),
        covariance,
        table("whiteness_p"),
        table("correlation_p"),
        table("iterations"),
        made,
    )


def _verdicts(grid: list[list[Fit]]) -> tuple[tuple[Status, ...], ...]:
    """Return the verdict of each channel, a silent one taken for a zero of the plant where its wires work.

    An output that answers other inputs, and an input that other outputs answer, are not swapped and not dead.
    """
    heard = np.array([[not f.silent for f in row] for row in grid])
    works = np.logical_and.outer(heard.any(axis=1), heard.any(axis=0))
    zero = Status(StatusWord.OK, "The output answers this input no more than by chance: a zero of the plant.")
    return tuple(
        tuple(zero if f.silent and works[i, k] else f.status for k, f in enumerate(row)) for i, row in enumerate(grid)
    )
