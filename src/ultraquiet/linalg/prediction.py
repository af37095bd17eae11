"""Simulated and predicted outputs of polynomial models on plain arrays, initial conditions estimated or at rest."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Growth over a whole record (its logarithm) that is put down to the rounding of an integrator's pole.
ROUNDING_GROWTH = 0.01
ROUNDING = 1e-12  # share of an output's size that a constant fitted to it may miss
MEMORY, RIDGE = 20, 1e-9  # samples of the autoregression that whitens an error, share of its power added to it


def fit_percent(y: FloatArray, model: FloatArray) -> float:
    """Return 100 (1 - ||y - model|| / ||y - mean y||); 100 is perfect, 0 no better than the mean, no lower bound.

    >>> stuck = np.full(3, 0.1)  # whose mean is another number, by rounding
    >>> fit_percent(stuck, stuck), fit_percent(stuck, np.zeros(3))
    (100.0, -inf)
    """
    spread = float(np.linalg.norm(y - y.mean())) if np.ptp(y) > 0.0 else 0.0
    miss = float(np.linalg.norm(y - model)) if np.all(np.isfinite(model)) else np.inf
    if spread == 0.0:
        return 100.0 if miss <= ROUNDING * float(np.linalg.norm(y)) else -np.inf
    return 100.0 * (1.0 - miss / spread)


def repaired(y: FloatArray, model: FloatArray, low: float, high: float) -> FloatArray:
    """Return y with samples at or beyond its limits replaced by the model's, where that lies further out.

    A reading at its limit only says that the truth is not inside: the model's value stands in for it, the limit
    itself where the model disagrees.
    """
    model = np.where(np.isfinite(model), model, y)
    return np.where(y >= high, np.maximum(model, y), np.where(y <= low, np.minimum(model, y), y))


def can_be_simulated(poles: ComplexArray, samples: int) -> bool:
    """Return whether no free motion grows over a record; an integrator's, off the circle by rounding, does not."""
    radius = float(np.max(np.abs(poles), initial=0.0))
    return radius <= 1.0 or samples * np.log(radius) <= ROUNDING_GROWTH


def simulate(
    u: FloatArray,
    y: FloatArray,
    b: Sequence[FloatArray],
    f: Sequence[FloatArray],
    *,
    estimate: bool = True,
    offset: bool = True,
) -> FloatArray:
    """Return sum_j b_j / f_j u_j; the past before the first sample and a constant are fitted to y when asked for.

    A model that grows without bound gives an output of infinities: it predicts nothing. Integrators do not.
    """
    from scipy.signal import lfilter

    if not all(can_be_simulated(np.roots(p).astype(np.complex128), y.size) for p in f):
        return np.full(y.size, np.inf)
    out = sum(np.asarray(lfilter(num, den, x)) for x, num, den in zip(u, b, f, strict=True))
    columns = [c for den in f for c in free_responses(den, y.size)] if estimate else []
    columns += [np.ones(y.size)] if offset else []
    return out + _explained(y - out, columns)


def innovations(
    u: FloatArray,
    y: FloatArray,
    a: FloatArray,
    b: Sequence[FloatArray],
    f: Sequence[FloatArray],
    c: FloatArray,
    d: FloatArray,
) -> FloatArray:
    """Return e = (d / c)(a y - sum_j b_j / f_j u_j), the past before the first sample and a constant fitted.

    It exists for an unstable `a` too: only c and every f are divided by.
    """
    from scipy.signal import lfilter

    v = np.asarray(lfilter(a, [1.0], y))
    for x, num, den in zip(u, b, f, strict=True):
        v = v - np.asarray(lfilter(num, den, x))
    e = filtered(v, d, c)
    return e - _explained(e, nuisance_columns(a, b, f, c, d, y.size))


def nuisance_columns(
    a: FloatArray, b: Sequence[FloatArray], f: Sequence[FloatArray], c: FloatArray, d: FloatArray, n: int
) -> list[FloatArray]:
    """Return what a constant and the unknown past before the first sample can do to the residual, each `(n,)`."""
    columns = [filtered(x, d, c) for den in f for x in free_responses(den, n)]
    past = max(c.size, a.size + d.size - 1, *(num.size for num, den in zip(b, f, strict=True) if den.size == 1), 1) - 1
    return [filtered(np.ones(n), d, c), *columns, *free_responses(c, n, past)]


def filtered(v: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """Return (c / d) v from rest."""
    from scipy.signal import lfilter

    return np.asarray(lfilter(c, d, v))


def whitening(v: FloatArray, memory: int = MEMORY) -> tuple[FloatArray, float]:
    """Return the polynomial a `(k + 1,)`, a_0 = 1, and the variance of a v, an autoregression of v less its mean.

    It reaches back `memory` samples, a tenth of v at most.

    >>> e = np.random.default_rng(0).standard_normal(20000)
    >>> a, variance = whitening(filtered(e, np.ones(1), np.array([1.0, -0.8])))
    >>> bool(abs(a[1] + 0.8) < 0.02), bool(abs(variance - 1.0) < 0.05)
    (True, True)
    """
    v = v - v.mean()
    n, lags = v.size, min(memory, v.size // 10)
    return whitening_of(np.array([v[k:] @ v[: n - k] for k in range(lags + 1)]) / n)


def error_spectrum(v: FloatArray, z: ComplexArray, memory: int = MEMORY) -> FloatArray:
    """Return the spectrum of v at the points z `(nf,)`, from the autoregression of `whitening`; white: its variance."""
    a, variance = whitening(v, memory)
    return variance / np.maximum(np.abs(z[:, None] ** -np.arange(a.size) @ a) ** 2, RIDGE)


def whitening_of(r: FloatArray) -> tuple[FloatArray, float]:
    """Return what `whitening` does from the autocovariance `(lags + 1,)`, of which it takes the first `MEMORY` lags."""
    from scipy.linalg import solve_toeplitz

    r = np.array(r[: MEMORY + 1])
    r[0] = max(r[0], np.finfo(float).tiny) * (1.0 + RIDGE)
    a = np.asarray(solve_toeplitz(r[:-1], r[1:]), dtype=np.float64)
    return np.concatenate([[1.0], -a]), float(max(r[0] - a @ r[1:], RIDGE * r[0]))


def free_responses(den: FloatArray, n: int, count: int | None = None) -> list[FloatArray]:
    """Return the responses q^-k / den to a unit pulse, k = 0 .. count - 1 (the order when absent)."""
    from scipy.signal import lfilter

    count = den.size - 1 if count is None else count
    pulse = np.zeros(n)
    pulse[0] = 1.0
    h = np.asarray(lfilter([1.0], den, pulse)) if den.size > 1 else pulse
    h[np.abs(h) < 1e-140] = 0.0  # denormal tails slow all that follows
    return [np.concatenate([np.zeros(k), h[: n - k]]) for k in range(count)]


def _explained(y: FloatArray, columns: list[FloatArray]) -> FloatArray:
    """Return the part of y in the span of the columns, found in an orthonormal basis."""
    if not columns:
        return np.zeros(y.size)
    X = np.stack(columns, axis=1)
    size = np.linalg.norm(X, axis=0)
    Q, R = np.linalg.qr(X[:, size > 0] / size[size > 0])
    # Shifts of one slow response can be parallel to the last digit: directions that vanish are left out.
    U, s, _ = np.linalg.svd(R)
    basis = Q @ U[:, s > 1e-12 * s[0]]
    return basis @ (basis.T @ y)
