"""Confidence bands of a frequency response, from the covariance of the coefficients."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frozen, one_of, some_lines, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.validate.gradient import coefficients, matching, response_gradient, with_coefficients
from ultraquiet.values import FrequencyResponse, PolynomialMatrix, PolynomialModel
from ultraquiet.values.confidence.response_spread import ResponseSpread

DB = 20.0 / np.log(10.0)
METHODS = ("linearised", "sampled")
LEVELS = (0.01, 0.9999)
DRAWS = 400  # the 2.5 % quantile of so many draws errs by 0.8 % of probability


class Identified(Protocol):
    """A result of an identification: a polynomial model with the covariance of its coefficients, or one with `spread`.

    `spread`, where a result has one that is not None, says how far the response may lie off (`ResponseSpread`);
    `no_band` why there is none.
    """

    @property
    def model(self) -> Any:
        """The model."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """`(ny, p, p)`, or `(ny, nu, p, p)` for one record per actuator."""
        ...


@dataclass(frozen=True, eq=False)
class ResponseBand:
    """A frequency response with its confidence.

    Attributes:
        f_hz: `(nf,)`.
        values: `(ny, nu, nf)` response of the model.
        covariance: `(ny, nu, nf, 2, 2)` of its real and imaginary part.
        gain_db, gain_low_db, gain_high_db: `(ny, nu, nf)` gain and its band, line by line.
        phase_deg, phase_low_deg, phase_high_deg: likewise.
        level: probability with which a band holds the truth at one line.
        method: `linearised` or `sampled`.
    """

    f_hz: FloatArray
    values: ComplexArray
    covariance: FloatArray
    gain_db: FloatArray
    gain_low_db: FloatArray
    gain_high_db: FloatArray
    phase_deg: FloatArray
    phase_low_deg: FloatArray
    phase_high_deg: FloatArray
    level: float
    method: str

    @property
    def variance(self) -> FloatArray:
        """E |error|^2 at each line, `(ny, nu, nf)`."""
        return np.trace(self.covariance, axis1=-2, axis2=-1)

    @property
    def percent(self) -> FloatArray:
        """Standard deviation of the error in per cent of the gain at each line, `(ny, nu, nf)`."""
        with np.errstate(over="ignore"):  # over nothing at all
            return 100.0 * np.sqrt(self.variance) / np.maximum(np.abs(self.values), np.finfo(float).tiny)

    def distance(self, truth: ArrayLike) -> FloatArray:
        """Return the squared distance of another response in standard deviations, chi-squared with 2 degrees if true.

        Args:
            truth: `(ny, nu, nf)` complex.
        """
        off = np.asarray(truth) - self.values
        parts = np.stack([off.real, off.imag], axis=-1)[..., None]
        # Where the response is real (0 Hz) one direction has no spread: the pseudo-inverse leaves it out.
        near = np.linalg.pinv(self.covariance, rcond=1e-12, hermitian=True)
        return (np.swapaxes(parts, -1, -2) @ near @ parts)[..., 0, 0]

    def response(self) -> FrequencyResponse:
        """Return the response with its variance, as a measured one would carry it."""
        return FrequencyResponse(self.f_hz, self.values, estimator="model", variance=self.variance)


def response_band(
    result: Identified,
    f_hz: ArrayLike,
    level: float = 0.95,
    method: str = "linearised",
    draws: int = DRAWS,
    seed: int = 0,
) -> ResponseBand:
    """Return the response of an identified model and the band in which the truth lies with probability `level`.

    With g = dG / d theta and P the covariance of theta: cov(G) = [Re g; Im g]' P [Re g; Im g],
    var(ln G) = (g / G)' P (g / G), whose real part is the gain's (20 / ln 10 dB each) and imaginary part the phase's.
    The bands say what chance did to this record. They do not say what the structure left out: look at the residual
    tests first.

    Args:
        result: of an identification, for one record or one per actuator; of a state-space method its `spread` is asked.
        f_hz: `(nf,)` lines in Hz.
        level: probability at each line on its own, between 0 and 1.
        method: `linearised`, or `sampled`: quantiles over models drawn from N(theta, P), which follow the skew of wide
            bands (a gain known to 6 dB and worse).
        draws: how many, when sampled.
        seed: of the draws.

    Raises:
        InputError: a result that knows no band, and why; a level below 0.01 or above 0.9999; draws of a state space.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 2000))
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=10.0)
    >>> record = uq.Record(u, lag.state_space().simulate(u[None]) + 0.1 * e, 10.0)
    >>> band = response_band(uq.identify.OutputError(order=1).identify(record), [1.0])
    >>> bool(band.gain_high_db[0, 0, 0] - band.gain_low_db[0, 0, 0] < 0.2)
    True

    Reference: Ljung, System Identification, 2nd ed., section 9.4 and eq. (9.61).
    """
    who = "response_band"
    one_of(who, "method", method, METHODS)
    between(who, "level", level, *LEVELS)
    whole(who, "draws", draws, 10)
    whole(who, "seed", seed, 0)
    f = some_lines(who, f_hz)
    if (spread := spread_of(who, result)) is not None:
        if method == "sampled":
            raise InputError(f"{who}: a state space has no coefficients to be sampled; take method='linearised'.")
        return drawn_band(who, result.model.frequency_response(f), spread, f, level)
    bands = [
        _band(who, m, P, f, level, (draws, seed) if method == "sampled" else None) for m, P in channels(who, result)
    ]
    ny = len(result.model.rows)
    tables = [np.concatenate(part).reshape(ny, -1, *part[0].shape[1:]) for part in zip(*bands, strict=True)]
    return ResponseBand(frozen(f), *tables, level=level, method=method)


def spread_of(who: str, result: Identified) -> ResponseSpread | None:
    """Return how far a result's response may lie off; None where coefficients with their covariance say it.

    Raises:
        InputError: it is no result, or says that it knows no band.
    """
    _known(who, result)
    reason = getattr(result, "no_band", "")
    if reason:
        raise InputError(f"{who}: {reason}")
    spread: ResponseSpread | None = getattr(result, "spread", None)
    return spread


def _known(who: str, result: Any) -> None:
    """Refuse what is no result of an identification, a model alone above all."""
    if not (hasattr(result, "model") and hasattr(result, "covariance")):
        raise InputError(
            f"{who}: 'result' must be what an identification returned, with its covariance, got "
            f"{type(result).__name__}."
        )


def moved_by(who: str, spread: ResponseSpread, f: FloatArray) -> ComplexArray:
    """Return the directions of a spread, `(ny, nu, nf, k)`.

    Raises:
        InputError: the model has poles so near to each other that no band can be drawn.
    """
    try:
        return spread.directions(f)
    except (NumericalError, np.linalg.LinAlgError) as error:
        raise InputError(f"{who}: no band: {error}") from None


def drawn_band(who: str, G: ComplexArray, spread: ResponseSpread, f: FloatArray, level: float) -> ResponseBand:
    """Return the linearised band of a response G from its spread.

    Raises:
        InputError: the model has poles so near to each other that no band can be drawn.
    """
    X = moved_by(who, spread, f)
    parts = np.stack([X.real, X.imag], axis=-2)
    sides = _sides(G, X, level)
    return ResponseBand(frozen(f), G, parts @ np.swapaxes(parts, -1, -2), *sides, level=level, method="linearised")


def _sides(G: ComplexArray, X: ComplexArray, level: float) -> tuple[FloatArray, ...]:
    """Return middle, low and high of gain (dB) and phase (degrees) of a response that X moves, line by line."""
    from scipy.special import ndtri

    z = float(ndtri(0.5 + level / 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        gain, phase = DB * np.log(np.abs(G)), np.degrees(np.unwrap(np.angle(G), axis=-1))
        relative = X / G[..., None]
    wide = z * DB * np.linalg.norm(relative.real, axis=-1)
    turn = z * np.degrees(np.linalg.norm(relative.imag, axis=-1))
    return gain, gain - wide, gain + wide, phase, phase - turn, phase + turn


def channels(who: str, result: Identified) -> Iterator[tuple[PolynomialModel, FloatArray]]:
    """Yield every model of the result's matrix, row by row, with its covariance."""
    _known(who, result)
    if not isinstance(result.model, PolynomialMatrix):
        raise InputError(
            f"{who}: this asks for the covariance of coefficients, which a {type(result.model).__name__} does not "
            f"carry; take 'state_space_band', a polynomial method, or the spread over several records."
        )
    for i, row in enumerate(result.model.rows):
        for j, model in enumerate(row):
            P = np.asarray(result.covariance[i, j] if result.covariance.ndim == 4 else result.covariance[i])
            p = coefficients(model).size
            if p < len(P) and not np.any(np.isfinite(P[p:, p:])):
                P = P[:p, :p]  # a matrix of several orders: beyond a channel's own there is nothing
            yield model, matching(who, model, P)


def root(P: FloatArray) -> FloatArray:
    """Return L with L L' = P, for covariances that rounding has left a hair indefinite."""
    size = np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(P / np.outer(size, size))
    return size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _band(
    who: str, model: PolynomialModel, P: FloatArray, f: FloatArray, level: float, sampling: tuple[int, int] | None
) -> tuple[ComplexArray | FloatArray, ...]:
    """Return values, covariance, and the gain's and phase's middle, low and high, each `(nu, nf, ...)`."""
    G = model.frequency_response(f)[0]
    moved = np.einsum("jpf,pq->jfq", response_gradient(model, f), root(P))
    parts = np.stack([moved.real, moved.imag], axis=-2)
    covariance = parts @ np.swapaxes(parts, -1, -2)
    gain, gain_low, gain_high, phase, phase_low, phase_high = _sides(G, moved, level)
    if sampling is None:
        return G, covariance, gain, gain_low, gain_high, phase, phase_low, phase_high
    ratio = _sampled_responses(model, P, f, *sampling) / G
    tail = (1 - level) / 2
    low_db, high_db = np.quantile(DB * np.log(np.abs(ratio)), [tail, 1 - tail], axis=0)
    low, high = np.quantile(np.degrees(np.angle(ratio)), [tail, 1 - tail], axis=0)
    return G, covariance, gain, gain + low_db, gain + high_db, phase, phase + low, phase + high


def _sampled_responses(model: PolynomialModel, P: FloatArray, f: FloatArray, draws: int, seed: int) -> ComplexArray:
    """Return responses `(draws, nu, nf)` of models drawn from N(theta, P)."""
    theta, L = coefficients(model), root(P)
    steps = np.random.default_rng(seed).standard_normal((draws, theta.size))
    return np.stack([with_coefficients(model, theta + L @ s).frequency_response(f)[0] for s in steps])
