"""The products of a modal filter bank from one pass over blocks, without ever multiplying states by states.

s_a(t) = p_a s_a(t - 1) + w_a(t) gives s_a s_b* = p_a p_b* s_a(t-1) s_b(t-1)* + s_a w_b + w_a s_b* - w_a w_b. Summed
over the record, the states' products solve (1 - p_a p_b*) G = X + X^H - W - p_a p_b* s_a(end) s_b(end)*: only the
products X of states and inputs need the samples, a hundredth of the work of `kernels.modal_gram`.
"""

from collections.abc import Iterator

import numpy as np

from ultraquiet._base.compiled import FLUSH, compiled
from ultraquiet._base.compiled_arrays import copy_vector
from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify.subspace import modal_least_squares

CELL = 512  # samples whose states are held at once


class StreamedBank(modal_least_squares.FilterBank):
    """A `modal_least_squares.FilterBank` filled from blocks `(nu, m)`, `(ny, m)` of a record of `samples`."""

    def __init__(
        self,
        poles: ComplexArray,
        blocks: Iterator[tuple[FloatArray, FloatArray]],
        shape: tuple[int, int, int],
        feedthrough: bool,
        offset: bool,
    ) -> None:
        self.poles = poles
        self.nu, self.ny, self.n = shape
        self.direct = (self.nu if feedthrough else 0) + int(offset)
        self.feedthrough, self.offset = feedthrough, offset
        self.modes = 2 * poles.size * (self.nu + 1)
        X, tails, last = self._summed(blocks)
        self.G = self._assembled(X, tails, last)
        self.power = np.diag(self.G)[-self.ny :].copy()

    def _summed(self, blocks: Iterator[tuple[FloatArray, FloatArray]]) -> tuple[ComplexArray, FloatArray, ComplexArray]:
        """Return states times [w, direct, y], the products of the latter, and the last states."""
        m, inputs = self.poles.size, self.nu + 1
        width = inputs + self.direct + self.ny
        real, imaginary = np.zeros((m * inputs, width)), np.zeros((m * inputs, width))
        tails = np.zeros((width, width))
        state = np.zeros((2, inputs, m))
        # Inputs act one sample late; a pulse before the first sample starts every mode at one.
        before = np.zeros((self.nu, 1))
        first = True
        for u, y in blocks:
            tail = np.zeros((width, u.shape[1]))
            tail[: self.nu] = np.hstack([before, u[:, :-1]])
            tail[self.nu, 0] = float(first)
            if self.feedthrough:
                tail[inputs : inputs + self.nu] = u
            if self.offset:
                tail[inputs + self.direct - 1] = 1.0
            tail[inputs + self.direct :] = y
            rows = np.ascontiguousarray(tail.T)
            drive(self.poles.real.copy(), self.poles.imag.copy(), state, rows, inputs, real, imaginary)
            tails += tail @ rows
            before, first = u[:, -1:], False
        return real + 1j * imaginary, tails, (state[0] + 1j * state[1]).reshape(-1)

    def _assembled(self, X: ComplexArray, tails: FloatArray, last: ComplexArray) -> FloatArray:
        """Return the bank's matrix: states by pole, then input, each as real and imaginary part."""
        m, inputs = self.poles.size, self.nu + 1
        p = np.tile(self.poles, inputs)
        of = np.repeat(np.arange(inputs), m)
        driven, W = X[:, of], tails[np.ix_(of, of)]
        conjugate = np.outer(p, p.conj())
        G = (driven + driven.conj().T - W - conjugate * np.outer(last, last.conj())) / (1.0 - conjugate)
        plain = np.outer(p, p)
        H = (driven + driven.T - W - plain * np.outer(last, last)) / (1.0 - plain)
        size = self.modes
        out = np.zeros((size + self.direct + self.ny,) * 2)
        # From input-major to pole-major.
        at = 2 * (np.tile(np.arange(m), inputs) * inputs + of)
        out[np.ix_(at, at)] = (G + H).real / 2
        out[np.ix_(at + 1, at + 1)] = (G - H).real / 2
        out[np.ix_(at, at + 1)] = (H - G).imag / 2
        out[np.ix_(at + 1, at)] = (H + G).imag / 2
        out[at, size:], out[at + 1, size:] = X[:, inputs:].real, X[:, inputs:].imag
        out[size:, :size] = out[:size, size:].T
        out[size:, size:] = tails[inputs:, inputs:]
        return out


@compiled
def drive(pr, pi, state, rows, inputs, real, imaginary):
    """Advance every pole under every input over `rows` `(t, width)`; add the states' products with the rows.

    The poles of one input stand side by side: they do not wait for each other, as samples of one filter would.
    """
    m, n = pr.size, rows.shape[0]
    re, im = np.zeros((CELL, inputs * m)), np.zeros((CELL, inputs * m))
    for start in range(0, n, CELL):
        used = min(CELL, n - start)
        re[used:], im[used:] = 0.0, 0.0
        for t in range(used):
            for j in range(inputs):
                x, y = state[0, j], state[1, j]
                w, at = rows[start + t, j], j * m
                for k in range(m):
                    a = pr[k] * x[k] - pi[k] * y[k] + w
                    b = pr[k] * y[k] + pi[k] * x[k]
                    x[k], y[k] = a, b
                    re[t, at + k], im[t, at + k] = a, b
        for j in range(inputs):
            for k in range(m):
                if abs(state[0, j, k]) + abs(state[1, j, k]) < FLUSH:
                    state[:, j, k] = 0.0
        some = rows[start : start + used]
        real += np.dot(re[:used].T, some)
        imaginary += np.dot(im[:used].T, some)


@compiled
def simulated(A, driven, x, states):
    """Fill the states of x+ = A x + driven and leave the next one in x."""
    order, n = driven.shape
    out = np.empty(order)
    for t in range(n):
        for i in range(order):
            states[i, t] = x[i]
        for i in range(order):
            s = driven[i, t]
            for k in range(order):
                s += A[i, k] * x[k]
            out[i] = s
        copy_vector(out, x)
