"""Long impulse responses on short records, with priors that the data itself chooses."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, whole
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify import chance
from ultraquiet.identify.record_checks import exciting, usable
from ultraquiet.identify.regularised import marginal_likelihood
from ultraquiet.identify.regularised.posterior import (
    KERNELS,
    LEAST_LINES,
    TEST_LAGS,
    RegularisedFit,
    ResponseResult,
    unless_guessed,
    unsettled,
)
from ultraquiet.identify.result import SIGNIFICANCE, worst
from ultraquiet.linalg import portmanteau, prediction
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

MOST_TAPS = 200  # of one path when none are asked for
MOST_UNKNOWNS = 600  # of one output: each step of the search costs their cube
SAMPLES_PER_TAP = 3  # when none are asked for; a prior carries what least squares could not
RESIDUAL_LAGS = 200  # of the error's own memory that enter the variance of its test
RAN_OUT = 0.05  # of the response's norm in its last twentieth: it had not decayed
LAST = 20


@register("identify", "impulse")
@dataclass(frozen=True)
class ImpulseResponse(RegularisedFit):
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

    @takes_values
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
            chance.unless_silent(
                _verdict(f[2].converged, p, float(_left(g[i]).max())),
                chance.explained(record.outputs[i, start:], errors[i]),
                errors[i].size,
                f[2].freedom,
                p,
            )
            for i, (f, p) in enumerate(zip(fits, free, strict=True))
        ]
        size = np.repeat(record.inputs.std(axis=1), g.shape[2])
        statuses = [
            unless_guessed(status, float(np.sum((size * f[0]) ** 2)), float(size**2 @ np.diag(f[1])))
            for status, f in zip(statuses, fits, strict=True)
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
        return unsettled()
    if p < SIGNIFICANCE:
        return Status(
            StatusWord.NOT_WHITE,
            f"The error holds something of inputs before the last tap ({p_in_words(p)}): raise 'taps'.",
        )
    if left > RAN_OUT:
        return Status(
            StatusWord.NOT_WHITE, f"The last twentieth of the taps holds {left:.0%} of the response: raise 'taps'."
        )
    return Status(
        StatusWord.OK, f"The response has decayed, and the error is free of earlier inputs ({p_in_words(p)})."
    )
