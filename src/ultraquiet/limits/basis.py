"""Orthonormal rational functions on the unit disc with given poles, as one chain of all-pass sections.

With the poles at zero it is the FIR basis, with one real pole Laguerre's, with one pair Kautz's; here every section has
its own (Takenaka-Malmquist; Heuberger, Van den Hof and Wahlberg 2005, doi:10.1007/1-84628-178-4, chapter 2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.ordered import Matrices

INSIDE = 1 - 1e-7  # poles of the basis stay this far inside the circle


@dataclass(frozen=True, eq=False)
class OrthonormalBasis:
    """A chain of all-pass sections (A, B, C, D), real, of one or two states; their states are the basis."""

    sections: Sequence[tuple[FloatArray, ...]]

    @property
    def size(self) -> int:
        """Number of functions, the constant included."""
        return 1 + sum(s[0].shape[0] for s in self.sections)

    def at(self, angles: FloatArray) -> ComplexArray:
        """Return the functions on the circle, `(size, angles)`; the first is the constant one."""
        w = np.exp(1j * angles)
        rows, through = [np.ones_like(w)[None]], np.ones_like(w)
        for A, B, C, D in self.sections:
            x = _resolvent(A, B[:, 0], w) * through
            rows.append(x)
            through = D[0, 0] * through + C[0] @ x
        return np.concatenate(rows)

    def realised(self, weights: FloatArray) -> Matrices:
        """Return A, B, C, D of sum of weights times functions; weights `(..., size)` with one row an output."""
        w = np.atleast_2d(weights)
        n = self.size - 1
        A, B = np.zeros((n, n)), np.zeros((n, 1))
        out, through, at = np.zeros((1, n)), 1.0, 0
        for a, b, c, d in self.sections:
            m = a.shape[0]
            here = slice(at, at + m)
            A[here, here], A[here, :at], B[here] = a, b @ out[:, :at], b * through
            out = d[0, 0] * out
            out[:, here] = c
            through, at = through * d[0, 0], at + m
        return A, B, w[:, 1:], w[:, :1]


def chain(poles: ComplexArray) -> OrthonormalBasis:
    """Return the basis with these poles, one section each: a complex pole stands for itself and its conjugate."""
    return OrthonormalBasis([_section(_inside(complex(p))) for p in poles])


def _inside(p: complex) -> complex:
    size = abs(p)
    return p * min(1.0, INSIDE / size) if size else p


def _section(p: complex) -> tuple[FloatArray, ...]:
    """Return the balanced all-pass section: [A B; C D] is orthogonal."""
    if p.imag == 0:
        a, b = p.real, np.sqrt(1 - p.real**2)
        return np.array([[a]]), np.array([[b]]), np.array([[b]]), np.array([[-a]])
    # rows of an orthogonal matrix in Schwarz's form: reflection coefficients of the pair
    k2, k1 = abs(p) ** 2, -2 * p.real / (1 + abs(p) ** 2)
    c1, c2 = np.sqrt(1 - k1**2), np.sqrt(1 - k2**2)
    M = np.array([[-k1, -c1 * k2, c1 * c2], [c1, -k1 * k2, k1 * c2], [0.0, c2, k2]])
    return M[:2, :2], M[:2, 2:], M[2:, :2], M[2:, 2:]


def _resolvent(A: FloatArray, b: FloatArray, w: ComplexArray) -> ComplexArray:
    """Return (w I - A)^-1 b for one or two states."""
    if A.shape[0] == 1:
        return (b[0] / (w - A[0, 0]))[None]
    det = (w - A[0, 0]) * (w - A[1, 1]) - A[0, 1] * A[1, 0]
    return np.stack([(w - A[1, 1]) * b[0] + A[0, 1] * b[1], (w - A[0, 0]) * b[1] + A[1, 0] * b[0]]) / det
