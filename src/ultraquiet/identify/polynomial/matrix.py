"""The whole transfer matrix from one record per actuator."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.threads import in_threads
from ultraquiet.identify.polynomial.methods import PolynomialMethod
from ultraquiet.identify.prediction_error.fit import Fit
from ultraquiet.identify.prediction_error.initial_models import Channel, starting_models
from ultraquiet.identify.result import worst
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, StateSpace, Status


@dataclass(frozen=True, eq=False)
class MatrixResult:
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


def identify_matrix(
    method: PolynomialMethod,
    records: Sequence[Record | Sequence[Record]],
    workers: int | None = None,
    share: str | Sequence[str] | ArrayLike | None = None,
    start: PolynomialMatrix | StateSpace | None = None,
) -> MatrixResult:
    """Identify every channel of a transfer matrix from one record per actuator, as section 3.4 of the paper.

    Args:
        method: settings of a polynomial structure, `BoxJenkins(order=5)` for instance.
        records: record k excites actuator k alone; each has all `nu` inputs (or only the excited one) and `ny` outputs.
            Several records of one actuator, as a list in place k, go into one fit.
        workers: threads; as many as processors when absent.
        share: what the channels have in common, "threefold" or "poles" for instance; see `identify_joint`.
        start: the matrix of earlier records, from which every search begins; see `PolynomialMethod.identify`.

    Returns:
        The `(ny, nu)` models; the models of a row each carry their own noise.

    Raises:
        InputError: a record that excites another actuator than its own, one that differs from the first in channels or
            rate, or that cannot carry the order.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(500)
    >>> y = np.convolve(u, [0.0, 1.0, 0.5])[:500] + 0.01 * rng.standard_normal(500)
    >>> result = uq.identify.identify_matrix(uq.identify.Arx(order=2), [uq.Record(u, y, rate_hz=100.0)])
    >>> result.model.frequency_response([0.0]).real.round(1)
    array([[[1.5]]])
    """
    single = [record for record in records if isinstance(record, Record)]
    if share is not None or method.informed or len(single) < len(records):
        if start is not None:
            raise InputError("identify_matrix: start is for channels that share nothing, one record per actuator.")
        from ultraquiet.identify.joint.identify import identify_tied_matrix

        return identify_tied_matrix(method, records, share, workers)
    picked = columns(method, single)
    channels = [(i, k) for k in range(len(picked)) for i in range(len(picked[0].sensors))]
    first = starting_models(start, len(picked[0].sensors), len(picked), picked[0].rate_hz)

    def one(place: tuple[int, int]) -> Fit:
        i, k = place
        return method.fit(Channel.of(picked[k], i, first[i][k]), picked[k].rate_hz)

    found = in_threads(f"identify {method.name}", one, channels, workers)
    grid = [[found[(i, k)] for k in range(len(picked))] for i in range(len(picked[0].sensors))]
    made = Provenance(method.name, asdict(method), parents=tuple(record.hash for record in single), versions=versions())
    return assemble(grid, picked, made)


def columns(method: PolynomialMethod, records: Sequence[Record]) -> list[Record]:
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
        method.check(record)
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

    return MatrixResult(
        model,
        worst([f.status for row in grid for f in row]),
        tuple(tuple(f.status for f in row) for row in grid),
        table("fit_percent"),
        table("loss"),
        covariance,
        table("whiteness_p"),
        table("correlation_p"),
        table("iterations"),
        made,
    )
