"""Long linear models on short records: impulse responses and ARX with priors that the data itself chooses."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.identify.record_checks import exciting, usable
from ultraquiet.identify.regularised import marginal_likelihood
from ultraquiet.identify.result import SIGNIFICANCE, Result, worst
from ultraquiet.linalg import portmanteau, prediction
from ultraquiet.linalg.finite_response import HankelForm, response_of
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, StateSpace, Status, StatusWord

KERNELS = ("tc", "dc", "ss")
MOST_TAPS = 200  # of one path when none are asked for
MOST_UNKNOWNS = 600  # of one output: each step of the search costs their cube
SAMPLES_PER_TAP = 3  # when none are asked for; a prior carries what least squares could not
ARX_LAGS = 30
LEAST_LINES = 4  # parameters that an input must carry: a steady tone carries two, and the prior would invent the rest
TEST_LAGS = 40
RESIDUAL_LAGS = 200  # of the error's own memory that enter the variance of its test
RAN_OUT = 0.05  # of the response's norm in its last twentieth: it had not decayed
LAST = 20


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
class _Regularised:
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


@register("identify", "impulse")
@dataclass(frozen=True)
class ImpulseResponse(_Regularised):
    """y(t) = sum_j sum_k g_jk u_j(t - k) + constant + e(t), with a Gaussian prior on smooth, decaying g.

    The prior's kernel over taps k, l (counted from the first),
        TC: c exp(-b max(k, l)),  DC: c exp(-b (k + l) / 2) r^|k - l|,
        SS: c (exp(-b (k + l + max)) / 2 - exp(-3 b max) / 6),
    has c, b and r per input from the largest marginal likelihood of the record itself. No order is chosen, nothing is
    unstable, and short, noisy records give far better responses than least squares.

    Args:
        taps: samples of each response; when absent as many as a third of the record carries, at most 200.
        delay: samples from an input to its first effect.
        kernel: "tc", "dc" or "ss".
        initial: "estimate" leaves out the first samples, whose past inputs are not on record; "rest" takes these inputs
            as zero.

    Returns of `identify`: a `Result` whose model has F = 1 and B = the response, `covariance` that of the posterior,
    with what the hyper-parameters' own uncertainty and a slow tail below the noise add to it. There is no noise model:
    `loss` is the mean squared simulated error, and `not white` says that it still holds something of the inputs before
    the last tap, or that the response had not decayed there. `result.state_space()` is a balanced truncation.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(0)
    >>> u, g = rng.standard_normal(400), 0.8 ** np.arange(30)
    >>> y = np.convolve(u, np.concatenate([[0.0], g]))[:400] + 0.1 * rng.standard_normal(400)
    >>> result = uq.identify.ImpulseResponse(taps=40).identify(uq.Record(u, y, rate_hz=100.0))
    >>> bool(np.abs(result.model.rows[0][0].b[0][1:31] - g).max() < 0.05)
    True

    Reference: Chen, Ohlsson, Ljung 2012, doi:10.1016/j.automatica.2012.05.026.
    """

    name: ClassVar[str] = "impulse"

    taps: int | None = None
    delay: int = 1
    kernel: str = "dc"
    initial: str = "estimate"

    def __post_init__(self) -> None:
        if self.taps is not None:
            whole("ImpulseResponse", "taps", self.taps, 2, 2000)
        whole("ImpulseResponse", "delay", self.delay, 0, 1000)
        one_of("ImpulseResponse", "kernel", self.kernel, KERNELS)
        one_of("ImpulseResponse", "initial", self.initial, ("estimate", "rest"))

    def identify(self, record: Record) -> ResponseResult:
        """Return one response per input and output.

        Raises:
            InputError: too few samples, a constant input or output.
        """
        nu, ny = record.inputs.shape[0], record.outputs.shape[0]
        m = self._taps(record)
        start = self.delay + m - 1 if self.initial == "estimate" else 0
        usable("ImpulseResponse", record, marginal_likelihood.KERNELS[self.kernel][1] * nu, start)
        exciting("ImpulseResponse", record, LEAST_LINES)
        fits = [self._fit(record, i, record.inputs, [self.delay] * nu, [m] * nu, self.kernel, start) for i in range(ny)]
        g = np.stack([f[0].reshape(nu, m) for f in fits])
        models = [
            PolynomialModel(
                [np.concatenate([np.zeros(self.delay), x]) for x in g[i]],
                [[1.0]] * nu,
                record.rate_hz,
                noise_variance=fits[i][2].variance * float(record.outputs[i].var()),
            )
            for i in range(ny)
        ]
        deviation = np.stack([np.sqrt(np.diag(f[1])).reshape(nu, m) for f in fits])
        details = {"response": g, "deviation": deviation, "delay": self.delay, "eta": tuple(f[2].eta for f in fits)}
        return self._result(record, models, fits, start, details)

    def _taps(self, record: Record) -> int:
        nu = record.inputs.shape[0]
        share = record.samples // (SAMPLES_PER_TAP * nu)
        return self.taps or max(2, min(MOST_TAPS, MOST_UNKNOWNS // nu, share))

    def _result(
        self,
        record: Record,
        models: list[PolynomialModel],
        fits: list[tuple[FloatArray, FloatArray, marginal_likelihood.Posterior]],
        start: int,
        details: dict[str, object],
    ) -> ResponseResult:
        errors = [_error(m, record, i)[start:] for i, m in enumerate(models)]
        errors = [e - e.mean() for e in errors]
        lags, memory = min(TEST_LAGS, errors[0].size // 10), min(RESIDUAL_LAGS, errors[0].size // 10)
        free = [_free_of_earlier(e, record.inputs, models[0].b[0].size, lags, memory) for e in errors]
        g = np.asarray(details["response"])
        statuses = [
            _verdict(f[2].converged, p, float(_left(g[i]).max()))
            for i, (f, p) in enumerate(zip(fits, free, strict=True))
        ]
        provenance = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        return ResponseResult(
            model=PolynomialMatrix([[m] for m in models], record.actuators, record.sensors, provenance),
            status=worst(statuses),
            fit_percent=np.array(
                [prediction.fit_percent(y[start:], y[start:] - e) for y, e in zip(record.outputs, errors, strict=True)]
            ),
            loss=np.array([float(np.mean(e**2)) for e in errors]),
            covariance=np.stack([f[1] for f in fits]),
            whiteness_p=np.array([portmanteau.ljung_box(e, lags).p_value for e in errors]),
            correlation_p=np.array(free),
            iterations=np.array([f[2].evaluations for f in fits]),
            statuses=tuple(statuses),
            provenance=provenance,
            details=details,
        )


@register("identify", "arx-regularised")
@dataclass(frozen=True)
class RegularisedArx(_Regularised):
    """A y = B u + e with many lags and the impulse response's prior on the coefficients of A and of each B.

    The one-step predictor of any linear plant and noise is two impulse responses, from the inputs and from the past
    output: an ARX model of many lags holds both, whatever the order, and in closed loop too. The prior keeps the
    variance of so many coefficients down.

    Args:
        lags: coefficients of A and of each B.
        delay: samples from an input to its first effect.
        kernel: "tc", "dc" or "ss"; see `ImpulseResponse`.

    Returns of `identify`: a `Result`; `not converged` when A has a root outside the unit circle, for then the model
    cannot simulate.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((2, 600))
    >>> y = np.zeros(600)
    >>> for t in range(2, 600):
    ...     y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + u[t - 1] + 0.1 * e[t]
    >>> result = uq.identify.RegularisedArx(lags=10).identify(uq.Record(u, y, rate_hz=100.0))
    >>> bool(result.fit_percent[0] > 85)
    True

    Reference: Chen, Ohlsson, Ljung 2012, doi:10.1016/j.automatica.2012.05.026; Pillonetto, Chiuso, De Nicolao 2011,
    doi:10.1016/j.automatica.2010.11.024.
    """

    name: ClassVar[str] = "arx-regularised"

    lags: int = ARX_LAGS
    delay: int = 1
    kernel: str = "dc"

    def __post_init__(self) -> None:
        whole("RegularisedArx", "lags", self.lags, 1, 500)
        whole("RegularisedArx", "delay", self.delay, 0, 1000)
        one_of("RegularisedArx", "kernel", self.kernel, KERNELS)

    def identify(self, record: Record) -> ResponseResult:
        """Return one model per output, driven by all inputs.

        Raises:
            InputError: too few samples, a constant input or output.
        """
        nu, ny, p = record.inputs.shape[0], record.outputs.shape[0], self.lags
        start = max(p, self.delay + p - 1)
        usable("RegularisedArx", record, marginal_likelihood.KERNELS[self.kernel][1] * (nu + 1), start)
        exciting("RegularisedArx", record, LEAST_LINES)
        fits = [
            self._fit(
                record,
                i,
                np.vstack([-record.outputs[i], record.inputs]),
                [1] + [self.delay] * nu,
                [p] * (nu + 1),
                self.kernel,
                start,
            )
            for i in range(ny)
        ]
        models = [
            PolynomialModel(
                [np.concatenate([np.zeros(self.delay), x]) for x in f[0].reshape(nu + 1, p)[1:]],
                [[1.0]] * nu,
                record.rate_hz,
                a=np.concatenate([[1.0], f[0][:p]]),
                noise_variance=f[2].variance * float(record.outputs[i].var()),
            )
            for i, f in enumerate(fits)
        ]
        return self._result(record, models, fits, start)

    def _result(
        self,
        record: Record,
        models: list[PolynomialModel],
        fits: list[tuple[FloatArray, FloatArray, marginal_likelihood.Posterior]],
        start: int,
    ) -> ResponseResult:
        residuals = [
            prediction.innovations(record.inputs, y, m.a, m.b, m.f, m.c, m.d)[start:]
            for y, m in zip(record.outputs, models, strict=True)
        ]
        lags = min(TEST_LAGS, residuals[0].size // 10)
        white = np.array([portmanteau.ljung_box(e, lags).p_value for e in residuals])
        free = np.array(
            [
                portmanteau.sidak(portmanteau.cross_correlation(e, u[start:], lags).p_value for u in record.inputs)
                for e in residuals
            ]
        )
        statuses = [
            _arx_verdict(m, f[2].converged, float(w), float(c))
            for m, f, w, c in zip(models, fits, white, free, strict=True)
        ]
        provenance = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        return ResponseResult(
            model=PolynomialMatrix([[m] for m in models], record.actuators, record.sensors, provenance),
            status=worst(statuses),
            fit_percent=np.array([_simulated_fit(m, record, i) for i, m in enumerate(models)]),
            loss=np.array([float(np.mean(e**2)) for e in residuals]),
            covariance=np.stack([f[1] for f in fits]),
            whiteness_p=white,
            correlation_p=free,
            iterations=np.array([f[2].evaluations for f in fits]),
            statuses=tuple(statuses),
            provenance=provenance,
            details={"eta": tuple(f[2].eta for f in fits)},
        )


def _error(model: PolynomialModel, record: Record, i: int) -> FloatArray:
    """Return output less response, from rest, and the constant that is left of it."""
    from scipy.signal import fftconvolve

    n = record.samples
    out = record.outputs[i] - sum(fftconvolve(u, b)[:n] for u, b in zip(record.inputs, model.b, strict=True))
    return np.asarray(out)


def _free_of_earlier(e: FloatArray, u: FloatArray, length: int, lags: int, memory: int) -> float:
    """Return the p-value that the last e.size errors hold nothing of inputs `length` and more samples ago."""
    n = u.shape[1]
    first = max(0, n - e.size - length)
    used = n - length - first
    if used <= lags + memory:
        return 1.0
    e = e[-used:]
    return portmanteau.sidak(portmanteau.cross_correlation(e, x[first : n - length], lags, memory).p_value for x in u)


def _left(g: FloatArray) -> FloatArray:
    """Return per input which share of the response's norm its last twentieth holds."""
    last = max(1, g.shape[1] // LAST)
    return np.linalg.norm(g[:, -last:], axis=1) / np.maximum(np.linalg.norm(g, axis=1), np.finfo(float).tiny)


def _verdict(converged: bool, p: float, left: float) -> Status:
    if not converged:
        return _unsettled()
    if p < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The error holds something of inputs before the last tap (p = {p:.1e}): raise 'taps'.",
        )
    if left > RAN_OUT:
        return Status(
            StatusWord.NOT_WHITE, f"The last twentieth of the taps holds {left:.0%} of the response: raise 'taps'."
        )
    return Status(StatusWord.OK, f"The response has decayed, and the error is free of earlier inputs (p = {p:.2f}).")


def _unsettled() -> Status:
    return Status(
        StatusWord.NOT_CONVERGED, "The search for the prior ended away from a maximum of the marginal likelihood."
    )


def _arx_verdict(model: PolynomialModel, converged: bool, white: float, free: float) -> Status:
    if not model.is_stable():
        return Status(
            StatusWord.NOT_CONVERGED, "A has a root outside the unit circle, the model cannot simulate: lower 'lags'."
        )
    if not converged:
        return _unsettled()
    if min(white, free) < SIGNIFICANCE:
        what = "is not white" if white < free else "still holds something of the input"
        return Status(StatusWord.NOT_WHITE, f"The residual {what} (p = {min(white, free):.1e}): raise 'lags'.")
    return Status(StatusWord.OK, f"The residual is white (p = {white:.2f}) and free of the input (p = {free:.2f}).")


def _simulated_fit(model: PolynomialModel, record: Record, i: int) -> float:
    y = record.outputs[i]
    f = [model.denominator(j) for j in range(len(model.b))]
    return prediction.fit_percent(y, prediction.simulate(record.inputs, y, model.b, f))
