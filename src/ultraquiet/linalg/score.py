"""Score tests of residuals on plain arrays, which allow for where the model's coefficients come from."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg.portmanteau import EXCITED_SHARE, Evidence, chi_squared
from ultraquiet.linalg.prediction import filtered

# Directions of fitted columns weaker than this share of the strongest are parallel to the others.
PARALLEL = 1e-10


def gradient_columns(
    u: FloatArray,
    y: FloatArray,
    e: FloatArray,
    a: FloatArray,
    b: Sequence[FloatArray],
    f: Sequence[FloatArray],
    c: FloatArray,
    d: FloatArray,
) -> FloatArray:
    """Return de / d theta, `(n, p)`, theta being the coefficients a, b_1, f_1, ..., c, d.

    de/da_k = (d/c) y(t-k), de/db_k = -(d/(c f)) u(t-k), de/df_k = (d/(c f)) w(t-k), w = (b/f) u,
    de/dc_k = -e(t-k) / c, de/dd_k = (1/c) v(t-k) = e(t-k) / d.
    """
    one = np.ones(1)
    blocks = [shifted(filtered(y, d, c), 1, a.size - 1)]
    for x, num, den in zip(u, b, f, strict=True):
        driven = filtered(filtered(x, one, den), d, c)
        moving = np.flatnonzero(num)
        first = int(moving[0]) if moving.size else num.size
        blocks.append(-shifted(driven, first, num.size - first))
        blocks.append(shifted(filtered(filtered(driven, num, one), one, den), 1, den.size - 1))
    blocks.append(-shifted(filtered(e, one, c), 1, c.size - 1))
    blocks.append(shifted(filtered(e, one, d), 1, d.size - 1))
    return np.hstack(blocks)


def shifted(x: FloatArray, first: int, count: int) -> FloatArray:
    """Return columns x(t - first), ..., x(t - first - count + 1), zero outside the record; negative shifts look ahead.

    >>> shifted(np.array([1.0, 2.0, 3.0]), -1, 3).tolist()
    [[2.0, 1.0, 0.0], [3.0, 2.0, 1.0], [0.0, 3.0, 2.0]]
    """
    n = x.size
    out = np.zeros((n, count))
    for k in range(count):
        by = first + k
        if by >= 0:
            out[by:, k] = x[: max(0, n - by)]
        else:
            out[: n + by, k] = x[-by:]
    return out


def differenced(columns: FloatArray, blocks: Sequence[int]) -> FloatArray:
    """Return the columns of each block of shifts in the basis (1 - q^-1)^k, which spans the same and keeps digits."""
    out = columns.copy()
    at = 0
    for count in blocks:
        for k in range(1, count):
            out[:, at + k : at + count] = out[:, at + k : at + count] - out[:, at + k - 1 : at + count - 1]
        at += count
    return out


def orthonormal(X: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the columns, parallel ones left out."""
    size = np.linalg.norm(X, axis=0)
    Q, R = np.linalg.qr(X[:, size > 0] / size[size > 0])
    U, s, _ = np.linalg.svd(R)
    return Q @ U[:, s > PARALLEL * s[0]]


def score_test(e: FloatArray, regressors: FloatArray, fitted: FloatArray, spread: FloatArray | None = None) -> Evidence:
    """Return the test that white e holds nothing of the regressors: s' V^-1 s with s = Z'e.

    V = var(e) Z'(I - Q Q')Z + Z'S S'Z. Least squares has made e orthogonal to the fitted columns Q, so that s varies
    less; coefficients that came from another record with covariance P have added G (theta - theta_0), so that s varies
    more (S S' = G P G'). The score test of Breusch 1978 and Godfrey 1978 when S = 0.

    Args:
        e: `(n,)` residual.
        regressors: `(n, m)` columns Z.
        fitted: `(n, q)` orthonormal columns Q that were fitted to this record.
        spread: `(n, p)` columns S of what the coefficients' own errors put into e.
    """
    n, q = fitted.shape
    Z = regressors - fitted @ (fitted.T @ regressors)
    size = np.linalg.norm(Z, axis=0)
    Z = Z[:, size > 0] / size[size > 0]
    if Z.shape[1] == 0:
        return chi_squared(0.0, 1)
    V = float(e @ e) / max(1, n - q) * (Z.T @ Z)
    if spread is not None:
        moved = Z.T @ spread
        V = V + moved @ moved.T
    values, vectors = np.linalg.eigh(V)
    strong = values > EXCITED_SHARE * values[-1]
    projected = vectors[:, strong].T @ (Z.T @ e)
    return chi_squared(float(np.sum(projected**2 / values[strong])), max(1, int(strong.sum())))
