"""Frequency and time responses of state-space matrices."""

from typing import cast

import numpy as np
from scipy.linalg import schur

from ultraquiet._base.constraints import ComplexArray, FloatArray


def points(f_hz: FloatArray, rate_hz: float | None) -> ComplexArray:
    """Return s = j 2 pi f (continuous) or z = exp(j 2 pi f / rate) (discrete)."""
    s = 2j * np.pi * f_hz
    return np.asarray(s if rate_hz is None else np.exp(s / rate_hz), dtype=np.complex128)


def frequency_response(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, z: ComplexArray) -> ComplexArray:
    """Return C (z I - A)^-1 B + D for each z, `(ny, nu, nz)`.

    A is brought to complex Schur form T once (unitary, so nothing is lost to the condition of eigenvectors); the
    triangular systems of all points are then solved side by side, one row at a time.
    """
    n, (ny, nu) = A.shape[0], D.shape
    out = np.broadcast_to(D[:, :, None], (ny, nu, z.size)).astype(np.complex128)
    if n == 0 or z.size == 0:
        return out
    T, Q = cast("tuple[ComplexArray, ComplexArray]", schur(A, output="complex"))
    b, c = Q.conj().T @ B, C @ Q
    block = max(1, int(1e7 / max(1, n * nu)))  # keeps the stacked solutions below 160 MB
    for start in range(0, z.size, block):
        part = z[start : start + block]
        x = _solve_triangular(T, b, part)
        out[:, :, start : start + part.size] += (c @ x.reshape(n, nu * part.size)).reshape(ny, nu, part.size)
    return out


def _solve_triangular(T: ComplexArray, b: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Solve (z I - T) x = b for every z by back substitution; x is `(n, nu, nz)`."""
    n, nu = b.shape
    x = np.empty((n, nu, z.size), dtype=np.complex128)
    for i in range(n - 1, -1, -1):
        known = (T[i, i + 1 :] @ x[i + 1 :].reshape(n - i - 1, nu * z.size)).reshape(nu, z.size)
        x[i] = (b[i, :, None] + known) / (z - T[i, i])
    return x


def simulate(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray, x0: FloatArray) -> FloatArray:
    """Return y of x+ = A x + B u, y = C x + D u for u `(nu, n)`."""
    states = np.empty((A.shape[0], u.shape[1]))
    driven = B @ u
    x = x0
    for k in range(u.shape[1]):
        states[:, k] = x
        x = A @ x + driven[:, k]
    return C @ states + D @ u
