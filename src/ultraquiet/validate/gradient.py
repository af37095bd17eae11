"""How a model's response moves with its coefficients."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array
from ultraquiet._base.errors import InputError
from ultraquiet.values import PolynomialModel


def coefficients(model: PolynomialModel) -> FloatArray:
    """Return the free coefficients in the order of a covariance: a, b_1, f_1, b_2, f_2, ..., c, d."""
    inner = [p for j, b in enumerate(model.b) for p in (b[delay(b) :], model.f[j][1:])]
    return np.concatenate([model.a[1:], *inner, model.c[1:], model.d[1:]])


def with_coefficients(model: PolynomialModel, theta: FloatArray) -> PolynomialModel:
    """Return the model with other values of its free coefficients."""
    at = 0

    def next_coefficients(count: int) -> FloatArray:
        nonlocal at
        at += count
        return theta[at - count : at]

    one = np.ones(1)
    a = np.concatenate([one, next_coefficients(model.a.size - 1)])
    b, f = [], []
    for j, p in enumerate(model.b):
        b.append(np.concatenate([p[: delay(p)], next_coefficients(p.size - delay(p))]))
        f.append(np.concatenate([one, next_coefficients(model.f[j].size - 1)]))
    c = np.concatenate([one, next_coefficients(model.c.size - 1)])
    d = np.concatenate([one, next_coefficients(model.d.size - 1)])
    return PolynomialModel(b, f, model.rate_hz, a, c, d, model.noise_variance)


def delay(b: FloatArray) -> int:
    """Return how many leading coefficients of B are zero: those are its delay and not free."""
    moving = np.flatnonzero(b)
    return int(moving[0]) if moving.size else b.size


def response_gradient(model: PolynomialModel, f_hz: FloatArray) -> ComplexArray:
    """Return dG_j / d theta at each frequency, `(nu, p, nf)`, theta as in `coefficients`.

    G_j = B_j / (A F_j): dG/db_k = q^-k / (A F), dG/df_k = -G q^-k / F, dG/da_k = -G q^-k / A; c and d do not enter.
    """
    f = frequency_array("response_gradient", f_hz)
    w = np.exp(-2j * np.pi * f / model.rate_hz)
    G = model.frequency_response(f)[0]
    A = _value(model.a, w)
    out = np.zeros((len(model.b), coefficients(model).size, f.size), dtype=np.complex128)
    out[:, : model.a.size - 1] = -G[:, None] * _powers(w, 1, model.a.size - 1) / A
    at = model.a.size - 1
    for j, b in enumerate(model.b):
        F = _value(model.f[j], w)
        first, count = delay(b), b.size - delay(b)
        out[j, at : at + count] = _powers(w, first, count) / (A * F)
        at += count
        count = model.f[j].size - 1
        out[j, at : at + count] = -G[j] * _powers(w, 1, count) / F
        at += count
    return out


def noise_gradient(model: PolynomialModel, f_hz: FloatArray) -> ComplexArray:
    """Return d ln H / d theta at each frequency, `(p, nf)`, H = C / (A D)."""
    w = np.exp(-2j * np.pi * f_hz / model.rate_hz)
    out = np.zeros((coefficients(model).size, f_hz.size), dtype=np.complex128)
    a, c, d = model.a.size - 1, model.c.size - 1, model.d.size - 1
    end = out.shape[0]
    out[:a] = -_powers(w, 1, a) / _value(model.a, w)
    out[end - c - d : end - d] = _powers(w, 1, c) / _value(model.c, w)
    out[end - d :] = -_powers(w, 1, d) / _value(model.d, w)
    return out


def matching(who: str, model: PolynomialModel, covariance: FloatArray) -> FloatArray:
    """Return the covariance after checking that it belongs to the model's coefficients."""
    p = coefficients(model).size
    if covariance.shape != (p, p):
        raise InputError(
            f"{who}: the model has {p} free coefficients but the covariance is {covariance.shape}; take model and "
            f"covariance from the same result."
        )
    if not np.all(np.isfinite(covariance)):
        raise InputError(f"{who}: the covariance holds NaN or infinite entries, so no band can be drawn from it.")
    return covariance


def _powers(w: ComplexArray, first: int, count: int) -> ComplexArray:
    return w ** np.arange(first, first + count)[:, None]


def _value(p: FloatArray, w: ComplexArray) -> ComplexArray:
    return np.polynomial.polynomial.polyval(w, p).astype(np.complex128)
