"""The whole transfer matrix from one record per actuator."""

from collections.abc import Sequence

from numpy.typing import ArrayLike

from ultraquiet._base.errors import InputError
from ultraquiet._base.threads import in_threads
from ultraquiet.identify.joint.identify import identify_tied_matrix, polynomial
from ultraquiet.identify.joint.ties import same
from ultraquiet.identify.prediction_error.fit import Fit
from ultraquiet.identify.prediction_error.initial_models import ChannelData, starting_models
from ultraquiet.identify.prediction_error.order_choice import told, with_order
from ultraquiet.identify.prediction_error.result import MatrixResult, columns, whole
from ultraquiet.identify.prediction_error.settings import PolynomialSettings
from ultraquiet.values import PolynomialMatrix, Record, StateSpace
from ultraquiet.values.handed_over.kinds import takes_values


@takes_values
def identify_matrix(
    method: PolynomialSettings,
    records: Sequence[Record | Sequence[Record]],
    workers: int | None = None,
    ties: str | Sequence[str] | ArrayLike | None = None,
    start: PolynomialMatrix | StateSpace | None = None,
    *,
    share: str | Sequence[str] | ArrayLike | None = None,
) -> MatrixResult:
    """Identify every channel of a transfer matrix from one record per actuator, as section 3.4 of the paper.

    Args:
        method: settings of a polynomial structure, `BoxJenkins(order=5)` for instance; an order that is left to the
            records is one for all channels.
        records: record k excites actuator k alone; each has all `nu` inputs (or only the excited one) and `ny` outputs.
            Several records of one actuator, as a list in place k, go into one fit.
        workers: threads; as many as processors when absent.
        ties: what the channels have in common, "threefold" or "poles" for instance; see `identify_joint`.
        start: the matrix of earlier records, from which every search begins; see `PolynomialMethod.identify`.
        share: the older name of `ties`.

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
    polynomial("identify_matrix", method)
    ties = same("identify_matrix", ties, share)
    single = [record for record in records if isinstance(record, Record)]
    if ties is not None or method.informed or len(single) < len(records):
        if start is not None:
            raise InputError("identify_matrix: start is for channels that share nothing, one record per actuator.")
        return identify_tied_matrix(method, records, ties, workers)
    settled, words = with_order(method, [] if method.given_order else columns(method.at_order(1), single))
    picked = columns(settled, single)
    channels = [(i, k) for k in range(len(picked)) for i in range(len(picked[0].sensors))]
    first = starting_models(start, len(picked[0].sensors), len(picked), picked[0].rate_hz)

    def one(place: tuple[int, int]) -> Fit:
        i, k = place
        return settled.fit(ChannelData.of(picked[k], i, first[i][k]), picked[k].rate_hz)

    fits = in_threads(f"identify {settled.name}", one, channels, workers)
    grid = [[fits[(i, k)] for k in range(len(picked))] for i in range(len(picked[0].sensors))]
    return told(whole(settled, grid, single), settled, words)
