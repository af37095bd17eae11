"""Frequency response from modal blocks: some hundred times faster than triangular solves where modes are apart."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ultraquiet.linalg import balance
from ultraquiet.linalg.even import UNEVEN, evened
from ultraquiet.linalg.ordered import Array, complex_schur
from ultraquiet.linalg.response import triangular_response

# Loss of digits that is accepted for the speed; beyond it the triangular kernel is used.
CONDITION = 1e6
APART = 1e3  # the same for two states: what a pair of poles loses beside a triangular block of two is not worth it


class Residues(NamedTuple):
    """G(z) = sum of residues / (z - pole), plus what could not be split, plus D."""

    poles: Array
    residues: Array  # (ny * nu, poles)
    rest: tuple[Array, Array, Array] | None  # A in complex Schur form, B, C
    D: Array

    def at(self, z: Array) -> Array:
        """Return the response `(ny, nu, nz)`."""
        ny, nu = self.D.shape
        out = np.broadcast_to(self.D[:, :, None], (ny, nu, z.size)).astype(np.complex128)
        if self.poles.size:
            out += (self.residues @ (1.0 / (z[None, :] - self.poles[:, None]))).reshape(ny, nu, z.size)
        if self.rest is not None:
            out += triangular_response(*self.rest, z)
        return out


def residues(A: Array, B: Array, C: Array, D: Array) -> Residues:
    """Split a system into first-order terms; modes that cannot be told apart stay together in `rest`."""
    return split(balance.modal(*evened(A, B, C, UNEVEN)), D)


def split(form: balance.Coordinates, D: Array) -> Residues:
    """Split a system that is in modal coordinates already."""
    lost = form.T.size > 0 and np.linalg.cond(form.T / np.linalg.norm(form.T, axis=0)) > CONDITION
    poles, terms, left = [np.zeros(0, complex)], [np.zeros((D.size, 0), complex)], []
    for low, high in pairwise([0, *np.cumsum(form.blocks)]):
        if lost or not (high - low == 1 or (high - low == 2 and _oscillates(form.A[low:high, low:high]))):
            left += list(range(low, high))
            continue
        p, b, c = _block(form.A[low:high, low:high], form.B[low:high], form.C[:, low:high])
        poles.append(p)
        terms.append((c[:, None, :] * b.T[None, :, :]).reshape(D.size, p.size))
    rest = None
    if left:
        T, Q = complex_schur(form.A[np.ix_(left, left)])
        rest = (T, Q.conj().T @ form.B[left], form.C[:, left] @ Q)
    return Residues(np.concatenate(poles), np.concatenate(terms, axis=1), rest, D)


def _oscillates(A: Array) -> bool:
    """Return whether a block of two states is a complex pair whose eigenvectors are apart: a double pole is none.

    Rounding makes a pair of a double integrator, of no width, whose residues are as large as they are meaningless. With
    the diagonal's difference 2 d, the eigenvectors of [[d, a], [-b, -d]] have a condition of about (a + b) / w.
    """
    d, a, b = (A[0, 0] - A[1, 1]) / 2, A[0, 1], -A[1, 0]
    width = a * b - d * d  # the imaginary part, squared
    return bool(width > 0 and abs(a) + abs(b) + abs(d) < APART * np.sqrt(width))


def _block(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """Return poles, rows of B and columns of C of a block of one or two states in complex form."""
    if A.shape[0] == 1:
        return A[0].astype(complex), B.astype(complex), C.astype(complex)
    values, vectors = np.linalg.eig(A)
    return values.astype(complex), np.linalg.solve(vectors, B).astype(complex), (C @ vectors).astype(complex)
