"""What a state-space model is worth: evidence, verdict, and the result that carries both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify import chance
from ultraquiet.identify.feedback import unless_answered
from ultraquiet.identify.record_checks import parameters_carried
from ultraquiet.identify.result import SIGNIFICANCE, Result, noiseless, shares_of, worst
from ultraquiet.identify.subspace.fit import Scaled, System
from ultraquiet.linalg import balance, portmanteau, prediction, response
from ultraquiet.values import Channel, InnovationForm, Record, Status, StatusWord
from ultraquiet.values.confidence.response_spread import PredictedSpread, ResponseSpread, SimulatedSpread

TEST_LAGS = 40
RESIDUAL_LAGS = 200  # the simulation error is coloured; this much of its memory enters the test's variance
SHIFTS = 4  # samples before and after, at which an input is looked for in the others
SAMPLES_PER_SHIFT = 10
OWN_SHARE = 1e-6  # of an input's power that the others do not explain; below it, its column of B has no meaning
SPARE_SHARE = 0.1  # of all modes that may be lost in the noise before the order is called too high
NOT_INVERTIBLE = "no band: the noise model is not invertible, so the one-step errors say nothing of the parameters."
UNSTABLE = "no band: the model is unstable and has no simulated error."
GROWTH = 10.0  # of the output's size from the first to the last tenth of a record, the input's being level


@dataclass(frozen=True)
class SearchSummary:
    """How the model was found: steps of the search, whether it came to its end, whether at one-step errors.

    `searched` is whether there was a search at all, `weighted` whether by the inverse covariance of the errors.
    """

    steps: int
    converged: bool
    predicts: bool
    searched: bool = True
    weighted: bool = True


def independent(who: str, record: Record) -> None:
    """Refuse inputs of which one can be had from the others, shifted or not: whose effect is whose is then unknown."""
    from ultraquiet.identify.subspace.kernels import hankel_gram

    nu, rows = len(record.actuators), 2 * SHIFTS + 1
    if nu == 1 or record.samples < SAMPLES_PER_SHIFT * nu * rows:
        return
    u = record.inputs - record.inputs.mean(axis=1, keepdims=True)
    G = hankel_gram(np.ascontiguousarray(u / u.std(axis=1, keepdims=True)), rows)
    for j, wire in enumerate(record.actuators):
        others = np.flatnonzero(np.arange(nu * rows) % nu != j)
        one = SHIFTS * nu + j
        known = np.linalg.lstsq(G[np.ix_(others, others)], G[others, one], rcond=None)[0]
        share = 1.0 - float(known @ G[others, one]) / float(G[one, one])
        if share < OWN_SHARE:
            raise InputError(
                f"{who}: all but {max(share, 0.0):.0e} of the power of input '{wire.name}' follows from the other "
                f"inputs, so whose effect is whose cannot be told; excite them independently, or leave it out with "
                f"record.pick."
            )


def judged(
    system: System,
    record: Record,
    data: Scaled,
    search: SearchSummary,
    provenance: Provenance,
    details: Mapping[str, Any],
) -> Result:
    """Return the result of a system in scaled units."""
    ny = len(record.sensors)
    v = data.y - system.simulated(data.u) if system.stable() else np.full_like(data.y, np.inf)
    e = system.errors(data.u, data.y)
    tested = e if search.predicts else v
    free = _free(system, tested, data.u, search.predicts)
    lags = min(TEST_LAGS, record.samples // 10)
    white = [portmanteau.ljung_box(x, lags).p_value for x in e]
    spare = spare_modes(system, data, search.predicts)
    growing_outputs = growing(record)
    shares = shares_of(tested, data.y)
    statuses = [
        _verdict(search, p, q if search.predicts else 1.0, spare, len(system.A), i in growing_outputs, noiseless(share))
        for i, (p, q, share) in enumerate(zip(free, white, shares, strict=True))
    ]
    told = _explained(system, data, v, e, search.predicts)
    if told is not None:
        statuses = [_unless_silent(*each, data.samples, system) for each in zip(statuses, free, told, strict=True)]
    statuses = unless_a_guess(statuses, parameters_carried(record.inputs), len(system.A))
    statuses = [unless_clipped(*each) for each in zip(statuses, record.clipped(), record.sensors, strict=True)]
    loss = np.mean(e**2, axis=1) * data.y_size[:, 0] ** 2
    model = modelled(system, e, record, data, provenance)
    spread, no_band = _spread(model, record, data, search)
    return Result(
        model=model,
        status=worst(statuses),
        fit_percent=np.array([prediction.fit_percent(y, y - x) for y, x in zip(data.y, v, strict=True)]),
        loss=loss,
        covariance=np.full((ny, 0, 0), np.nan),
        whiteness_p=np.array(white),
        correlation_p=np.array(free),
        iterations=np.full(ny, search.steps, dtype=np.int64),
        statuses=tuple(statuses),
        provenance=provenance,
        details={**details, "spare_modes": spare},
        spread=spread,
        no_band=no_band,
        past=len(system.A) / ny + 1,
    )


def unless_a_guess(statuses: Sequence[Status], told: Sequence[int], order: int) -> list[Status]:
    """Return the verdicts on all outputs, no praise where states have as many parameters as the inputs' lines tell.

    Poles, and a share of each in every path, meet so many lines whatever the plant does between them. `told` are the
    parameters of one output that the lines of each input tell.
    """
    ny = len(statuses)
    carried, needed = ny * sum(told), order * (1 + ny * len(told))
    if needed < carried:
        return list(statuses)
    guess = Status(
        StatusWord.UNKNOWN_IN_PART,
        f"The inputs hold spectral lines for about {carried} parameters, {order} states have {needed}: what the model "
        f"says between those lines is a guess; excite a band (noise, chirp, many tones).",
    )
    return [guess if status.ok else status for status in statuses]


def unless_clipped(status: Status, clipped: int, sensor: Channel, what: str = "the record") -> Status:
    """Return the verdict on one output, no praise where `clipped` of its readings stand at the sensor's limits.

    `what` is to be identified by a method that repairs them. A cut output is smaller than the plant's, and a model of
    it too, whatever its error holds of the inputs.
    """
    if not clipped or status.word not in (StatusWord.OK, StatusWord.NOT_WHITE):
        return status
    return Status(
        StatusWord.NOT_WHITE,
        f"{clipped} readings of '{sensor.name}' stand at its limits, and a subspace takes them as they are read; "
        f"identify {what} by 'output-error' or 'box-jenkins', which repair them, or lower the excitation.",
    )


def _explained(system: System, data: Scaled, v: FloatArray, e: FloatArray, predicts: bool) -> list[float] | None:
    """Return the share of each output that the inputs explain; None of an unstable model that simulates.

    The simulated error is set beside the outputs; of an unstable model, which has none, the one-step error beside what
    it would be without the inputs. A one-step error beside the outputs is no measure: a model of the noise tells more
    of them by their past than the autoregression that compares the two, and that is none of what the inputs explain.
    """
    if not (predicts or system.stable()):
        return None
    pair = (data.y, v) if system.stable() else (e + system.predicted_from_inputs(data.u), e)
    return [chance.explained(y, error) for y, error in zip(*pair, strict=True)]


def _unless_silent(status: Status, free: float, share: float, samples: int, system: System) -> Status:
    """Return the verdict on one output, that its inputs explain no more than chance would before spare modes."""
    numbers = chance.numbers_of(len(system.A), system.B.shape[1])
    spare = status.word is StatusWord.NOT_CONVERGED and chance.by_chance(share, samples, numbers)
    return chance.silence(share) if spare else chance.unless_silent(status, share, samples, numbers, free)


def _spread(
    model: InnovationForm, record: Record, data: Scaled, search: SearchSummary
) -> tuple[ResponseSpread | None, str]:
    """Return what the search's criterion leaves open of the response, or why that is not known."""
    if not search.searched:
        return None, "no band: the poles of a subspace without a search minimise nothing; take refine=True."
    weight = None if search.weighted else np.diag(1.0 / data.y_size[:, 0] ** 2)
    if search.predicts:
        return (PredictedSpread(model, record, weight), "") if model.is_invertible() else (None, NOT_INVERTIBLE)
    return (SimulatedSpread(model, record, weight), "") if model.is_stable() else (None, UNSTABLE)


def modelled(system: System, e: FloatArray, record: Record, data: Scaled, provenance: Provenance) -> InnovationForm:
    """Return the system in units of the record, in real modal blocks."""
    B, C, K = system.B / data.u_size.T, system.C * data.y_size, system.K / data.y_size.T
    D = system.D * data.y_size / data.u_size.T
    form = balance.modal(system.A, np.hstack([B, K]), C)
    errors = e * data.y_size
    nu = B.shape[1]
    return InnovationForm(
        form.A,
        form.B[:, :nu],
        form.C,
        D,
        form.B[:, nu:],
        errors @ errors.T / e.shape[1],
        record.rate_hz,
        record.actuators,
        record.sensors,
        provenance,
    )


def spare_modes(system: System, data: Scaled, predicts: bool) -> int:
    """Return how many modes the record cannot tell from noise: without them its errors hardly grow.

    Leaving a mode out, all others fitted again, raises the sum of squares of output i by c' (N^-1)^-1 c; in units of
    the error variance that must exceed log(samples) for each number the mode has.
    """
    form = balance.modal(system.A, np.hstack([system.B, system.K, system.x0[:, None]]), system.C)
    nu, ny, n = len(data.u), len(data.y), data.samples
    B, K, x0 = form.B[:, :nu], form.B[:, nu : nu + ny], form.B[:, -1]
    if predicts:
        drive = np.vstack([data.u, data.y - system.constant[:, None]])
        A, B = form.A - K @ form.C, np.hstack([B - K @ system.D, K])
        error = system.errors(data.u, data.y)
    elif system.stable():
        drive, A = data.u, form.A
        error = data.y - system.simulated(data.u)
    else:
        return 0
    order = len(A)
    x = response.simulate(A, B, np.eye(order), np.zeros((order, len(drive))), drive, x0)
    rows = np.vstack([x, data.u, np.ones((1, n))])
    return spare_of(form, rows @ rows.T, np.mean(error**2, axis=1), len(drive), n)


def spare_of(form: balance.Coordinates, N: FloatArray, squares: FloatArray, drives: int, n: int) -> int:
    """Return how many modes of a form cannot be told from noise; see `spare_modes`.

    Args:
        form: modal coordinates of the model.
        N: products of its states, the inputs and one, over the record.
        squares: mean squared error of each output.
        drives: signals that drive the states.
        n: samples.
    """
    size = np.sqrt(np.maximum(np.diag(N), np.finfo(float).tiny))
    inverse = np.linalg.pinv(N / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
    at, spare = 0, 0
    for states in form.blocks:
        block = slice(at, at + states)
        at += states
        c = form.C[:, block]
        raised = np.einsum("ia,ab,ib->i", c, np.linalg.pinv(inverse[block, block]), c)
        carried = float(np.sum(raised / np.maximum(squares, np.finfo(float).tiny)))
        spare += int(carried < states * (len(squares) + drives) * np.log(n))
    return spare


def too_many(spare: int, order: int) -> Status | None:
    """Return the verdict on an order of which so many modes cannot be told from noise, None where it has few such."""
    if spare <= SPARE_SHARE * order / 2:
        return None
    return Status(
        StatusWord.NOT_CONVERGED,
        f"Order {order} is more than the record carries: {spare} of its modes cannot be told from noise; lower the "
        f"order (None chooses it), or record longer.",
    )


def growing(record: Record) -> tuple[int, ...]:
    """Return the outputs that grow through the record while the inputs do not: the plant, or its loop, is unstable."""
    tenth = max(1, record.samples // 10)

    def growth(x: FloatArray) -> FloatArray:
        x = x - x.mean(axis=1, keepdims=True)
        early, late = x[:, : 5 * tenth].std(axis=1), x[:, -tenth:].std(axis=1)
        return late / np.maximum(early, np.finfo(float).tiny * GROWTH)

    level = max(1.0, float(growth(record.inputs).max()))
    return tuple(int(i) for i in np.flatnonzero(growth(record.outputs) > GROWTH * level))


def _free(system: System, tested: FloatArray, u: FloatArray, predicts: bool) -> list[float]:
    """Return the p-values that errors are free of the inputs."""
    span = portmanteau.slowest_period(np.linalg.eigvals(system.A).astype(np.complex128))
    memory = 0 if predicts else RESIDUAL_LAGS
    free = [free_of_inputs(x, u, memory, span) for x in tested]
    if not predicts or np.any(system.D) or not np.isfinite(tested).all():
        return free
    return [
        unless_answered(
            p, lambda x=x: free_of_inputs(x, u, 0, span, delayed=True), lambda x=x: portmanteau.fed_back(x, u).p_value
        )
        for x, p in zip(tested, free, strict=True)
    ]


def free_of_inputs(e: FloatArray, u: FloatArray, memory: int, span: int, delayed: bool = False) -> float:
    """Return the p-value that e, `(n,)`, coloured over `memory` samples, holds nothing of the inputs `span` back."""
    if not np.all(np.isfinite(e)):
        return 0.0
    lags = min(TEST_LAGS, e.size // 10)
    return portmanteau.free_of_inputs(e, u, lags, min(memory, e.size // 10), span, delayed)


def _verdict(
    search: SearchSummary, free: float, white: float, spare: int, order: int, grows: bool, exact: Status | None
) -> Status:
    if grows:
        return Status(
            StatusWord.NOT_CONVERGED,
            "The output grows through the record while the inputs do not: the plant is unstable, and a stable model "
            "says nothing of it; record it in a loop that holds it, and use 'predictor-subspace'.",
        )
    if exact is None and not search.converged:
        return Status(StatusWord.NOT_CONVERGED, f"The search ended away from a minimum after {search.steps} steps.")
    if exact is not None:  # there is no noise that a mode could be told from
        return exact
    if (beyond := too_many(spare, order)) is not None:
        return beyond
    if min(free, white) < SIGNIFICANCE:
        what = "still holds something of the inputs" if free <= white else "is not white"
        whose = "one-step" if search.predicts else "simulated"
        return Status(
            StatusWord.NOT_WHITE,
            f"The {whose} error {what} ({p_in_words(min(free, white))}): the order or the horizon leaves part of the "
            f"record unexplained.",
        )
    told = f"free of the inputs ({p_in_words(free)})"
    return Status(
        StatusWord.OK,
        f"The one-step error is white ({p_in_words(white)}) and {told}."
        if search.predicts
        else f"The simulated error is {told}.",
    )
