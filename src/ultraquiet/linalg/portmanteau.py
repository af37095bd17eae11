"""Tests of residuals on plain arrays: whether they are white, and free of the inputs."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.lagged import Lagged

# Directions of the input's lagged covariance weaker than this share of the strongest carry no evidence.
EXCITED_SHARE = 1e-8
BLOCKS_PER_LAG = 10  # block means a test needs for each of its lags
REACH = 10  # samples before and after an error, at which a loop is looked for
SAMPLES_EACH = 10  # that each coefficient takes there
NEAR_ONE = 1e-9  # a pole no further from the circle, or from one, is on it
# A noise model rings where it has a mode of less damping that adds so much to the variance of its innovations.
RINGING_DAMPING, RINGING_SHARE = 0.02, 0.05


class Evidence(NamedTuple):
    """A chi-squared test: its statistic, degrees of freedom and p-value (small: the hypothesis does not hold)."""

    statistic: float
    freedom: int
    p_value: float


def autocorrelation(e: FloatArray, lags: int) -> FloatArray:
    """Return r_k / r_0 for k = 1 .. lags of e less its mean."""
    e = e - e.mean()
    power = float(e @ e)
    if power == 0.0:
        return np.zeros(lags)
    return np.array([e[k:] @ e[:-k] for k in range(1, lags + 1)]) / power


def ljung_box(e: FloatArray, lags: int, parameters: int = 0) -> Evidence:
    """Return the test that e is white: Q = n (n + 2) sum_k r_k^2 / (n - k) of lags - parameters degrees of freedom.

    Ljung and Box 1978, doi:10.1093/biomet/65.2.297; its p-value is that of `whiteness_evidence`.
    """
    return ljung_box_of(autocorrelation(e, lags), e.size, parameters)


def ljung_box_of(r: FloatArray, n: int, parameters: int = 0) -> Evidence:
    """Return the same test from the autocorrelation r_1, r_2, ... of n samples."""
    lags = r.size
    statistic = float(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1))))
    return whiteness_evidence(statistic, max(1, lags - parameters), lags / n)


def whiteness_evidence(statistic: float, freedom: int, lags_per_sample: float) -> Evidence:
    """Return the evidence of Ljung and Box's Q, f degrees of freedom of m lags over n samples, m / n not small.

    All r_k^2 of one record are large together: of white Gaussian noise n cov(r_j^2, r_k^2) is 4 / n^2 to first order,
    and r_j r_k goes with r_(j + k). So Q has mean f, variance 2 f (1 + 2 m / n) and third cumulant 8 f (1 + 9 m / n);
    as chi-squared it rejects at 40 lags of 400 samples four times as often as asked. The tail is that of a gamma
    distribution with these three cumulants: of independent samples, at a level of a thousandth, one to one and a half.

    That chi-squared rejects too often: Davies, Triggs and Newbold 1977, doi:10.1093/biomet/64.3.517.

    >>> whiteness_evidence(73.4, 40, 0.0).p_value.__round__(5), whiteness_evidence(73.4, 40, 0.1).p_value.__round__(5)
    (0.001, 0.00324)
    """
    from scipy.special import gammaincc

    variance, third = 2 * freedom * (1 + 2 * lags_per_sample), 8 * freedom * (1 + 9 * lags_per_sample)
    shape, scale = 4 * variance**3 / third**2, third / (2 * variance)
    return Evidence(statistic, freedom, float(gammaincc(shape, max(0.0, (statistic - freedom) / scale + shape))))


def cross_correlation(e: FloatArray, u: FloatArray, lags: int, residual_lags: int = 0) -> Evidence:
    """Return the test that e holds nothing of u(t), ..., u(t - lags): n r' R^-1 r over the excited directions of R.

    Under the hypothesis r has covariance R sum_k r_e(k) ... / n when e is coloured; `residual_lags` of e's correlation
    are then taken into account (0: e is taken as white).
    """
    e = e - e.mean()
    u = u - u.mean()
    n = e.size
    return cross_correlation_of(
        _lagged(e, u, lags) / n, _lagged(u, u, lags + residual_lags) / n, _lagged(e, e, residual_lags) / n, n
    )


def fed_back(e: FloatArray, inputs: FloatArray) -> Evidence:
    """Return the test that inputs `(nu, n)` hold nothing of white errors `(n,)` before them: there is no loop.

    In e(t) = sum_k b_k u(t - k), k = -10 .. 10, the b_k of later inputs are zero in an open loop, whatever colour
    inputs have and whatever a model misses of them (Sims 1972).
    """
    sums = Lagged(1 + len(inputs), min(2 * REACH, e.size - 1))
    sums.add(np.vstack([e[None], inputs]))
    return fed_back_of(sums.products(centred=True) / e.size, e.size)


def fed_back_of(r: FloatArray, n: int) -> Evidence:
    """Return the same test from means over n samples of z(t) z(t + k)', k from zero, z = [e, u]; 1 of too few lags."""
    nu = r.shape[1] - 1
    if len(r) <= 2 * REACH or n < SAMPLES_EACH * nu * (2 * REACH + 1):
        return Evidence(0.0, 1, 1.0)
    size = np.sqrt(np.maximum(np.diag(r[0]), np.finfo(float).tiny))
    r = r / np.outer(size, size)
    after, before = range(-REACH, 0), range(REACH + 1)

    def shared(one: range, other: range) -> FloatArray:
        return np.block([[r[j - i, 1:, 1:].T if j >= i else r[i - j, 1:, 1:] for j in other] for i in one])

    def with_error(delays: range) -> FloatArray:
        return np.concatenate([r[k, 1:, 0] if k >= 0 else r[-k, 0, 1:] for k in delays])

    known = shared(after, before) @ np.linalg.pinv(shared(before, before), rcond=EXCITED_SHARE, hermitian=True)
    own = shared(after, after) - known @ shared(before, after)
    values, vectors = np.linalg.eigh((own + own.T) / 2)
    told = values > EXCITED_SHARE  # of unit variance
    left = vectors[:, told].T @ (with_error(after) - known @ with_error(before))
    return chi_squared(float(n * np.sum(left**2 / values[told])), max(1, int(told.sum())))


class InputTests:
    """Tests that white errors hold nothing of inputs `(nu, n)`: `cross_correlation`, each input's part found once.

    `delayed` leaves the inputs of an error's own sample out.
    """

    def __init__(self, inputs: FloatArray, lags: int, delayed: bool = False) -> None:
        self._first = int(delayed)
        inputs, self.lags = inputs[:, : inputs.shape[1] - self._first], lags - self._first
        self.inputs = inputs - inputs.mean(axis=1, keepdims=True)
        self._n, lags = inputs.shape[1], self.lags
        index = np.abs(np.arange(lags + 1)[:, None] - np.arange(lags + 1)[None, :])
        self._excited = [_excited(_lagged(u, u, lags)[index] / self._n) for u in self.inputs]

    def p_value(self, e: FloatArray) -> float:
        """Return the p-value that e is free of the inputs, that of the least over them."""
        e = e[self._first :] - e[self._first :].mean()
        power = float(e @ e) / self._n
        if power == 0.0:
            return 1.0
        tests = zip(self.inputs, self._excited, strict=True)
        return sidak(
            _over_excited(_lagged(e, u, self.lags) / self._n, power * values, vectors, self._n).p_value
            for u, (values, vectors) in tests
        )


def free_of_inputs(
    e: FloatArray, inputs: FloatArray, lags: int, residual_lags: int = 0, span: int = 0, delayed: bool = False
) -> float:
    """Return the p-value that e holds nothing of any input within `lags` samples, nor within `span` of them.

    What a slow mode leaves is spread over its whole period and shows at no single lag. So the means of e and u over
    blocks of samples are tested too, the blocks so long that as many lags of them reach across the span; the means of
    white noise are white. What rings on for many spans may still pass for colour of the noise. Inputs of the same
    block are left out: in a loop some of them come after the errors, and answer them.

    Args:
        e: `(n,)` errors.
        inputs: `(nu, n)`.
        lags: of each test.
        residual_lags: of e's own correlation, taken into account; 0 takes e as white.
        span: samples to look back, such as the period of the slowest mode.
        delayed: whether inputs of the same sample are left out as well.
    """
    now, before = e[int(delayed) :], inputs[:, : e.size - int(delayed)]
    values = [cross_correlation(now, u, lags - int(delayed), residual_lags).p_value for u in before]
    block = min(-(-span // max(1, lags)), e.size // (BLOCKS_PER_LAG * max(1, lags)))
    if block > 1:
        slow, memory = _block_means(e, block)[1:], min(residual_lags, e.size // block // 10)
        values += [cross_correlation(slow, _block_means(u, block)[:-1], lags - 1, memory).p_value for u in inputs]
    return sidak(values)


def noise_modes(c: FloatArray, d: FloatArray) -> ComplexArray:
    """Return the poles above the real axis at which noise (c / d) e rings, the loudest first.

    Each of c / d = 1 + sum_k r_k / (z - p_k) adds 2 |r_k|^2 / (1 - |p_k|^2) times the variance of e.

    >>> noise_modes(np.array([1.0]), np.array([1.0, -1.8, 0.99])).round(4)
    array([0.9+0.4243j])
    """
    n = max(c.size, d.size)
    poles = np.concatenate([np.roots(d), np.zeros(n - d.size)]).astype(np.complex128)
    c = np.concatenate([c, np.zeros(n - c.size)])
    found: list[tuple[float, complex]] = []
    for k in np.flatnonzero((poles.imag > 0) & (np.abs(poles) < 1.0)):
        p = poles[k]
        if -np.log(abs(p)) >= RINGING_DAMPING * abs(np.log(p)):
            continue
        others = p - poles
        others[k] = 1.0
        share = 2 * abs(np.polyval(c, p) / np.prod(others)) ** 2 / (1.0 - abs(p) ** 2)
        if share > RINGING_SHARE:
            found.append((float(share), complex(p)))
    return np.array([p for _, p in sorted(found, key=lambda each: -each[0])], dtype=np.complex128)


def slowest_period(poles: ComplexArray) -> int:
    """Return the samples of the longest time constant among discrete poles: 1 / |ln p| rad, a whole turn of it.

    >>> slowest_period(np.array([0.9, np.exp(0.1j)]))
    63
    """
    size = np.abs(np.log(poles[(poles != 0.0) & (np.abs(poles) < 1.0 + NEAR_ONE)]))
    slowest = float(np.min(size, initial=np.pi))
    return int(np.ceil(2 * np.pi / max(slowest, NEAR_ONE)))


def _block_means(x: FloatArray, block: int) -> FloatArray:
    return x[: x.size // block * block].reshape(-1, block).mean(axis=1)


def cross_correlation_of(
    r: FloatArray, covariance: FloatArray, color: FloatArray, n: int, moved: FloatArray | None = None
) -> Evidence:
    """Return the same test from means over n samples: e(t) u(t - k), u(t) u(t - k) and e(t) e(t - k), k from zero.

    `moved`, `(lags + 1, k)`, is how far r lies off besides, by k independent numbers of unit variance.
    """
    lags, residual_lags = r.size - 1, color.size - 1
    index = np.abs(np.arange(lags + 1)[:, None] - np.arange(lags + 1)[None, :])
    P = color[0] * covariance[index]
    for k in range(1, residual_lags + 1):
        shift = np.arange(lags + 1)[:, None] - np.arange(lags + 1)[None, :]
        P += color[k] * (covariance[np.abs(shift - k)] + covariance[np.abs(shift + k)])
    if moved is not None:
        P = P + n * moved @ moved.T
    return _over_excited(r, *_excited(P), n)


def _excited(P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the variances that carry evidence, and their directions, of a covariance."""
    values, vectors = np.linalg.eigh(P)
    strong = values > EXCITED_SHARE * values[-1]
    return values[strong], vectors[:, strong]


def _over_excited(r: FloatArray, values: FloatArray, vectors: FloatArray, n: int) -> Evidence:
    """Return the test that r / sqrt(variance) of n samples is noise in the directions that carry evidence."""
    projected = vectors.T @ r
    return chi_squared(float(n * np.sum(projected**2 / values)), max(1, values.size))


def _lagged(x: FloatArray, y: FloatArray, lags: int) -> FloatArray:
    return np.array([x[k:] @ y[: y.size - k] for k in range(lags + 1)])


def chi_squared(statistic: float, freedom: int) -> Evidence:
    """Return the evidence of a statistic that is chi-squared when the hypothesis holds."""
    from scipy.special import chdtrc

    return Evidence(statistic, freedom, float(chdtrc(freedom, statistic)))


def sidak(p_values: Iterable[float]) -> float:
    """Return the p-value of the least of several independent ones: 1 - (1 - min p)^n.

    Sidak 1967, doi:10.1080/01621459.1967.10482935.

    >>> sidak([0.5, 0.25])
    0.4375
    """
    values = list(p_values)
    return 1.0 - (1.0 - min(values)) ** len(values)
