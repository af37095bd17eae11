"""Least squares in modal coordinates: y_i = sum_k Re(c_ik sum_j b_kj s_kj) + D u + constant, s_kj = u_j / (z - p_k).

Everything is read off one Gram matrix of the filter bank, so fitting B, then C, then B again costs no pass over the
data. The initial state is one more input: a pulse just before the first sample.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.values import StateSpace

IntArray = NDArray[np.int64]

IMAGINARY = 1e-9  # a pole nearer to the real axis than this is real
# Share of the largest eigenvalue of the unit-diagonal normal matrix below which a direction is left out. Such
# directions (slow modes where the input has no power) are fitted to drift: on the steel frame of DaISy 96-013 the
# held-out fit of the worst output is 89 % with 1e-6, 29 % with 1e-8 and below zero with 1e-13.
CUTOFF = 1e-6
RAISED = 1e-9  # share by which a loss rises that rises not by rounding


@dataclass(frozen=True, eq=False)
class Modes:
    """Poles of the upper half plane `(m,)`, `b` `(m, nu + 1)`, initial state last, `c` `(ny, m)`, `D`, constant."""

    poles: ComplexArray
    b: ComplexArray
    c: ComplexArray
    D: FloatArray
    constant: FloatArray

    def state_space(self, rate_hz: float, **channels: Any) -> StateSpace:
        """Return real modal blocks, input and output matrix of each of equal size."""
        from scipy.linalg import block_diag

        A, B, C = [], [], []
        even = _even(self)
        for p, b, c in zip(even.poles, even.b[:, :-1], even.c.T, strict=True):
            if p.imag == 0.0:
                A.append(np.array([[p.real]]))
                B.append(b.real[None])
                C.append(c.real[:, None])
            else:
                A.append(np.array([[p.real, p.imag], [-p.imag, p.real]]))
                B.append(np.stack([b.real, -b.imag]))
                C.append(np.stack([c.real, c.imag], axis=1))
        return StateSpace(np.asarray(block_diag(*A)), np.vstack(B), np.hstack(C), self.D, rate_hz, **channels)


class FilterBank:
    """Products of all filtered inputs, inputs and outputs for one set of poles."""

    def __init__(self, poles: ComplexArray, u: FloatArray, y: FloatArray, feedthrough: bool, offset: bool) -> None:
        from ultraquiet.identify.subspace.kernels import modal_gram

        self.poles = poles
        self.nu, self.ny, self.n = u.shape[0], y.shape[0], u.shape[1]
        self.direct = (self.nu if feedthrough else 0) + int(offset)
        self.feedthrough, self.offset = feedthrough, offset
        rest = [u] if feedthrough else []
        rest += [np.ones((1, self.n))] if offset else []
        # A pulse before the first sample starts every mode at one.
        pulse = np.zeros((1, self.n))
        pulse[0, 0] = 1.0
        started = np.vstack([np.hstack([np.zeros((self.nu, 1)), u[:, :-1]]), pulse])
        tail = np.vstack([*rest, y])
        G = modal_gram(poles, np.ascontiguousarray(started), np.ascontiguousarray(tail))
        self.modes = 2 * poles.size * (self.nu + 1)
        self.G = G
        self.power = np.diag(G)[-self.ny :].copy()

    def only(self, kept: IntArray) -> "FilterBank":
        """Return the bank of some of the modes; nothing is summed again."""
        other = copy(self)
        high = 2 * (self.nu + 1)
        rows = np.concatenate([np.arange(k * high, (k + 1) * high) for k in kept])
        rows = np.concatenate([rows, np.arange(self.modes, len(self.G))])
        other.poles, other.modes, other.G = self.poles[kept], len(kept) * high, self.G[np.ix_(rows, rows)]
        return other

    def without_feedthrough(self) -> "FilterBank":
        """Return the bank of models whose D is zero; nothing is summed again."""
        other = copy(self)
        rows = np.delete(np.arange(len(self.G)), np.s_[self.modes : self.modes + self.nu * self.feedthrough])
        other.G, other.direct, other.feedthrough = self.G[np.ix_(rows, rows)], int(self.offset), False
        return other

    def _direct_rows(self) -> slice:
        return slice(self.modes, self.modes + self.direct)

    def fit_b(self, c: ComplexArray) -> Modes:
        """Return b, D and constant that fit best with the given output directions c `(ny, m)`."""
        m, inputs = self.poles.size, self.nu + 1
        size = self.modes
        total = size + self.ny * self.direct
        N, r = np.zeros((total, total)), np.zeros(total)
        T = rotations(c)
        N[:size, :size] = _turned_alike(T, self.G[:size, :size], inputs)
        for i in range(self.ny):
            SW = _left(T[i], self.G[:size, self._direct_rows()], m, inputs)
            rows = slice(size + i * self.direct, size + (i + 1) * self.direct)
            N[:size, rows], N[rows, :size] = SW, SW.T
            N[rows, rows] = self.G[self._direct_rows(), self._direct_rows()]
            r[:size] += _left(T[i], self.G[:size, self.modes + self.direct + i, None], m, inputs)[:, 0]
            r[rows] = self.G[self._direct_rows(), self.modes + self.direct + i]
        x = solve(N, r)
        beta = x[:size].reshape(m, inputs, 2)
        return self._modes(beta[..., 0] + 1j * beta[..., 1], c, x[size:].reshape(self.ny, self.direct))

    def fit_c(self, modes: Modes) -> Modes:
        """Return c, D and constant that fit best with the given inputs b; each output by itself."""
        m = self.poles.size
        X = state_map(modes.b, 0, self.direct)
        inner = self.modes + self.direct
        N = X @ self.G[:inner, :inner] @ X.T
        solution = solve(N, X @ self.G[:inner, inner:])
        c = (solution[: 2 * m : 2] + 1j * solution[1 : 2 * m : 2]).T
        return self._modes(modes.b, c, solution[2 * m :].T)

    def _modes(self, b: ComplexArray, c: ComplexArray, direct: FloatArray) -> Modes:
        real = self.poles.imag == 0.0
        b, c = b.copy(), c.copy()
        b[real], c[:, real] = b[real].real, c[:, real].real
        D = direct[:, : self.nu] if self.feedthrough else np.zeros((self.ny, self.nu))
        constant = direct[:, -1] if self.offset else np.zeros(self.ny)
        return Modes(self.poles, b, c, D, constant)

    def loss(self, modes: Modes) -> FloatArray:
        """Return the mean squared error of each output, `(ny,)`."""
        m, inputs = self.poles.size, self.nu + 1
        inner = self.modes + self.direct
        out = np.zeros(self.ny)
        for i in range(self.ny):
            gain = modes.c[i, :, None] * modes.b
            w = np.stack([gain.real, -gain.imag], axis=2).reshape(2 * m * inputs)
            direct = list(modes.D[i]) if self.feedthrough else []
            direct += [modes.constant[i]] if self.offset else []
            v = np.concatenate([w, direct])
            out[i] = self.power[i] - 2.0 * v @ self.G[:inner, inner + i] + v @ self.G[:inner, :inner] @ v
        return np.maximum(out, 0.0) / self.n


def cost(bank: FilterBank, modes: Modes) -> float:
    """Return n sum_i log(mean squared error of output i) + log n (states) (inputs + outputs): Schwarz's criterion."""
    states = int(np.sum(np.where(modes.poles.imag == 0.0, 1, 2)))
    misfit = bank.n * float(np.sum(np.log(np.maximum(bank.loss(modes), np.finfo(float).tiny))))
    return misfit + float(np.log(bank.n)) * states * (bank.nu + bank.ny)


def carried(bank: FilterBank, modes: Modes) -> FloatArray:
    """Return by how many error variances the squares of all outputs would rise without each mode, `(m,)`.

    The other modes' c are fitted again: for output i that is c' (N^-1)^-1 c, the inverse restricted to the mode.
    """
    X = state_map(modes.b, 0, bank.direct)
    inner = bank.modes + bank.direct
    N = X @ bank.G[:inner, :inner] @ X.T
    size = np.sqrt(np.maximum(np.diag(N), np.finfo(float).tiny))
    inverse = np.linalg.pinv(N / np.outer(size, size), rcond=CUTOFF, hermitian=True) / np.outer(size, size)
    error = np.maximum(bank.loss(modes), np.finfo(float).tiny)
    out = np.zeros(len(modes.poles))
    for k, p in enumerate(modes.poles):
        rows = slice(2 * k, 2 * k + 1 if p.imag == 0.0 else 2 * k + 2)
        c = np.stack([modes.c[:, k].real, modes.c[:, k].imag], axis=1)[:, : rows.stop - rows.start]
        with np.errstate(over="ignore"):  # of an output that is met exactly every mode carries infinitely much
            out[k] = float(np.sum(np.einsum("ia,ab,ib->i", c, np.linalg.pinv(inverse[rows, rows]), c) / error))
    return out


def pruned(bank: FilterBank, modes: Modes) -> tuple[FilterBank, Modes]:
    """Leave out modes that the record cannot tell from noise, the fainter half at a time, the rest fitted again."""
    while len(modes.poles) > 1:
        share = told(bank, modes)
        faint = np.flatnonzero(share < 1.0)
        if not faint.size:
            break
        gone = faint[np.argsort(share[faint])[: min((faint.size + 1) // 2, len(share) - 1)]]
        kept = np.setdiff1d(np.arange(len(share)), gone)
        bank = bank.only(kept)
        modes = bank.fit_b(modes.c[:, kept])
    return bank, modes


def told(bank: FilterBank, modes: Modes) -> FloatArray:
    """Return what each mode carries of what it must to be told from noise, `(m,)`.

    That is log n error variances for each of its numbers, as by Schwarz's criterion.
    """
    states = np.where(modes.poles.imag == 0.0, 1, 2)
    return np.asarray(carried(bank, modes) / (states * (bank.nu + bank.ny) * np.log(bank.n)))


def state_map(b: ComplexArray, extra: int, direct: int) -> FloatArray:
    """Return the matrix from a bank's rows to Re x_k, -Im x_k of each mode's state x_k = sum_j b_kj s_kj.

    Each mode has `extra` rows pairs after its inputs that do not enter; `direct` rows follow the modes, unchanged.
    """
    m, inputs = b.shape
    high = 2 * (inputs + extra)
    X = np.zeros((2 * m + direct, m * high + direct))
    for k in range(m):
        at = slice(k * high, k * high + 2 * inputs)
        X[2 * k, at] = np.stack([b[k].real, -b[k].imag], axis=1).ravel()
        X[2 * k + 1, at] = np.stack([-b[k].imag, -b[k].real], axis=1).ravel()
    X[2 * m :, m * high :] = np.eye(direct)
    return X


def rotations(c: ComplexArray) -> FloatArray:
    """Return, for each output and mode, the 2 x 2 matrix from (Re s, Im s) to the factors of (Re b, Im b) in Re(c b s).

    c is `(ny, m)`, the result `(ny, m, 2, 2)`.
    """
    return np.stack([np.stack([c.real, -c.imag], axis=-1), np.stack([-c.imag, -c.real], axis=-1)], axis=-2)


def _turned_alike(T: FloatArray, G: FloatArray, inputs: int) -> FloatArray:
    """Return sum_i T_i G T_i' for the block-diagonal T_i of output i, whatever the outputs for the price of four."""
    m = T.shape[1]
    shaped = G.reshape(m, inputs, 2, m, inputs, 2)
    out = np.zeros_like(shaped)
    for a, b, c, d in np.ndindex(2, 2, 2, 2):
        share = T[:, :, a, c].T @ T[:, :, b, d]
        out[:, :, a, :, :, b] += share[:, None, :, None] * shaped[:, :, c, :, :, d]
    return out.reshape(G.shape)


def _left(T: FloatArray, X: FloatArray, m: int, inputs: int) -> FloatArray:
    """Apply each mode's 2 x 2 matrix to its rows of X."""
    shaped = X.reshape(m, inputs, 2, X.shape[1])
    return np.einsum("kab,kjbx->kjax", T, shaped).reshape(X.shape)


def solve(N: FloatArray, r: FloatArray) -> FloatArray:
    """Solve a semidefinite normal equation, columns scaled, without directions that hold only round-off."""
    size = np.sqrt(np.diag(N))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    values, vectors = np.linalg.eigh(N * scale[:, None] * scale[None, :])
    kept = values > CUTOFF * values[-1]
    right = (r.T * scale).T
    scaled_solution = (vectors[:, kept] / values[kept]) @ (vectors[:, kept].T @ right)
    return (scaled_solution.T * scale).T


def alternate(bank: FilterBank, c: ComplexArray, rounds: int) -> Modes:
    """Fit b and c in turn, so many times; a round that leaves out directions and so raises the loss is not made.

    The count is fixed: where rounds end at a threshold, rounding decides on one more.
    """
    modes = bank.fit_b(c)
    last = _relative(bank, modes)
    for _ in range(rounds):
        better = bank.fit_c(_even(modes))
        better = bank.fit_b(_even(better).c)
        now = _relative(bank, better)
        if now > (1.0 + RAISED) * last:
            break
        modes, last = better, now
    return modes


def _even(modes: Modes) -> Modes:
    """Return the modes with b and c of equal size, which leaves their products as they are."""
    size_b, size_c = np.linalg.norm(modes.b[:, :-1], axis=1), np.linalg.norm(modes.c, axis=0)
    t = np.sqrt(np.where((size_b > 0) & (size_c > 0), size_c / np.where(size_b > 0, size_b, 1.0), 1.0))
    return replace(modes, b=modes.b * t[:, None], c=modes.c / t)


def _relative(bank: FilterBank, modes: Modes) -> float:
    return float(np.sum(bank.loss(modes) * bank.n / bank.power))
