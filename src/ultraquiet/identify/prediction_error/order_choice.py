"""Which order of one structure records prefer, and how a verdict tells where its order is from."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet._base.threads import in_threads
from ultraquiet.identify.prediction_error.fit import Fit
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.result import MatrixResult
from ultraquiet.identify.prediction_error.settings import PolynomialSettings
from ultraquiet.identify.result import Result
from ultraquiet.identify.searched_order import AUTO, Unasked
from ultraquiet.linalg import prediction
from ultraquiet.values import Record, Status

ORDERS = range(1, 8)
FITTED_SHARE = 2 / 3  # of each record when no other records are held out
# A larger model must lower the score by this share to be preferred: less is within what another record would change.
WORTH = 0.02
# An error of less than this share of an output's variance is the arithmetic's, and no reason for a larger order.
LEAST_ERROR = 1e-14

M = TypeVar("M", bound=PolynomialSettings)
R = TypeVar("R", Result, MatrixResult)


@dataclass(frozen=True)
class OrderChoice:
    """The order that records prefer, and why.

    Attributes:
        order: the one to take.
        best: the one of least error.
        tried: those that the records can carry.
        samples: of the records that were asked, together.
    """

    order: int
    best: int
    tried: tuple[int, ...]
    samples: int

    @property
    def sentence(self) -> str:
        """Which order was taken and why; what to do where a larger one may be better."""
        first, last = self.tried[0], self.tried[-1]
        part = f"the last third of {self.samples} samples"
        if first == last:
            return f"Order {self.order} was taken, the only one tried that the record can carry."
        why = f"of orders {first} to {last}"
        if self.best == self.order:
            why += f" it predicts {part} best"
        else:
            why += f", {self.best} predicts {part} best, and this one within {100 * WORTH:g} % as well"
        more = " No larger one was tried: give one as a number, or take 'subspace', and compare."
        return f"Order {self.order} was chosen: {why}.{more * (self.order == last)}"


def with_order(method: M, records: Sequence[Record], inputs: Sequence[int] | None = None) -> tuple[M, str]:
    """Return settings whose order is a number, and what is to be said of it: nothing where it was asked for.

    Args:
        method: the settings.
        records: that are asked where the order is left to them.
        inputs: of each record the one that it holds, where the settings are those of more.

    Raises:
        InputError: the order is left to records that can carry none.
    """
    if method.given_order is None:
        own = None if inputs is None else [method.for_input(j) for j in inputs]
        choice = order_of(method, records, own=own)
        return method.at_order(choice.order), choice.sentence
    order = method.whole_order
    words = unasked(method.given_order, f"; '{AUTO}' asks the record")
    return (method.at_order(order), words) if words else (method, "")


def unasked(order: int, remedy: str = "") -> str:
    """Return in words that an order was not asked for, and what could be; nothing where it was."""
    return f"Order {order} was taken, none was asked for{remedy}." if isinstance(order, Unasked) else ""


def told(result: R, method: PolynomialSettings, words: str) -> R:
    """Return a result that holds the order of its models, and whose verdict says what is to be said of it."""
    if isinstance(result, Result):
        result = replace(result, details={**result.details, "order": method.whole_order})
    if not words:
        return result
    return replace(result, status=Status(result.status.word, f"{result.status.sentence} {words}"))


def chosen_order(method: PolynomialSettings, record: Record, orders: Iterable[int] = ORDERS) -> int:
    """Return the order that the last third of a record prefers, of models fitted to the first two; see `order_of`.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((2, 1500))
    >>> lag = uq.StateSpace([[1.2, -0.6], [1.0, 0.0]], [[1.0, 0.3], [0.0, 0.0]], [[1.0, 0.4]], [[0.0, 0.0]], 100.0)
    >>> y = lag.simulate(u) + 0.1 * rng.standard_normal((1, 1500))
    >>> chosen_order(uq.identify.OutputError(), uq.Record(u, y, 100.0), orders=[1, 2, 3])
    2
    """
    return order_of(method, [record], orders).order


def order_of(
    method: PolynomialSettings,
    records: Sequence[Record],
    orders: Iterable[int] = ORDERS,
    own: Sequence[PolynomialSettings] | None = None,
) -> OrderChoice:
    """Return the order that the last thirds of records prefer, of models fitted to the first two thirds of each.

    It is the least whose one-step loss, in geometric mean over outputs and records, is within 2 % of the smallest: the
    rule of `sweep`, here for any number of inputs that move together. Orders are tried that the longest record can
    carry, on all records that can carry them too.

    Args:
        method: the structure, whose order is varied.
        records: inputs and outputs; the part that judges is at the end of each.
        orders: whole numbers.
        own: settings of each record where they differ.

    Raises:
        InputError: no records, no orders, or none that a record can carry.
    """
    if not records:
        raise InputError(f"{type(method).__name__}: no records were given; at least one is needed.")
    fitted = [record.part(0, max(1, int(FITTED_SHARE * record.samples))) for record in records]
    settings = [method] * len(records) if own is None else own
    longest = max(range(len(records)), key=lambda k: records[k].samples)
    tried = _carried(settings[longest], fitted[longest], sorted(orders))
    asked = [k for k in range(len(records)) if all(_refusal(settings[k].at_order(n), fitted[k]) is None for n in tried)]
    places = [(k, i) for k in asked for i in range(len(records[k].sensors))]

    def losses(place: tuple[int, int]) -> list[float]:
        k, i = place
        data = ChannelData.of(fitted[k], i)
        return [_loss_after(records[k], i, settings[k].at_order(n).fit(data, records[k].rate_hz)) for n in tried]

    table = in_threads("compare orders", losses, places)
    scores = np.exp(np.mean(np.log([table[place] for place in places]), axis=0))
    order = min(n for n, score in zip(tried, scores, strict=True) if score <= (1 + WORTH) * scores.min())
    return OrderChoice(order, tried[int(scores.argmin())], tuple(tried), sum(records[k].samples for k in asked))


def _carried(method: PolynomialSettings, record: Record, orders: Sequence[int]) -> list[int]:
    """Return the orders that a record can carry."""
    if not orders:
        raise InputError("chosen_order: no orders were given.")
    refusals = [_refusal(method.at_order(n), record) for n in orders]
    if refusals[0] is not None and None not in refusals:
        who, _, why = str(refusals[0]).partition(": ")
        raise InputError(f"{who}: order '{AUTO}' fits two thirds of the record, and the rest judges: {why}")
    return [n for n, refusal in zip(orders, refusals, strict=True) if refusal is None]


def _refusal(method: PolynomialSettings, record: Record) -> InputError | None:
    try:
        method.check(record)
        if method.informed:
            method.parameterisation(len(record.actuators))
    except InputError as error:
        return error
    return None


def _loss_after(record: Record, i: int, fit: Fit) -> float:
    """Return the variance of the one-step errors on the last third.

    The model runs through the whole record: begun at the cut it would be judged by the state that it does not know.
    """
    m, sensor, y = fit.model, record.sensors[i], record.outputs[i]
    least = LEAST_ERROR * float(np.var(y))
    if sensor.low > -np.inf or sensor.high < np.inf:
        simulated = prediction.simulate(record.inputs, y, m.b, [m.denominator(j) for j in range(len(m.b))])
        y = prediction.repaired(y, simulated, sensor.low, sensor.high)
    errors = prediction.innovations(record.inputs, y, m.a, m.b, m.f, m.c, m.d)[int(FITTED_SHARE * record.samples) :]
    return max(float(np.var(errors)), least)
