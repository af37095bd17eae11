"""How far a state-space response may lie from the truth, from the spectra of the record that it was fitted to."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg import balance
from ultraquiet.linalg.innovation import fitted_past
from ultraquiet.linalg.ordered import Array
from ultraquiet.linalg.prediction import error_spectrum

LINES_AT_ONCE = 128
# Directions of the information below this share of the largest are those that change no response (each mode's states
# may be scaled and turned), or that the record says nothing of.
CUTOFF = 1e-10
LEAST_DECAY = 1e-12
SAMPLES_AT_ONCE = 4096


class RecordEnd(NamedTuple):
    """Where a record ends: per block of modes, what its states have become of what they were and what drove them.

    A record is no period: of x+ = A x + B u, the transform over n samples is (z - A)^-1 (B U + z (x_0 - x_n)), and
    x_n is as large as what drives it where a mode rings for as long as the record.

    Attributes:
        x: `(n,)` how far the states have come, x_n - x_0.
        w: `(n,)` of w+ = A w + x from rest, which their derivatives by a pole are.
        h: `(n, n, nu)` states that input j alone leaves, let in at the place of the second index.
        turned: `(n, n)` A^n.
    """

    x: FloatArray
    w: FloatArray
    h: FloatArray
    turned: FloatArray

    @classmethod
    def of(cls, A: FloatArray, B: FloatArray, blocks: Sequence[int], u: FloatArray, x0: FloatArray) -> "RecordEnd":
        """Return it for real modal blocks [[re, im], [-im, re]], of which x1 - j x2 is the complex state."""
        (n, nu), samples = B.shape, u.shape[1]
        starts = np.concatenate([[0], np.cumsum(blocks)[:-1]]).astype(int)
        pairs = np.array(blocks) == 2
        p = A[starts, starts] + 1j * np.where(pairs, A[starts, np.minimum(starts + 1, n - 1)], 0.0)
        first, second = np.zeros((2, p.size, nu), dtype=np.complex128)
        for k in range(0, samples, SAMPLES_AT_ONCE):
            some = u[:, k : k + SAMPLES_AT_ONCE]
            left = samples - 1 - np.arange(k, k + some.shape[1])
            first += p[:, None] ** left @ some.T
            second += (left * p[:, None] ** np.maximum(left - 1, 0)) @ some.T
        h, slopes, turned, bent = np.zeros((n, n, nu)), np.zeros((n, n, nu)), np.zeros((n, n)), np.zeros((n, n))
        powers = p**samples, samples * p ** (samples - 1)
        for a, pair, *sums in zip(starts, pairs, first, second, *powers, strict=True):
            for into, s in zip((h, slopes, turned, bent), sums, strict=True):
                into[a, a] = np.real(s)
                if pair:
                    into[a, a + 1], into[a + 1, a], into[a + 1, a + 1] = np.imag(s), -np.imag(s), np.real(s)
        x = np.einsum("abj,bj->a", h, B) + turned @ x0 - x0
        return cls(x, np.einsum("abj,bj->a", slopes, B) + bent @ x0, h, turned)


class ModalSensitivities:
    """Derivatives of C (z - A)^-1 B + D by pole pairs, B, C and D, in modal blocks |b| = |c|.

    Args:
        A, B, C, D: of a stable discrete system.
        direct: inputs, the first ones, whose column of D is a parameter.

    Raises:
        NumericalError: poles so near to each other that they have no modes of their own.
    """

    def __init__(self, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, direct: int) -> None:
        form = balance.modal(A, B, C)
        if any(states > 2 for states in form.blocks):
            raise NumericalError("poles too near to each other have no modes of their own; lower the order")
        self.A, self.B, self.C, self.blocks = form.A, form.B, form.C, form.blocks
        self.D, self.direct = D, direct

    def bends(self) -> Iterator[FloatArray]:
        """Give dA for each parameter of each block: along its decay and its turn."""
        at = 0
        for states in self.blocks:
            rows = slice(at, at + states)
            at += states
            decay = max(LEAST_DECAY, float(1.0 - np.abs(np.linalg.eigvals(self.A[rows, rows])).max()))
            for part in [np.eye(states)] if states == 1 else [np.eye(2), np.array([[0.0, 1.0], [-1.0, 0.0]])]:
                dA = np.zeros_like(self.A)
                dA[rows, rows] = part * decay
                yield dA

    def of(self, z: ComplexArray, u: ComplexArray, ended: RecordEnd | None = None) -> ComplexArray:
        """Return d y / d theta `(nf, ny, p)` for input spectra `(nf, nu)`: steady, or of a record that ended so.

        Of a record n columns more are by the states that it began with.
        """
        (ny, n), nu, nf = self.C.shape, self.B.shape[1], z.size
        inverse = np.linalg.inv(z[:, None, None] * np.eye(n) - self.A)
        out, drive = self.C @ inverse, u @ self.B.T
        if ended is not None:
            drive = drive - z[:, None] * ended.x
        x = np.einsum("fab,fb->fa", inverse, drive, optimize=True)
        bent = x if ended is None else x - z[:, None] * ended.w
        by_A = np.stack([np.einsum("fia,ab,fb->fi", out, dA, bent, optimize=True) for dA in self.bends()], axis=2)
        by_B = out[..., None] * u[:, None, None]
        if ended is not None:
            by_B = by_B - np.einsum("f,fia,abj->fibj", z, out, ended.h, optimize=True)
        by_B = by_B.reshape(nf, ny, n * nu)
        by_C = np.einsum("ik,fa->fika", np.eye(ny), x).reshape(nf, ny, ny * n)
        by_D = np.einsum("ik,fj->fikj", np.eye(ny), u[:, : self.direct]).reshape(nf, ny, ny * self.direct)
        began = [] if ended is None else [z[:, None, None] * (out - out @ ended.turned)]
        return np.concatenate([by_A, by_B, by_C, by_D, *began], axis=2)


def spread_root(
    at: ModalSensitivities, inputs: FloatArray, misses: FloatArray, weight: FloatArray | None, colored: bool
) -> FloatArray:
    """Return R `(p, k)` with R R' the covariance of the parameters that make a sum of squared errors least.

    The states that the record began with, and a constant of each output, are parameters beside them, of which nothing
    is known beforehand.

    With S(f) = d y / d theta at a line of the record, W the weight and Phi the spectrum of the errors,

        M = sum_f Re S' W S,   Q = sum_f Re S' W Phi W S,   cov theta = M^+ Q M^+.

    Args:
        at: the sensitivities.
        inputs: `(nu, n)`.
        misses: `(ny, n)` outputs less what the inputs make of the system from rest.
        weight: `(ny, ny)` W of the sum of squares; None for the inverse of the errors' covariance.
        colored: whether Phi comes from an autoregression of each output's errors; else they are taken as white.

    Ljung, System Identification, 2nd ed., sections 9.3 and 9.4; McKelvey, Helmersson, Ribarits 2004 (coordinates
    that are more than needed), doi:10.1016/j.automatica.2004.04.017.
    """
    (ny, n), states = misses.shape, len(at.A)
    began, past = fitted_past(at.A, at.C, misses)
    v = misses - past
    v = v - v.mean(axis=1, keepdims=True)
    V = v @ v.T / max(1.0, n - states * (1 + inputs.shape[0] / ny))
    W = np.linalg.inv(V) if weight is None else weight
    lines = np.arange(1, (n + 1) // 2)
    z = np.exp(2j * np.pi * lines / n)
    U = np.fft.rfft(inputs, axis=1)[:, lines].T
    ended = RecordEnd.of(at.A, at.B, at.blocks, inputs, began)
    level = np.sqrt(spectra(v, z)) if colored else np.ones((lines.size, ny))
    root, weigh = np.linalg.cholesky(V), np.linalg.cholesky(W).T
    M, Q = np.zeros((2, 1, 1))
    for k in range(0, lines.size, LINES_AT_ONCE):
        some = slice(k, k + LINES_AT_ONCE)
        S = at.of(z[some], U[some], ended)
        M = M + 2 * _products(weigh @ S)
        Q = Q + 2 * _products(root.T @ (level[some][:, :, None] * (W @ S)))
    size = np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
    scale = np.outer(size, size)
    inverse = np.linalg.pinv(M / scale, rcond=CUTOFF, hermitian=True)
    values, vectors = np.linalg.eigh(Q / scale)
    root = (inverse @ (vectors * np.sqrt(np.maximum(values, 0.0)))) * (np.sqrt(n) / size)[:, None]
    return root[: len(root) - states]


def _products(S: Array) -> FloatArray:
    """Return the real part of the sum of S' S over lines, `(p, p)` of `(nf, ny, p)`."""
    rows = S.reshape(-1, S.shape[-1])
    return rows.real.T @ rows.real + rows.imag.T @ rows.imag


def spectra(v: FloatArray, z: ComplexArray) -> FloatArray:
    """Return the errors' spectra `(nf, ny)`, of mean one, each from an autoregression."""
    out = np.empty((z.size, len(v)))
    for i, one in enumerate(v):
        out[:, i] = error_spectrum(one, z) / max(float(np.mean(one**2)), np.finfo(float).tiny)
    return out


def moved(at: ModalSensitivities, z: ComplexArray, root: FloatArray, plant: ComplexArray | None) -> ComplexArray:
    """Return how the response moves along each column of a root, `(ny, nu, nf, k)`.

    Args:
        at: sensitivities of the system whose parameters the root is of.
        z: `(nf,)` points.
        root: `(p, k)`.
        plant: None where the system is the plant; else the plant's response `(ny, nu, nf)`, and the system its
            one-step predictor y^ = Wu u + Wy y: dG = (1 - Wy)^-1 (dWu + dWy G).
    """
    ny, ports = at.C.shape[0], at.B.shape[1]
    nu = ports if plant is None else ports - ny
    kept: ComplexArray = np.broadcast_to(np.eye(ny, dtype=np.complex128), (z.size, ny, ny))
    if plant is not None:
        inverse = np.linalg.inv(z[:, None, None] * np.eye(len(at.A)) - at.A)
        kept = np.linalg.inv(np.eye(ny) - at.C @ inverse @ at.B[:, nu:])
    columns = []
    for j in range(nu):
        drive = np.zeros((z.size, ports), dtype=np.complex128)
        drive[:, j] = 1.0
        if plant is not None:
            drive[:, nu:] = plant[:, j].T
        columns.append(kept @ (at.of(z, drive) @ root))
    return np.stack(columns).transpose(2, 0, 1, 3)
