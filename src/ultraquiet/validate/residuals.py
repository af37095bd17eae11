"""Residual tests: what a good model leaves behind is white and knows nothing of the input."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, frozen, one_of, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import portmanteau, prediction, score
from ultraquiet.validate.bands import root
from ultraquiet.validate.gradient import delay, matching
from ultraquiet.validate.predict import Model, innovations, single_rows
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record, StateSpace
from ultraquiet.values.handed_over.kinds import takes_values

DEFAULT_LAGS = 40
ORIGINS = ("auto", "this record", "another record", "exact")


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """Residuals of a model on a record, tested.

    Attributes:
        residuals: `(ny, n)` one-step prediction errors, or simulated ones, in output units.
        loss: `(ny,)` their mean square.
        autocorrelation: `(ny, lags)` at lags 1, 2, ...; inside +-1.96 / sqrt(n) for 95 % of the lags when white.
        whiteness_p: `(ny,)` p-value that the residual is white; small: it is not. NaN where it is a simulated error, of
            which no model says that it is white.
        correlation_p: `(ny, nu)` p-value that an output's residual is free of an input's present and past.
        feedback_p: `(ny, nu)` p-value that it is free of an input's future; small: the input was made from the output.
        origin: what the p-values take the coefficients for, see `residual_test`.
        simulated: whether the residual is that of the simulation, not of a prediction one step ahead.
    """

    residuals: FloatArray
    loss: FloatArray
    autocorrelation: FloatArray
    whiteness_p: FloatArray
    correlation_p: FloatArray
    feedback_p: FloatArray
    origin: str
    simulated: bool = False

    @property
    def band(self) -> float:
        """Half width of the 95 % band of each autocorrelation."""
        return 1.96 / float(np.sqrt(self.residuals.shape[1]))


@takes_values
def residual_test(
    model: PolynomialMatrix | PolynomialModel,
    record: Record,
    lags: int = DEFAULT_LAGS,
    origin: str = "auto",
    covariance: FloatArray | None = None,
) -> ResidualTest:
    """Return the residual e = (D/C)(A y - sum_j B_j/F_j u_j) and its tests, on any record of the model's channels.

    Each test takes Z, the residual's own past, or an input's past or future, and asks whether s = Z'e is larger than
    chance: s' V^-1 s is chi-squared. V knows where the coefficients come from. Fitted to this record they have already
    taken their share out of e, so that s varies less; from another record their errors put some into e, so that it
    varies more. With that left out, good models of the 3.5 kHz truth are called coloured on a second record in a third
    of all cases where 5 % were wanted.

    Args:
        model: what is tested, `(ny, nu)` channels.
        record: `(nu, n)` inputs and `(ny, n)` outputs at the model's rate.
        lags: how many lags each test takes.
        origin: where the coefficients come from: `this record`, `another record`, or `exact` (a truth). `auto` takes
            this record when the model's provenance names it, another one otherwise.
        covariance: `(ny, p, p)` of the coefficients from another record; when absent, that record is taken to be as
            informative as this one.

    Raises:
        InputError: other channels or another rate than the model's, fewer than 10 samples a lag.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(1)
    >>> u, e = rng.standard_normal((2, 1000))
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=1.0)
    >>> y = lag.state_space().simulate(u[None])[0] + 0.1 * e
    >>> test = uq.validate.residual_test(lag, uq.Record(u, y, rate_hz=1.0), origin="exact")
    >>> bool(test.whiteness_p[0] > 0.001), bool(test.correlation_p[0, 0] > 0.001)
    (True, True)

    Reference: Ljung, System Identification, 2nd ed., section 16.6; Breusch 1978,
    doi:10.1111/j.1467-8454.1978.tb00635.x.
    """
    who = "residual_test"
    one_of(who, "origin", origin, ORIGINS)
    whole(who, "lags", lags, 1)
    if record.samples < 10 * lags:
        raise InputError(f"{who}: {lags} lags need at least {10 * lags} samples, the record has {record.samples}.")
    same_rate(who, "the model", model.rate_hz, "the record", record.rate_hz)
    origin = origin_of(model, record) if origin == "auto" else origin
    e = innovations(model, record)
    p = []
    for i, m in enumerate(single_rows(model, record)):
        # A search that failed may leave a covariance of NaN: its model is judged as one without.
        known = covariance is not None and bool(np.all(np.isfinite(covariance[i])))
        P = matching(who, m, np.asarray(covariance[i])) if covariance is not None and known else None
        p.append(_p_values(m, record.inputs, record.outputs[i], e[i], lags, origin, P))
    white, past, future = (np.array(x) for x in zip(*p, strict=True))
    return ResidualTest(
        frozen(e),
        np.mean(e**2, axis=1),
        np.stack([portmanteau.autocorrelation(x, lags) for x in e]),
        white,
        past,
        future,
        origin,
    )


def origin_of(model: Model, record: Record) -> str:
    """Return whether the model names this record as the one it was made from."""
    named = isinstance(model, PolynomialMatrix | StateSpace) and record.hash in model.provenance.parents
    return "this record" if named else "another record"


def _p_values(
    m: PolynomialModel, u: FloatArray, y: FloatArray, e: FloatArray, lags: int, origin: str, P: FloatArray | None
) -> tuple[float, list[float], list[float]]:
    """Return the p-values of whiteness, and of freedom from each input's past and future."""
    fitted, spread = fitted_directions(m, u, y, e, origin, P)

    def p(Z: FloatArray) -> float:
        return score.score_test(e, Z, fitted, spread).p_value

    return (
        p(score.shifted(e, 1, lags)),
        [p(score.shifted(x, 0, lags + 1)) for x in u],
        [p(score.shifted(x, -lags, lags)) for x in u],
    )


def fitted_directions(
    m: PolynomialModel, u: FloatArray, y: FloatArray, e: FloatArray, origin: str, P: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """Return what was fitted to this record (orthonormal columns), and what errors from another record put into e."""
    polynomials = (m.a, m.b, m.f, m.c, m.d)
    past = np.stack(prediction.nuisance_columns(*polynomials, y.size), axis=1)
    if origin == "exact":
        return score.orthonormal(past), None
    gradient = score.gradient_columns(u, y, e, *polynomials)
    if P is None:
        counts = [m.a.size - 1]
        for b, f in zip(m.b, m.f, strict=True):
            counts += [b.size - delay(b), f.size - 1]
        gradient = score.differenced(gradient, [*counts, m.c.size - 1, m.d.size - 1])
    if origin == "this record":
        return score.orthonormal(np.hstack([past, gradient])), None
    Q = score.orthonormal(past)
    moved = gradient - Q @ (Q.T @ gradient)
    if P is None:
        return Q, score.orthonormal(moved) * float(np.sqrt(np.mean(e**2)))
    return Q, moved @ root(P)
