"""Frequency response from modal blocks: some hundred times faster than triangular solves where modes are apart."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import schur

from ultraquiet.linalg import balance
from ultraquiet.linalg.even import UNEVEN, evened
from ultraquiet.linalg.ordered import Array, complex_schur, real_schur
from ultraquiet.linalg.response import triangular_response

# Loss of digits that is accepted for the speed; beyond it the triangular kernel is used.
CONDITION = 1e6
APART = 1e3  # the same for poles and their conjugates: what a pair loses beside a triangular block is not worth it
TIED = 8  # states of a block whose terms are written out; of more, triangular solves take less work
ROUNDING = np.finfo(float).eps
LINES = 4096  # points taken at a time
AGREE = 1e-8  # of a response, in even units: as far modes may be off a direct solve where they are compared
UNCERTAIN = 16  # times rounding, over the distance from a pole: as far direct solves may be off themselves
COMPARED = 96  # points at most
BEYOND = 10.0  # times the fastest pole, and its inverse times the slowest: the response is compared there too
SWEEPS = 4  # that bring rows and columns of a response to one size


class PoleClusters(NamedTuple):
    """Clusters of q poles each, triangular `(clusters, q, q)`, alone or beside their conjugates."""

    T: Array
    paired: bool

    def functions(self, z: Array) -> Array:
        """Return the entries of (z I - T)^-1 `(terms, nz)`.

        Of a pair their sum and j times their difference, which real matrices weigh.
        """
        E = _inverse(self.T, z)
        if self.paired:
            F = _inverse(self.T.conj(), z)
            E = np.concatenate([E + F, 1j * (E - F)])
        return E.reshape(E.shape[0] * E.shape[1], z.size)


class Residues(NamedTuple):
    """G(z) = sum of terms times functions of z, 1 / (z - pole) and such, plus what could not be split, plus D."""

    modes: tuple[PoleClusters, ...]
    terms: Array  # (ny * nu, functions), real for a real system
    rest: tuple[Array, Array, Array] | None  # A in complex Schur form, B, C
    D: Array

    def at(self, z: Array) -> Array:
        """Return the response `(ny, nu, nz)`."""
        ny, nu = self.D.shape
        out = np.broadcast_to(self.D[:, :, None], (ny, nu, z.size)).astype(np.complex128)
        for k in range(0, z.size if self.modes else 0, LINES):
            part = z[k : k + LINES]
            out[:, :, k : k + LINES] += _weighed(self.terms, self.functions(part)).reshape(ny, nu, part.size)
        if self.rest is not None:
            out += triangular_response(*self.rest, z)
        return out

    def functions(self, z: Array) -> Array:
        """Return the functions `(functions, nz)` that `terms` weigh."""
        return np.concatenate([np.zeros((0, z.size), complex), *(modes.functions(z) for modes in self.modes)])

    def entries(self, rows: Array, columns: Array, z: Array) -> Array:
        """Return single entries `(n,)`, each at a point of its own, of a system without `rest`."""
        chosen = self.terms[rows * self.D.shape[1] + columns]
        return self.D[rows, columns] + np.einsum("kt,tk->k", chosen, self.functions(z))


def residues(A: Array, B: Array, C: Array, D: Array) -> Residues:
    """Split a system into first-order terms; modes that cannot be told apart stay together."""
    A, B, C = evened(A, B, C, UNEVEN)
    found = split(balance.modal(A, B, C), D)
    return found if found.modes else _whole(A, B, C, D)


class Splitting(NamedTuple):
    """A system without its direct term, split and whole, and what both give at some points of the axis."""

    split: Residues
    whole: Residues
    of_modes: Array  # (ny, nu, points)
    exact: Array  # (ny, nu, points)
    share: Array  # (points,), of the response: as far both may be apart

    def beside(self, D: Array) -> Residues:
        """Return the modes, or the whole where they lose digits of the response that D `(ny, nu)` is a part of.

        What a loop gives beside a direct term of one, far below its modes, is of no account but by itself.
        """
        agree = _agree(self.of_modes - self.exact, self.exact + D[:, :, None], self.share)
        return (self.split if agree else self.whole)._replace(D=D)


def splitting(A: Array, B: Array, C: Array, discrete: bool) -> Splitting:
    """Split a system as `residues` does, to be left whole where modes lose digits of the response.

    What nearly parallel modes lose, no condition of theirs tells without what they move and are seen by, nor without
    how near to the axis they are: modes and triangular solves are compared at the poles' frequencies and between them.

    Args:
        A: `(n, n)`.
        B: `(n, nu)`.
        C: `(ny, n)`.
        discrete: whether the unit circle or the imaginary axis is where the response is asked for.
    """
    A, B, C = evened(A, B, C, UNEVEN)
    D = np.zeros((C.shape[0], B.shape[1]))
    found, whole, none = split(balance.modal(A, B, C), D), _whole(A, B, C, D), np.zeros((*D.shape, 0))
    if not found.modes or whole.rest is None:
        return Splitting(whole, whole, none, none, np.zeros(0))
    z, share = _compared(np.diag(whole.rest[0]), discrete)
    return Splitting(found, whole, found.at(z), whole.at(z), share)


def _whole(A: Array, B: Array, C: Array, D: Array) -> Residues:
    """Return what is left of a system of which nothing is split: of the states given, not of modes that lose digits."""
    rest = None
    if A.size:
        T, Q = complex_schur(A)
        rest = T, Q.conj().T @ B, C @ Q
    return Residues((), np.zeros((D.size, 0)), rest, D)


def split(form: balance.Coordinates, D: Array) -> Residues:
    """Split a system that is in modal coordinates already."""
    size = np.linalg.norm(form.T, axis=0)
    lost = form.T.size > 0 and not balance.well_conditioned(form.T / size, form.inverse * size[:, None], CONDITION)
    left, clusters = list[int](), dict[tuple[int, bool], list[tuple[Array, Array, Array, Array]]]()
    blocks = [np.arange(low, high) for low, high in pairwise([0, *np.cumsum(form.blocks)])]
    if lost:
        left, blocks = [int(i) for block in blocks for i in block], []
    for size in {block.size for block in blocks}:
        alike = np.array([block for block in blocks if block.size == size])
        A = form.A[alike[:, :, None], alike[:, None, :]]
        for k, pair in enumerate(_pairs(A) if size == 2 else [None] * len(A)):
            states, found = alike[k], pair or _cluster(A[k])
            if found is None:
                left += [int(i) for i in states]
            else:
                clusters.setdefault((len(found[0]), len(found[0]) < size), []).append((*found, states))
    modes, terms = list[PoleClusters](), [np.zeros((D.size, 0))]
    for (_, paired), found in clusters.items():
        T, right, inverse, states = (np.array(part) for part in zip(*found, strict=True))
        modes.append(PoleClusters(T, paired))
        terms.append(_terms(form.B[states], np.moveaxis(form.C[:, states], 0, 1), right, inverse, paired))
    rest = None
    if left:
        T, Q = complex_schur(form.A[np.ix_(left, left)])
        rest = (T, Q.conj().T @ form.B[left], form.C[:, left] @ Q)
    return Residues(tuple(modes), np.concatenate(terms, axis=1), rest, D)


def _compared(poles: Array, discrete: bool) -> tuple[Array, Array]:
    """Return points of the axis at the frequencies and moduli of poles, between those and beyond, and a tolerance each.

    A point at which rounding decides on which side of it a pole is is left out.
    """
    s = np.log(poles[poles != 0]) if discrete else poles
    w = np.concatenate([np.abs(s.imag), np.abs(s)])
    w = np.unique(w[(w > ROUNDING * w.max(initial=0.0)) & ((w < np.pi) | (not discrete))])
    if w.size:
        w = np.concatenate([w, np.sqrt(w[1:] * w[:-1]), [w[0] / BEYOND, BEYOND * w[-1]]])
    w = np.append(np.sort(w[w < np.pi]), np.pi) if discrete else np.sort(w)
    w = w[np.unique(np.linspace(0, w.size - 1, min(w.size, COMPARED)).astype(int))]
    z = np.exp(1j * w) if discrete else 1j * w
    apart = np.abs(z[:, None] - poles).min(axis=1, initial=np.inf)
    lost = UNCERTAIN * ROUNDING * float(np.abs(poles).max())
    return z[apart > lost], AGREE + lost / apart[apart > lost]


def _agree(error: Array, exact: Array, share: Array) -> bool:
    """Return whether an error is no more than a share of a response `(ny, nu, nz)` at each point, in whatever units."""
    if not exact.size:
        return True
    size = np.abs(exact).max(axis=2)
    rows, columns = np.ones(size.shape[0]), np.ones(size.shape[1])
    for _ in range(SWEEPS):
        scaled = size * rows[:, None] * columns
        rows = rows / np.sqrt(_or_one(scaled.max(axis=1)))
        columns = columns / np.sqrt(_or_one(scaled.max(axis=0)))
    weight = (rows[:, None] * columns)[:, :, None]
    off, height = (weight * np.abs(error)).max(axis=(0, 1)), (weight * np.abs(exact)).max(axis=(0, 1))
    return bool(np.all(off <= share * height))


def _or_one(size: Array) -> Array:
    return np.where(size > 0, size, 1.0)


def _inverse(T: Array, z: Array) -> Array:
    """Return the upper triangle of (z I - T)^-1, row by row, `(q (q + 1) / 2, clusters, nz)`."""
    q = T.shape[-1]
    found = np.empty((q, q, len(T), z.size), dtype=np.complex128)
    for j in range(q):
        pole = T[:, j, j, None]
        # a point that meets a pole in every digit is beside it by what rounding leaves of both
        found[j, j] = 1.0 / np.where(z == pole, ROUNDING * pole, z - pole)
        for i in range(j - 1, -1, -1):
            known = sum(T[:, i, k, None] * found[k, j] for k in range(i + 1, j + 1))
            found[i, j] = found[i, i] * known
    return found[0] if q == 1 else found[np.triu_indices(q)]  # nearly all are poles by themselves


def _weighed(terms: Array, functions: Array) -> Array:
    """Return terms @ functions, of real terms by half the multiplications."""
    if np.iscomplexobj(terms):
        return terms @ functions
    return (terms @ np.ascontiguousarray(functions).view(np.float64)).view(np.complex128)


def _terms(B: Array, C: Array, right: Array, inverse: Array, paired: bool) -> Array:
    """Return what weighs the functions of some clusters, `(ny * nu, functions)`.

    Args:
        B: rows of the blocks' states, `(clusters, states, nu)`.
        C: their columns, `(clusters, ny, states)`.
        right: bases of the clusters, `(clusters, states, q)`.
        inverse: rows that lead to them, `(clusters, q, states)`.
        paired: whether the conjugates of the bases complete them.
    """
    parts = [_products(C @ right, inverse @ B)]
    if paired and (np.iscomplexobj(B) or np.iscomplexobj(C)):
        other = _products(C @ right.conj(), inverse.conj() @ B)
        parts = [(parts[0] + other) / 2, (parts[0] - other) / 2j]
    elif paired:
        parts = [parts[0].real, parts[0].imag]
    return np.concatenate(parts).reshape(-1, parts[0].shape[-1]).T


def _products(c: Array, b: Array) -> Array:
    """Return c_i b_j for the upper triangle of i and j, `(q (q + 1) / 2, clusters, ny * nu)`."""
    i, j = np.triu_indices(b.shape[1])
    products = np.moveaxis(c, 2, 0)[i][:, :, :, None] * np.moveaxis(b, 1, 0)[j][:, :, None, :]
    return products.reshape(*products.shape[:2], -1)


def _pairs(A: Array) -> list[tuple[Array, Array, Array] | None]:
    """Do what `_cluster` does, for blocks of two states at once; None where poles are real or no pair to be split."""
    d, a, b = (A[:, 0, 0] - A[:, 1, 1]) / 2, A[:, 0, 1], -A[:, 1, 0]
    width = a * b - d * d  # the imaginary part, squared
    # rounding makes a pair of a double integrator, of no width, whose residues are as large as they are meaningless:
    # the eigenvectors of [[d, a], [-b, -d]] have a condition of about (a + b) / w
    apart = (width > 0) & (np.abs(a) + np.abs(b) + np.abs(d) < APART * np.sqrt(np.maximum(width, 0.0)))
    w = np.sqrt(np.where(apart, width, 1.0))
    pole = (A[:, 0, 0] + A[:, 1, 1]) / 2 + 1j * w
    # [[d, a], [-b, -d]] v = j w v, and rows that are one on it and zero on its conjugate
    v = np.stack([a + 0j, 1j * w - d], axis=1)
    row = np.stack([0.5 * (w - 1j * d), -0.5j * a], axis=1) / np.where(apart, a * w, 1.0)[:, None]
    found = zip(pole[:, None, None], v[:, :, None], row[:, None, :], strict=True)
    return [part if yes else None for yes, part in zip(apart, found, strict=True)]


def _cluster(A: Array) -> tuple[Array, Array, Array] | None:
    """Return T, V and what leads to it, of a block A = V T V^-1 or with the conjugates of T and V beside them.

    None where poles and their conjugates are not apart, or some poles are real and some are not, or too many.
    """
    if len(A) > TIED:
        return None
    T, Q = real_schur(A)
    if not np.any(np.diag(T, -1)):
        return T, Q, Q.T
    found: tuple[Array, Array, int] = schur(A, output="complex", sort=_above)  # pyright: ignore[reportAssignmentType]
    T, Q, above = found
    if 2 * above != len(A):
        return None
    V = Q[:, :above]
    both = np.hstack([V, V.conj()])
    if np.linalg.cond(both) > APART:
        return None
    return T[:above, :above], V, np.linalg.inv(both)[:above]


def _above(pole: complex) -> bool:
    return pole.imag > 0
