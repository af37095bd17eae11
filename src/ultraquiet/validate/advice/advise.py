"""What is wrong with a record or a model, and what to do about it, in sentences.

Every advice rests on a test with a stated error rate or on a plain count; a good record and a good model hear nothing.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown.line import counted, p_in_words
from ultraquiet.linalg import prediction, score
from ultraquiet.validate.advice import model as advice_model
from ultraquiet.validate.advice.model import ALARM, Case, Said
from ultraquiet.validate.gradient import delay, matching
from ultraquiet.validate.predict import innovations, single_rows
from ultraquiet.validate.residuals import DEFAULT_LAGS, fitted_directions, origin_of
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record
from ultraquiet.values.handed_over.kinds import takes_values

# Readings that repeat their extreme so often in a row, in two places at least, stand at a limit nobody declared.
CLIPPED_RUN, CLIPPED_PLACES = 3, 2
OFFSET_SPREADS = 5.0  # a constant of so many standard deviations eats the sensor's range
SEGMENTS = 8
EXPLAINED_BY = {"delay", "trend", "stationarity", "feedback"}
SLOW_LINES = 8  # the lowest lines of what the input does not explain: the noise a drift must stand out of


@dataclass(frozen=True)
class Advice:
    """One thing to mend.

    Attributes:
        about: `clipping`, `offset`, `excitation`, `delay`, `feedback`, `trend`, `stationarity`, `order too low`,
            `order too high`, or `resolution`.
        channel: name of the sensor or actuator.
        sentence: what was seen, and what to do.
    """

    about: str
    channel: str
    sentence: str

    def __str__(self) -> str:
        return f"{self.about} ({self.channel}): {self.sentence}"


@takes_values
def advise(
    record: Record,
    model: PolynomialMatrix | PolynomialModel | None = None,
    covariance: FloatArray | None = None,
    origin: str = "auto",
) -> tuple[Advice, ...]:
    """Return what should be mended in a record, and in a model of it when one is given.

    Args:
        record: `(nu, n)` inputs and `(ny, n)` outputs.
        model: identified from it (or from another one); without it only clipping and offsets can be seen.
        covariance: `(ny, p, p)` of its coefficients: needed to tell an order too high or a delay too short.
        origin: see `residual_test`.

    Raises:
        InputError: a model of other channels or another rate, a record too short for the tests.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 2000))
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=10.0)
    >>> y = np.clip(lag.state_space().simulate(u[None])[0] + 0.1 * e, -1.0, 1.0)
    >>> [x.about for x in advise(uq.Record(u, y, 10.0))]
    ['clipping']

    Reference: Ljung, System Identification, 2nd ed., sections 14.1-14.5 and 16.5-16.7.
    """
    advices = list(_of_the_record(record))
    if model is None:
        return tuple(advices)
    chosen = origin_of(model, record) if origin == "auto" else origin
    e = innovations(model, record)
    for i, m in enumerate(single_rows(model, record)):
        usable = covariance is not None and bool(np.all(np.isfinite(covariance[i])))
        P = matching("advise", m, np.asarray(covariance[i])) if covariance is not None and usable else None
        fitted, spread = fitted_directions(m, record.inputs, record.outputs[i], e[i], chosen, P)
        case = Case(record, i, m, e[i], P, fitted, spread)
        from_checks = [Advice(*x) for check in CHECKS for x in check(case)]
        # What else was found explains a residual that follows something; only then the order is not to blame.
        blamed = {x.about for x in from_checks} & EXPLAINED_BY
        advices += from_checks if blamed else [*from_checks, *(Advice(*x) for x in _order_too_low(case))]
    return tuple(advices)


def _of_the_record(record: Record) -> Iterator[Advice]:
    for y, sensor, known in zip(record.outputs, record.sensors, record.clipped(), strict=True):
        count = known or _repeated_extremes(y)
        if count:
            where = "the sensor's limits" if known else f"{y.min():g} or {sensor.in_unit(y.max())}, again and again"
            mend = (
                "see that the model is of a method that repairs them ('output-error', 'box-jenkins')"
                if known
                else "declare the limits (Channel.low, Channel.high) so that identification can repair them"
            )
            yield Advice(
                "clipping",
                sensor.name,
                f"{count} of {y.size} readings stand at {where}; lower the excitation, or {mend}.",
            )
        spread = float(y.std())
        if spread > 0 and abs(float(y.mean())) > OFFSET_SPREADS * spread:
            yield Advice(
                "offset",
                sensor.name,
                f"The mean is {abs(float(y.mean())) / spread:.0f} standard deviations from zero; remove the constant "
                f"before the converter, or keep `offset=True` so that it is fitted.",
            )


def _repeated_extremes(y: FloatArray) -> int:
    """Return how many readings repeat the largest or least value in runs; 0 when that may be chance."""
    if np.ptp(y) == 0:
        return 0
    places, count = 0, 0
    for level in (y.max(), y.min()):
        at = np.concatenate([[0], (y == level).astype(int), [0]])
        edges = np.flatnonzero(np.diff(at))
        runs = edges[1::2] - edges[::2]
        places += int(np.count_nonzero(runs >= CLIPPED_RUN))
        count += int(runs[runs >= CLIPPED_RUN].sum())
    return count if places >= CLIPPED_PLACES else 0


def _delay_too_long(case: Case) -> Said:
    for j, (x, actuator) in enumerate(zip(case.record.inputs, case.record.actuators, strict=True)):
        model_delay = delay(case.model.b[j])
        if model_delay == 0:
            continue
        # What later lags explain is taken out first: a poor model alone must not look like a delay.
        later = score.shifted(x, model_delay, DEFAULT_LAGS)
        p = case.p_value(score.shifted(x, 0, model_delay), later)
        if p < ALARM:
            own = [case.p_value(score.shifted(x, k, 1), later) for k in range(model_delay)]
            first = next((k for k, one in enumerate(own) if one < ALARM), model_delay - 1)
            yield (
                "delay",
                actuator.name,
                f"Output '{case.sensor}' moves {counted(first, 'sample')} after the input, but the model waits "
                f"{model_delay} ({p_in_words(p)}); set delay={first}.",
            )


def _feedback(case: Case) -> Said:
    for x, actuator in zip(case.record.inputs, case.record.actuators, strict=True):
        p = case.p_value(score.shifted(x, -DEFAULT_LAGS, DEFAULT_LAGS), score.shifted(x, 0, DEFAULT_LAGS + 1))
        if p < ALARM:
            yield (
                "feedback",
                actuator.name,
                f"The input follows earlier disturbances of '{case.sensor}' ({p_in_words(p)}): the record was made in "
                f"closed loop. Keep a noise model (Box-Jenkins, ARMAX, a predictor subspace), never output error, and "
                f"excite from outside the loop.",
            )


def _trend(case: Case) -> Said:
    from scipy.special import fdtrc

    m, y = case.model, case.record.outputs[case.output]
    if not m.is_stable():
        return
    # Not on the residual: a noise model with a pole near z = 1 has swallowed the drift and left nothing there.
    rest = y - prediction.simulate(case.record.inputs, y, m.b, [m.denominator(j) for j in range(len(m.b))])
    ramp = np.linspace(-1.0, 1.0, y.size)
    rest = rest - rest.mean()
    slope = float(ramp @ rest) / float(ramp @ ramp)
    lines = np.abs(np.fft.rfft(rest - slope * ramp)[1 : SLOW_LINES + 1]) ** 2 / y.size
    # Each line holds two degrees of freedom of the same slow noise that the ramp, one, is measured against.
    p = float(fdtrc(1, 2 * SLOW_LINES, slope**2 * float(ramp @ ramp) / float(np.mean(lines))))
    slow_s = max(advice_model.slow_decays_s(m), default=0.0)
    if p < ALARM or slow_s > case.record.duration_s:
        how = p_in_words(p) if p < ALARM else f"the model took a real pole of {slow_s:.2g} s to follow it"
        yield (
            "trend",
            case.sensor,
            f"The output drifts over the record ({how}); wait until it has settled, or take the trend out before "
            f"identification.",
        )


def _stationarity(case: Case) -> Said:
    # Ranks of |e| (Kruskal and Wallis 1952): one outlier must neither make nor hide a change of level.
    n = case.e.size
    parts = np.array_split(np.argsort(np.argsort(np.abs(case.e))) - (n - 1) / 2, SEGMENTS)
    p = score.chi_squared(float(sum(x.sum() ** 2 / x.size for x in parts) * 12 / (n * (n + 1))), SEGMENTS - 1).p_value
    if p < ALARM:
        middle = np.median(case.e**2)
        levels = [10 * np.log10(np.median(x) / middle) for x in np.array_split(case.e**2, SEGMENTS)]
        yield (
            "stationarity",
            case.sensor,
            f"The disturbance changes its level during the record, from {min(levels):+.1f} to {max(levels):+.1f} dB "
            f"about its median ({p_in_words(p)}); find what came on or off, or identify the quiet part (record.part).",
        )


def _order_too_low(case: Case) -> Said:
    white = case.p_value(score.shifted(case.e, 1, DEFAULT_LAGS))
    free = min(case.p_value(score.shifted(x, 0, DEFAULT_LAGS + 1)) for x in case.record.inputs)
    if min(white, free) < ALARM / (1 + len(case.record.inputs)):
        what = "its own past" if white < free else "the input"
        yield (
            "order too low",
            case.sensor,
            f"The residual still follows {what} ({p_in_words(min(white, free))}); raise the order, take a structure "
            f"with a noise model of its own (Box-Jenkins), or try other starts (horizons).",
        )


CHECKS: tuple[Callable[[Case], Said], ...] = (
    advice_model.excitation,
    _delay_too_long,
    advice_model.delay_too_short,
    _feedback,
    _trend,
    _stationarity,
    advice_model.order_too_high,
    advice_model.resolution,
)
