"""State space from a measured response by maximum likelihood: every line weighs what its noise leaves of it."""

from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, one_of, whole, yes_or_no
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.identify import chance
from ultraquiet.identify.record_checks import exciting, usable
from ultraquiet.identify.response.data import WHO, Data, from_periods, from_record, from_response, told_by_lines
from ultraquiet.identify.response.follows_inputs import MISSED, unless_followed
from ultraquiet.identify.response.model import WeightedFit
from ultraquiet.identify.response.verdict import missed, not_converged, verdict, whiteness
from ultraquiet.identify.result import SIGNIFICANCE, Result, worst
from ultraquiet.identify.searched_order import Auto, SearchedOrder
from ultraquiet.linalg.innovation import unknown_past
from ultraquiet.linalg.prediction import fit_percent
from ultraquiet.linalg.sections import delays, start
from ultraquiet.linalg.sections import search as sections
from ultraquiet.linalg.sections.realisation import realised
from ultraquiet.values import FrequencyResponse, Record, StateSpace
from ultraquiet.values.handed_over.kinds import takes_values

HIGHEST_ORDER = 60
# Lines per pole below which a fit would interpolate.
LINES_PER_POLE = 2
# So many pairs more without a better criterion end the search for the order.
PATIENCE = 3
# So many of the best starts run this far; the best of these runs to its end.
TRIALS = 2
TRIAL_STEPS = 15
# Pairs of poles exchanged at most, and by how many mean squared residuals one must lower the sum of squares.
EXCHANGES, WORTH = 4, 1.0
# Delays that a free one starts from, in quarters of the shortest period measured: beyond a half turn of the highest
# line the search would settle on a wrong one.
DELAYS = (0, 1, 2, 3, 4, 6, 8, 11, 15)
# Poles and a fraction of a sample stand in for each other: whole delays are tried so far around the free one.
DELAY_REACH = 3


class _OrderFit(NamedTuple):
    shape: sections.SectionShape
    point: sections.SectionFit
    steps: int
    converged: bool
    held_delay_s: float

    @property
    def parameters(self) -> int:
        return self.shape.nonlinear + self.point.rho.size


@register("identify", "weighted-rational")
@dataclass(frozen=True)
class WeightedRational(SearchedOrder):
    """Fit G = exp(-s tau) (D + sum_k N_k / den_k), common poles, by maximum likelihood.

    sum over channels and lines of |G - measured|^2 / variance is minimised by Levenberg-Marquardt over the poles, with
    the numerators projected out and an analytic Jacobian; it starts from vector fitting. All poles are stable at every
    step. The estimate reaches the Cramer-Rao bound; its covariance gives bands.

    Args:
        order: number of poles; chosen by `criterion` when "auto" or None.
        highest_order: the largest one tried then.
        delay_s: dead time: seconds in continuous time, whole samples beside the model's own one in discrete time; None
            estimates it, up to four periods of the highest line.
        feedthrough: give every channel a direct part.
        criterion: "mdl" (log of the sample size a parameter, finds the true order) or "aic" (two a parameter, keeps
            more poles).
        weigh: "noise" weighs every line by its variance, for the most precise model; "output" weighs the errors of an
            output alike at all lines of periods, for the best simulation when noise is not the chief error.
        floor: relative error below which precision is not worth having, added to the noise. A real plant has more poles
            than any model; a hundredth here asks for those that matter.
        iterations: accepted steps of the search.
        period_samples: for records that are periods of one excitation; others are fitted with their leakage.

    >>> rng = np.random.default_rng(0)
    >>> plant = StateSpace([[0.9, 0.2], [-0.2, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], rate_hz=100.0)
    >>> f = np.arange(1.0, 49.0)
    >>> noise = 0.01 * (rng.standard_normal((1, 1, f.size)) + 1j * rng.standard_normal((1, 1, f.size)))
    >>> measured = FrequencyResponse(f, plant.frequency_response(f) + noise, variance=np.full((1, 1, f.size), 2e-4))
    >>> found = WeightedRational(highest_order=4).identify_response(measured, rate_hz=100.0)
    >>> found.order, found.status.word, bool(np.abs(np.abs(found.model.poles()) - 0.922).max() < 0.01)
    (2, 'ok', True)

    Reference: R. Pintelon, J. Schoukens, System Identification (2012), chapters 9 and 11, doi:10.1002/9781118287422.
    """

    order: int | Auto | None = None
    highest_order: int = 20
    delay_s: float | None = 0.0
    feedthrough: bool = False
    criterion: str = "mdl"
    weigh: str = "noise"
    floor: float = 0.0
    iterations: int = 100
    period_samples: int | None = None

    def __post_init__(self) -> None:
        self.settle_order(HIGHEST_ORDER)
        whole(WHO, "highest_order", self.highest_order, 1, HIGHEST_ORDER)
        if self.delay_s is not None:
            between(WHO, "delay_s", self.delay_s, 0.0, 1e6, "s")
        yes_or_no(WHO, "feedthrough", self.feedthrough)
        one_of(WHO, "criterion", self.criterion, ("mdl", "aic"))
        one_of(WHO, "weigh", self.weigh, ("noise", "output"))
        between(WHO, "floor", self.floor, 0.0, 1.0)
        whole(WHO, "iterations", self.iterations, 1)
        if self.period_samples is not None:
            whole(WHO, "period_samples", self.period_samples, 2)

    @takes_values
    def identify(self, record: Record) -> Result:
        """Fit a record: its spectra with their leakage as one more input, or the mean of its periods.

        Raises:
            InputError: as `identify_response`; too few samples, a constant input or output.
        """
        usable(WHO, record, (self.given_order or 2) * (len(record.actuators) + 1), 64)
        exciting(WHO, record, 2 * (self.given_order or 2))
        if self.period_samples is not None:
            data = from_periods(record, self.period_samples, self.floor, self.weigh)
        else:
            data = from_record(record, self.floor)
        fitted = self._fit(data)
        return _result(self, fitted, record)

    @takes_values
    def identify_response(self, response: FrequencyResponse, rate_hz: float | None = None) -> WeightedFit:
        """Fit a measured response with a variance, as `spectra` gives it; `with_coherence_variance` makes one.

        Args:
            response: `(ny, nu, nf)`; lines without noise figure and 0 Hz are left out.
            rate_hz: sampling rate of the system wanted; None asks for continuous time.

        Raises:
            InputError: no variance, lines beyond half the rate, too few for the order or too far apart for the delay.
        """
        return self._fit(from_response(response, rate_hz, self.floor))

    @single_threaded
    def _fit(self, data: Data) -> WeightedFit:
        most = data.samples.f_rad.size // LINES_PER_POLE
        highest = min(self.highest_order, most) if self.given_order is None else self.given_order
        if highest > most or most < 1:
            raise InputError(
                f"{WHO}: order {highest} takes {LINES_PER_POLE * highest} lines, there are "
                f"{data.samples.f_rad.size}; measure more lines or lower the order."
            )
        told_by_lines(WHO, "delay_s", self.delay_s or 0.0, data.samples.f_rad / (2 * np.pi))
        fits: dict[int, _OrderFit] = {}
        scores: dict[int, float] = {}

        def try_order(n: int) -> None:
            smaller = fits.get(n - 2) or fits.get(n - 1)
            fits[n] = _at_order(self, data, n, smaller)
            scores[n] = _score(self.criterion, fits[n], data.rows)
            progress.advance(note=f"order {n}: {scores[n]:.6g}")

        # Pairs of poles come first, a single one beside the best number of pairs.
        evens = [*range(2, highest + 1, 2)] or [highest]
        with task("weighted rational fit", len(evens) + 2) as progress:
            for n in evens if self.given_order is None else [self.given_order]:
                if _exhausted(scores):
                    break
                try_order(n)
            if self.given_order is None:
                best = min(scores, key=lambda n: scores[n])
                for n in (best - 1, best + 1):
                    if 1 <= n <= highest and n not in fits:
                        try_order(n)
            best = min(scores, key=lambda n: scores[n])
            again, others = _over_delays(data, _at_order_again(self, data, best, fits))
            scores[best] += data.rows * float(np.log(again.point.cost / fits[best].point.cost))
            fits[best] = again
        best = min(scores, key=lambda n: scores[n])
        least = scores[best]
        return _finished(self, data, fits[best], others, {n: v - least for n, v in scores.items()})


def _exhausted(scores: dict[int, float]) -> bool:
    orders = sorted(scores)
    return len(orders) > PATIENCE and min(scores[n] for n in orders[-PATIENCE:]) > min(scores.values())


def _score(criterion: str, fit: _OrderFit, rows: int) -> float:
    """Return rows ln(cost) + penalty: the scale of the variance does not matter."""
    each = np.log(rows) if criterion == "mdl" else 2.0
    return float(rows * np.log(fit.point.cost / rows) + each * fit.parameters)


def _at_order(method: WeightedRational, data: Data, order: int, smaller: _OrderFit | None) -> _OrderFit:
    rate_hz = data.samples.rate_hz
    if method.delay_s is not None:
        delay_s = method.delay_s if rate_hz is None else round(method.delay_s * rate_hz) / rate_hz
        return _searched(method, data, sections.SectionShape(order, method.feedthrough, delay=False), delay_s, smaller)
    free = _searched(method, data, sections.SectionShape(order, method.feedthrough, delay=True), 0.0, smaller)
    if rate_hz is None:
        return free
    near = round(float(free.point.theta[-1]) * rate_hz)
    whole_samples = {max(0, near + k) for k in range(-DELAY_REACH, DELAY_REACH + 1)}
    shape = replace(free.shape, delay=False)
    tries = [_polished(method, data, shape, k / rate_hz, [free.point.theta[:-1]]) for k in sorted(whole_samples)]
    return min(tries, key=lambda t: t.point.cost)


def _at_order_again(method: WeightedRational, data: Data, order: int, fits: dict[int, _OrderFit]) -> _OrderFit:
    """Return the fit, or a better one from the next smaller orders where what it misses is no noise.

    Close modes make minima of their own; a fit without one of them shows where it is missing.
    """
    first = fits[order]
    if order < 3 or whiteness(first.point, first.parameters / data.rows) >= SIGNIFICANCE:
        return _exchanged(method, data, first)
    smaller = fits.get(order - 2) or _at_order(method, data, order - 2, None)
    second = _at_order(method, data, order, smaller)
    return _exchanged(method, data, second if second.point.cost < first.point.cost else first)


def _exchanged(method: WeightedRational, data: Data, fit: _OrderFit) -> _OrderFit:
    """Return the fit with pairs of poles put where it misses most, for those that do least, while that lowers the cost.

    A sharp mode shows at a few lines, weighs little there, and may be between those that starts are drawn from: two
    pairs then share one mode, or stand at noise, and no step leads away from there.
    """
    samples = data.late(fit.held_delay_s).samples
    wider = replace(fit.shape, order=fit.shape.order + 2)
    if fit.shape.order < 2 or LINES_PER_POLE * wider.order > samples.f_rad.size:
        return fit
    for _ in range(EXCHANGES):
        theta = start.enlarged(samples, fit.point, fit.shape.order, wider.order)
        point, _, _ = sections.search(samples, wider, theta, TRIAL_STEPS, data.slowest)
        starts = [np.delete(point.theta, [k, k + 1]) for k in range(0, fit.shape.order, 2)]
        other = _polished(method, data, fit.shape, fit.held_delay_s, starts)
        if other.point.cost > fit.point.cost * (1.0 - WORTH / data.rows):
            break
        fit = other
    return fit


def _over_delays(data: Data, fit: _OrderFit) -> tuple[_OrderFit, tuple[sections.SectionFit, ...]]:
    """Return the fit at the lowest of the minima that differ by a free delay, and the others."""
    if not fit.shape.delay:
        return fit, ()
    lowest, *others = delays.minima(data.samples, fit.shape, fit.point, TRIAL_STEPS, data.slowest)
    return fit._replace(point=lowest, converged=fit.converged or lowest is not fit.point), tuple(others)


def _searched(
    method: WeightedRational, data: Data, shape: sections.SectionShape, held_delay_s: float, smaller: _OrderFit | None
) -> _OrderFit:
    turned = data.late(held_delay_s)
    starts: list[FloatArray] = []
    top_hz = float(data.samples.f_rad[-1]) / (2 * np.pi)
    for quarter in DELAYS if shape.delay else (0,):
        extra_delay_s = quarter / (4 * top_hz)
        ahead = turned.late(extra_delay_s)
        section_starts = start.starts(ahead.samples, ahead.H, ahead.weight, replace(shape, delay=False))
        starts += [np.append(theta, extra_delay_s) if shape.delay else theta for theta in section_starts]
    if smaller is not None and smaller.shape.delay == shape.delay and smaller.held_delay_s == held_delay_s:
        starts.append(start.enlarged(turned.samples, smaller.point, smaller.shape.order, shape.order))
    return _polished(method, data, shape, held_delay_s, starts)


def _polished(
    method: WeightedRational, data: Data, shape: sections.SectionShape, held_delay_s: float, starts: list[FloatArray]
) -> _OrderFit:
    """Search from the best starts a little way, then to the end from where the cost is lowest."""
    samples = data.late(held_delay_s).samples
    first = sorted((sections.evaluate(samples, shape, theta) for theta in starts), key=lambda point: point.cost)
    slowest = data.slowest
    trials = [sections.search(samples, shape, point.theta, TRIAL_STEPS, slowest) for point in first[:TRIALS]]
    point, steps, converged = min(trials, key=lambda t: t[0].cost)
    if not converged:
        point, more, converged = sections.search(samples, shape, point.theta, method.iterations, slowest)
        steps += more
    return _OrderFit(shape, point, steps, converged, held_delay_s)


def _finished(
    method: WeightedRational,
    data: Data,
    fit: _OrderFit,
    others: tuple[sections.SectionFit, ...],
    scores: dict[int, float],
) -> WeightedFit:
    ny, nu = data.H.shape[:2]
    freedom = data.rows - fit.parameters
    cost = fit.point.cost / max(freedom, 1)
    p = whiteness(fit.point, fit.parameters / data.rows)
    delay = fit.held_delay_s + (float(fit.point.theta[-1]) if fit.shape.delay else 0.0)
    at_limit = method.given_order is None and fit.shape.order >= max(scores) and len(scores) > 1
    judged = verdict(cost, p, missed(fit.point), at_limit)
    return WeightedFit(
        model=_model(method, data, fit),
        status=judged if fit.converged else not_converged(fit.steps),
        order=fit.shape.order,
        delay_s=delay,
        cost=cost,
        whiteness_p=p,
        errors_by_order=scores,
        iterations=fit.steps,
        point=_of_inputs(fit.point, ny, nu),
        shape=fit.shape,
        samples=data.samples,
        outputs_inputs=(ny, nu),
        held_delay_s=fit.held_delay_s,
        other_minima=tuple((point.theta, point.cost) for point in others),
    )


def _of_inputs(point: sections.SectionFit, ny: int, nu: int) -> sections.SectionFit:
    """Return the point with numerators of the inputs alone, `(ny nu, 1, linear)`."""
    rho = point.rho if point.rho.shape[1] == 1 else point.rho[:, :nu]
    return point._replace(rho=rho.reshape(ny * nu, 1, -1))


def _model(method: WeightedRational, data: Data, fit: _OrderFit) -> StateSpace:
    ny, nu = data.H.shape[:2]
    rho = _of_inputs(fit.point, ny, nu).rho.reshape(ny, nu, -1)
    rate_hz = data.samples.rate_hz
    late = 0 if rate_hz is None else round(fit.held_delay_s * rate_hz)
    A, B, C, D = realised(data.samples, fit.shape, fit.point.theta, rho, 1.0 / float(data.weight.max()), late)
    provenance = Provenance("weighted-rational", asdict(method), parents=data.parents, versions=versions())
    return StateSpace(A, B, C, D, rate_hz, data.actuators, data.sensors, provenance)


def _result(method: WeightedRational, fitted: WeightedFit, record: Record) -> Result:
    simulated = fitted.model.simulate(record.inputs)
    miss = record.outputs - simulated
    residual = miss - unknown_past(fitted.model.A, fitted.model.C, miss)
    ny, numbers = len(record.sensors), chance.numbers_of(fitted.model.states, len(record.actuators))
    limit = max(MISSED, method.floor)
    statuses = [
        chance.unless_silent(
            unless_followed(fitted.status, e, y, record.inputs, record.rate_hz, limit),
            chance.explained(y, e),
            y.size,
            numbers,
        )
        for y, e in zip(record.outputs, residual, strict=True)
    ]
    provenance = Provenance("weighted-rational", asdict(method), parents=(record.hash,), versions=versions())
    return Result(
        model=fitted.model,
        status=worst(statuses),
        fit_percent=np.array([fit_percent(y, y - e) for y, e in zip(record.outputs, residual, strict=True)]),
        loss=np.mean(residual**2, axis=1),
        covariance=np.full((ny, 0, 0), np.nan),
        whiteness_p=np.full(ny, fitted.whiteness_p),
        correlation_p=np.full(ny, np.nan),
        iterations=np.full(ny, fitted.iterations),
        statuses=tuple(statuses),
        provenance=provenance,
        details={"order": fitted.order, "cost": fitted.cost, "delay_s": fitted.delay_s, "fit": fitted},
        spread=fitted,
    )
