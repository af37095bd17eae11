"""Residual tests: what a good model leaves behind is white and knows nothing of the input."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, frozen, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import portmanteau
from ultraquiet.validate.predict import innovations
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record

DEFAULT_LAGS = 40


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """Residuals of a model on a record, tested.

    Attributes:
        residuals: `(ny, n)` one-step prediction errors, in output units.
        loss: `(ny,)` their mean square.
        autocorrelation: `(ny, lags)` at lags 1, 2, ...; inside +-1.96 / sqrt(n) for 95 % of the lags when white.
        whiteness_p: `(ny,)` Ljung-Box p-value; small: not white.
        correlation_p: `(ny, nu)` p-value that an output's residual is free of an input's present and past.
    """

    residuals: FloatArray
    loss: FloatArray
    autocorrelation: FloatArray
    whiteness_p: FloatArray
    correlation_p: FloatArray

    @property
    def band(self) -> float:
        """Half width of the 95 % band of each autocorrelation."""
        return 1.96 / float(np.sqrt(self.residuals.shape[1]))


def residual_test(model: PolynomialMatrix | PolynomialModel, record: Record, lags: int = DEFAULT_LAGS) -> ResidualTest:
    """Return the residual e = (D/C)(A y - sum_j B_j/F_j u_j) and its tests, on any record of the model's channels.

    Q = n (n + 2) sum_k r_k^2 / (n - k) is chi-squared with `lags` degrees of freedom when e is white (no parameter is
    subtracted: the record may be another than the fitted one, and on the fitted one the test is then merely mild).
    The cross-correlation with each input is tested as one vector, over the directions the input excites.

    Args:
        model: what is tested, `(ny, nu)` channels.
        record: `(nu, n)` inputs and `(ny, n)` outputs at the model's rate.
        lags: how many lags each test takes.

    Raises:
        InputError: other channels or another rate than the model's, fewer than 10 samples a lag.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(1)
    >>> u, e = rng.standard_normal((2, 1000))
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=1.0)
    >>> y = lag.state_space().simulate(u[None])[0] + 0.1 * e
    >>> test = uq.validate.residual_test(lag, uq.Record(u, y, rate_hz=1.0))
    >>> bool(test.whiteness_p[0] > 0.001), bool(test.correlation_p[0, 0] > 0.001)
    (True, True)

    Reference: Ljung and Box 1978, doi:10.1093/biomet/65.2.297; Ljung, System Identification, 2nd ed., section 16.6.
    """
    who = "residual_test"
    whole(who, "lags", lags, 1)
    if record.samples < 10 * lags:
        raise InputError(f"{who}: {lags} lags need at least {10 * lags} samples, the record has {record.samples}.")
    same_rate(who, "the model", model.rate_hz, "the record", record.rate_hz)
    e = innovations(model, record)
    return ResidualTest(
        frozen(e),
        np.mean(e**2, axis=1),
        np.stack([portmanteau.autocorrelation(x, lags) for x in e]),
        np.array([portmanteau.ljung_box(x, lags).p_value for x in e]),
        np.array([[portmanteau.cross_correlation(x, u, lags).p_value for u in record.inputs] for x in e]),
    )
