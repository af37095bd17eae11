"""Frequency and time responses of state-space matrices."""

from typing import Any, cast

import numpy as np
from scipy.linalg import lu_factor, lu_solve, schur

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.even import UNEVEN, even_states, evened
from ultraquiet.linalg.ordered import Array, Matrices

NEAR = 2**17  # complex numbers that stay near the processor: 2 MB
PANEL = 16  # rows of a triangular system solved before the others take what they know
REFINEMENTS = 4  # steps towards the exact response at a peak; each takes the condition times a unit round-off
EXACT = 1e-15


def points(f_hz: FloatArray, rate_hz: float | None) -> ComplexArray:
    """Return s = j 2 pi f (continuous) or z = exp(j 2 pi f / rate) (discrete)."""
    s = 2j * np.pi * f_hz
    return np.asarray(s if rate_hz is None else np.exp(s / rate_hz), dtype=np.complex128)


def principal_gains(response: ComplexArray) -> FloatArray:
    """Return the singular values of a response `(ny, nu, nf)`, largest first, `(directions, nf)`.

    A line at which it has no bound, that of an undamped pole, is infinite in every direction.
    """
    lines = np.moveaxis(response, 2, 0)
    bounded = np.isfinite(lines).all(axis=(1, 2))
    values = np.full((lines.shape[0], min(lines.shape[1:])), np.inf)
    values[bounded] = np.linalg.svd(lines[bounded], compute_uv=False)
    return values.T


def frequency_response(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, z: ComplexArray) -> ComplexArray:
    """Return C (z I - A)^-1 B + D for each z, `(ny, nu, nz)`.

    A is brought to complex Schur form T once (unitary, so nothing is lost to the condition of eigenvectors); the
    triangular systems of all points are then solved side by side, one row at a time.
    """
    n, (ny, nu) = A.shape[0], D.shape
    # an orthogonal transform of states in units decades apart would leave no digit of the small ones
    A, B, C = evened(A, B, C, UNEVEN)
    out = np.broadcast_to(D[:, :, None], (ny, nu, z.size)).astype(np.complex128)
    if n == 0 or z.size == 0:
        return out
    T, Q = cast("tuple[ComplexArray, ComplexArray]", schur(A, output="complex"))
    b, c = Q.conj().T @ B, C @ Q
    return out + triangular_response(T, b, c, z)


def triangular_response(T: ComplexArray, b: ComplexArray, c: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Return c (z I - T)^-1 b for T in complex Schur form and each z, `(ny, nu, nz)`.

    Points are taken a few at a time, so that what is solved for stays near the processor. With fewer outputs than
    inputs the transposed system is solved, b' (z I - T')^-1 c': its states in reverse order are triangular again.
    """
    if c.shape[0] < b.shape[1]:
        dual = triangular_response(T.T[::-1, ::-1], c.T[::-1], b.T[:, ::-1], z)
        return dual.transpose(1, 0, 2)
    (n, nu), ny = b.shape, c.shape[0]
    out = np.empty((ny, nu, z.size), dtype=np.complex128)
    T, block = np.ascontiguousarray(T), max(1, NEAR // max(1, n * nu))
    for start in range(0, z.size, block):
        part = z[start : start + block]
        x = _solve_triangular(T, b, part)
        out[:, :, start : start + part.size] = (c @ x.reshape(n, nu * part.size)).reshape(ny, nu, part.size)
    return out


def _solve_triangular(T: ComplexArray, b: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Solve (z I - T) x = b for every z by back substitution, PANEL rows at a time; x is `(n, nu, nz)`."""
    n, nu = b.shape
    x = np.empty((n, nu * z.size), dtype=np.complex128)
    x.reshape(n, nu, z.size)[:] = b[:, :, None]
    for stop in range(n, 0, -PANEL):
        start = max(0, stop - PANEL)
        if stop < n:
            x[start:stop] += T[start:stop, stop:] @ x[stop:]
        for i in range(stop - 1, start - 1, -1):
            if i + 1 < stop:
                x[i] += T[i, i + 1 : stop] @ x[i + 1 : stop]
            x[i].reshape(nu, z.size)[:] /= z - T[i, i]
    return x.reshape(n, nu, z.size)


def simulate(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray, x0: FloatArray) -> FloatArray:
    """Return y of x+ = A x + B u, y = C x + D u for u `(nu, n)`."""
    states, driven = np.empty((u.shape[1] + 1, A.shape[0])), np.ascontiguousarray((B @ u).T)
    states[0] = x0
    # rows of whole arrays, written in place: nothing is made anew in a loop over the samples
    for now, following, push in zip(states, states[1:], driven, strict=False):
        np.add(np.dot(A, now, out=following), push, out=following)
    return C @ np.ascontiguousarray(states[:-1].T) + D @ u


def refined_gain(A: Array, B: Array, C: Array, D: Array, z: complex) -> float:
    """Return the largest singular value of C (z I - A)^-1 B + D at one point, free of the errors of the solution.

    Iterative refinement with residuals in extended precision: the solution comes out to the last digit as long as
    z I - A is regular in double precision. A loop whose states are decades apart loses what its condition costs.
    """
    if not (A.size and np.any(B) and np.any(C)):
        return float(np.linalg.norm(D, 2)) if D.size else 0.0
    x = _refined(z * np.eye(len(A), dtype=np.clongdouble) - A, B, C)
    return float(np.linalg.norm((C @ x + D).astype(np.complex128), 2))


def _refined(wide: Any, B: Array, C: Array) -> Any:
    """Return wide^-1 B in extended precision, refined for as long as that moves C wide^-1 B less and less."""
    factors = lu_factor(wide.astype(np.complex128), check_finite=False)
    x = lu_solve(factors, B.astype(np.complex128), check_finite=False).astype(np.clongdouble)
    size = np.inf
    for _ in range(REFINEMENTS):
        step = lu_solve(factors, (B - wide @ x).astype(np.complex128), check_finite=False)
        before, size = size, float(np.linalg.norm(C @ step))
        if not size < before / 2:
            break
        x += step
        if size <= EXACT * float(np.linalg.norm((C @ x).astype(np.complex128))):
            break
    return x


class JoinedGain:
    """The largest singular value of F(P, K) over z, states, y and u solved for together.

    A loop whose matrices are formed has rounded products of both, and sums that cancel: where it is ill-conditioned
    that is more of its gain than a norm is known to.
    """

    def __init__(self, P: Matrices, K: Matrices) -> None:
        A, B, C = even_states(*P[:3])[:3]
        a, b, c = even_states(*K[:3])[:3]
        D, d = P[3], K[3]
        n, k, (nu, ny) = len(A), len(a), d.shape
        p, m = D.shape[0] - ny, D.shape[1] - nu
        self._A = np.block(
            [
                [A, np.zeros((n, k + ny)), B[:, m:]],
                [np.zeros((k, n)), a, b, np.zeros((k, nu))],
                [C[p:], np.zeros((ny, k)), -np.eye(ny), D[p:, m:]],
                [np.zeros((nu, n)), c, d, -np.eye(nu)],
            ]
        )
        self._moving = np.arange(len(self._A)) < n + k
        self._B = np.vstack([B[:, :m], np.zeros((k, m)), D[p:, :m], np.zeros((nu, m))])
        self._C = np.hstack([C[:p], np.zeros((p, k + ny)), D[:p, m:]])
        self._D = D[:p, :m]

    def __call__(self, z: complex) -> float:
        """Return the gain at s or z."""
        wide = np.diag(z * self._moving.astype(np.clongdouble)) - self._A
        x = _refined(wide, self._B, self._C)
        return float(np.linalg.norm((self._C @ x + self._D).astype(np.complex128), 2))
