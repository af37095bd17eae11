"""ARX models of many lags, with priors that the data itself chooses."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, whole
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.shown.line import p_in_words
from ultraquiet.identify import chance
from ultraquiet.identify.feedback import free_of_inputs
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
from ultraquiet.identify.result import SIGNIFICANCE, noiseless, shares_of, worst
from ultraquiet.linalg import portmanteau, prediction
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

ARX_LAGS = 30
POINTS = 512  # frequencies of a response, or four a lag


@register("identify", "arx-regularised")
@dataclass(frozen=True)
class RegularisedArx(RegularisedFit):
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

    @takes_values
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
        free = np.array([free_of_inputs(e, record.inputs[:, start:], lags, self.delay > 0) for e in residuals])
        fits_percent, told = zip(*[_simulated(m, record, i) for i, m in enumerate(models)], strict=True)
        statuses = [
            _arx_verdict(m, f[2].converged, float(w), float(c), float(shares_of(e[None], y[None])[0]))
            for m, f, w, c, e, y in zip(models, fits, white, free, residuals, record.outputs, strict=True)
        ]
        statuses = [
            chance.unless_silent(status, share, record.samples, f[2].freedom, float(c))
            for status, f, share, c in zip(statuses, fits, told, free, strict=True)
        ]
        size = record.inputs.std(axis=1)
        statuses = [
            unless_guessed(status, *_power(m, f[1], size, self.delay))
            for status, m, f in zip(statuses, models, fits, strict=True)
        ]
        provenance = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        return ResponseResult(
            model=PolynomialMatrix([[m] for m in models], record.actuators, record.sensors, provenance),
            status=worst(statuses),
            fit_percent=np.array(fits_percent),
            loss=np.array([float(np.mean(e**2)) for e in residuals]),
            covariance=np.stack([f[1] for f in fits]),
            whiteness_p=white,
            correlation_p=free,
            iterations=np.array([f[2].evaluations for f in fits]),
            statuses=tuple(statuses),
            provenance=provenance,
            details={"eta": tuple(f[2].eta for f in fits)},
        )


def _arx_verdict(model: PolynomialModel, converged: bool, white: float, free: float, share: float) -> Status:
    if not model.is_stable():
        return Status(
            StatusWord.NOT_CONVERGED, "A has a root outside the unit circle, the model cannot simulate: lower 'lags'."
        )
    exact = noiseless(share)
    if exact is not None:
        return exact
    if not converged:
        return unsettled()
    if min(white, free) < SIGNIFICANCE:
        what = "is not white" if white < free else "still holds something of the input"
        return Status(StatusWord.NOT_WHITE, f"The residual {what} ({p_in_words(min(white, free))}): raise 'lags'.")
    told = f"white ({p_in_words(white)}) and free of the input ({p_in_words(free)})"
    return Status(StatusWord.OK, f"The residual is {told}.")


def _power(model: PolynomialModel, covariance: FloatArray, size: FloatArray, delay: int) -> tuple[float, float]:
    """Return the mean square of the responses G_j = B_j / A over frequency, and how far it varies with A and B.

    Each in units of output per `size` of its input. To first order dG_j = (dB_j - G_j dA) / A, so that the deviation of
    a coefficient k samples late turns by e^-jwk and is weighed by G_j or 1.
    """
    lags = len(model.a) - 1
    points = max(POINTS, 4 * lags)
    turns = np.exp(-1j * np.pi * np.outer((np.arange(points) + 0.5) / points, np.arange(lags + delay + 1)))
    A = turns[:, : lags + 1] @ model.a
    power = variance = 0.0
    for j, b in enumerate(model.b):
        G = size[j] * (turns[:, : b.size] @ b) / A
        own = np.r_[:lags, (j + 1) * lags : (j + 2) * lags]
        moves = np.hstack([-G[:, None] * turns[:, 1 : lags + 1], size[j] * turns[:, delay : delay + lags]]) / A[:, None]
        power += float(np.mean(np.abs(G) ** 2))
        variance += float(np.mean(np.sum((moves @ covariance[np.ix_(own, own)]) * moves.conj(), axis=1).real))
    return power, variance


def _simulated(model: PolynomialModel, record: Record, i: int) -> tuple[float, float]:
    """Return the fit of the simulated output, and what it explains of the output."""
    y = record.outputs[i]
    f = [model.denominator(j) for j in range(len(model.b))]
    out = prediction.simulate(record.inputs, y, model.b, f)
    return prediction.fit_percent(y, out), chance.explained(y, y - out)
