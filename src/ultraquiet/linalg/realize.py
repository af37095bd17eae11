"""State-space realisations of transfer functions that keep their digits at high sampling rates."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.even import to_unit_size
from ultraquiet.linalg.finite_response import HankelForm
from ultraquiet.linalg.ordered import Array

POLISHING = 3  # Newton's steps: each doubles the digits
CLOSE = 1e-4  # a longer step would leave the root it started from

LONG = 10  # taps beyond which a chain of delays loses digits: a Jordan block of that size has no modal coordinates

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]

OF_E = 1e-13  # of E at unit rows and columns: a singular value below it stands for an algebraic equation
SOLVABLE = 1e-12  # of the algebraic equations' own matrix, likewise


def sections(b: FloatArray, a: FloatArray) -> Matrices:
    """Realise sum b_k z^-k / sum a_k z^-k as a cascade of first- and second-order sections in real modal blocks.

    Companion form is avoided: at 3.5 kHz its condition is 1e8 and more, and Riccati solvers fail on it. Each pole pair
    becomes a block [[re, im], [-im, re]]; zeros are paired with the nearest poles; delays become poles at the origin.
    """
    order = max(len(b), len(a)) - 1
    num, den = np.zeros(order + 1), np.zeros(order + 1)
    num[: len(b)], den[: len(a)] = b, a
    if order == 0 or not np.any(num):
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[num[0]]])
    if order > LONG and not np.any(den[1:]):
        return HankelForm(num[None, None]).system()
    zeros = roots(np.trim_zeros(num, "f"))
    gain = num[np.flatnonzero(num)[0]]
    stages = _pair(_groups(roots(den)), _groups(zeros))
    A, B, C, D = _stage(*stages[0])
    for poles, near in stages[1:]:
        A, B, C, D = _series((A, B, C, D), _stage(poles, near))
    return _even(A, B, gain * C, gain * D)


def parallel_inputs(columns: Sequence[Matrices]) -> Matrices:
    """Put single-input systems of one output side by side."""
    return grid([columns])


def grid(blocks: Sequence[Sequence[Matrices]]) -> Matrices:
    """Assemble `(ny, nu)` single-channel systems into one; the states stay channel by channel."""
    ny, nu = len(blocks), len(blocks[0])
    flat = [(i, j, blocks[i][j]) for i in range(ny) for j in range(nu)]
    n = sum(m[0].shape[0] for _, _, m in flat)
    A = np.asarray(block_diag(*[m[0] for _, _, m in flat]), dtype=np.float64).reshape(n, n)
    B, C, D = np.zeros((n, nu)), np.zeros((ny, n)), np.zeros((ny, nu))
    at = 0
    for i, j, (a, b, c, d) in flat:
        rows = slice(at, at + a.shape[0])
        B[rows, j], C[i, rows], D[i, j] = b[:, 0], c[0], d[0, 0]
        at += a.shape[0]
    return A, B, C, D


def roots(p: FloatArray) -> ComplexArray:
    """Return the roots of p, polished by Newton's steps in extended precision.

    Eigenvalues of the companion matrix carry its condition: at 3.5 kHz a 12 Hz pole is off by 1e-12, which is 1e-8 of a
    lightly damped resonance. A step is taken only where it shrinks the polynomial and is tiny; real roots stay real,
    pairs stay conjugate, for both follow from the same arithmetic.
    """
    roots = np.roots(p).astype(np.complex128)
    fine, high = roots.astype(np.clongdouble), p.astype(np.longdouble)
    value, slope = _value_and_slope(high, fine)
    for _ in range(POLISHING):
        step = np.where(slope != 0, value / np.where(slope != 0, slope, 1), 0)
        moved = fine - step
        there, slope_there = _value_and_slope(high, moved)
        better = (np.abs(there) < np.abs(value)) & (np.abs(step) < CLOSE * (np.abs(fine) + CLOSE))
        if not better.any():
            break
        fine = np.where(better, moved, fine)
        value, slope = np.where(better, there, value), np.where(better, slope_there, slope)
    out = fine.astype(np.complex128)
    return np.where(roots.imag == 0, out.real, out)


def _value_and_slope(p: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a polynomial and its derivative at z, by one Horner recursion."""
    value, slope = np.full_like(z, p[0]), np.zeros_like(z)
    for coefficient in p[1:]:
        slope = slope * z + value
        value = value * z + coefficient
    return value, slope


def _groups(roots: ComplexArray) -> list[ComplexArray]:
    """Split roots into conjugate pairs and reals; the reals are then paired among themselves, neighbours first."""
    pairs = [np.array([r, np.conj(r)]) for r in roots if r.imag > 0]
    reals = np.sort(roots[roots.imag == 0].real)
    pairs += [reals[k : k + 2].astype(np.complex128) for k in range(0, len(reals), 2)]
    return pairs


def _pair(poles: list[ComplexArray], zeros: list[ComplexArray]) -> list[tuple[ComplexArray, ComplexArray]]:
    """Give each group of poles, those nearest the unit circle first, the nearest group of zeros of its own size.

    There are never more pairs of zeros than pairs of poles, so only a single zero can be left; it goes to a free stage.
    """
    left = list(zeros)
    pairing: list[tuple[ComplexArray, ComplexArray]] = []
    for group in sorted(poles, key=lambda g: -float(np.abs(g).max())):
        fits = [z for z in left if len(z) == len(group)] or [z for z in left if len(z) < len(group)]
        near = min(fits, key=lambda z: float(np.abs(z[0] - group[0])), default=np.zeros(0, dtype=np.complex128))
        left = [z for z in left if z is not near]
        pairing.append((group, near))
    return pairing


def _stage(poles: ComplexArray, zeros: ComplexArray) -> Matrices:
    """Realise prod(z - zeros) / prod(z - poles) with unit leading coefficient, order one or two."""
    p, q = np.poly(poles).real, np.atleast_1d(np.poly(zeros)).real
    n = len(poles)
    num = np.concatenate([np.zeros(n + 1 - len(q)), q])
    D = num[0]
    rest = num[1:] - D * p[1:]
    if n == 1:
        return np.array([[poles[0].real]]), np.ones((1, 1)), rest.reshape(1, 1), np.array([[D]])
    if poles[0].imag != 0:
        re, im = poles[0].real, abs(poles[0].imag)
        A = np.array([[re, im], [-im, re]])
    else:
        re, im = poles[0].real, 1.0
        A = np.array([[poles[0].real, 1.0], [0.0, poles[1].real]])
    B = np.array([[0.0], [1.0]])
    # C (z I - A)^-1 B = (c1 A12 + c2 (z - A11)) / p(z), matched to rest = r0 z + r1
    c2 = rest[0]
    c1 = (rest[1] + c2 * A[0, 0]) / A[0, 1]
    return A, B, np.array([[c1, c2]]), np.array([[D]])


def _series(first: Matrices, second: Matrices) -> Matrices:
    """Feed the output of the first system into the second."""
    a1, b1, c1, d1 = first
    a2, b2, c2, d2 = second
    A = np.block([[a1, np.zeros((a1.shape[0], a2.shape[0]))], [b2 @ c1, a2]])
    return A, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1


def _even(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> Matrices:
    """Scale the whole state by one number so that input and output matrices are of equal size."""
    size_b, size_c = np.linalg.norm(B), np.linalg.norm(C)
    if size_b == 0 or size_c == 0:
        return A, B, C, D
    t = np.sqrt(size_c / size_b)
    return A, B * t, C / t, D


def explicit(E: Array, A: Array, B: Array, C: Array, D: Array) -> Matrices:
    """Return A, B, C, D of E x' = A x + B u, y = C x + D u.

    Raises:
        NumericalError: the algebraic equations do not fix their variables (index above one).
    """
    if not E.size:
        return A, B, C, D
    rows, columns = _units(E, A)
    U, s, Vt = np.linalg.svd(E * rows[:, None] * columns)
    rank = int(np.sum(s > OF_E * max(float(s[0]), np.finfo(float).tiny)))
    a = U.T @ (A * rows[:, None] * columns) @ Vt.T
    b, c = U.T @ (B * rows[:, None]), (C * columns) @ Vt.T
    a, b = np.vstack([a[:rank] / s[:rank, None], a[rank:]]), np.vstack([b[:rank] / s[:rank, None], b[rank:]])
    if rank == len(s):
        # back in the states as they were given
        return (Vt.T @ a @ Vt) * columns[:, None] / columns, (Vt.T @ b) * columns[:, None], C, D
    inner = a[rank:, rank:]
    size = np.linalg.svd(inner, compute_uv=False)
    if not size[-1] > SOLVABLE * max(float(np.linalg.norm(a[rank:])), np.finfo(float).tiny):
        raise NumericalError(
            f"{len(s) - rank} equations without derivative do not fix the variables without one; the system has an "
            "index above one, differentiate these equations or leave states out."
        )
    solved = np.linalg.solve(inner, np.hstack([a[rank:, :rank], b[rank:]]))
    xa, xb = solved[:, :rank], solved[:, rank:]
    return (
        a[:rank, :rank] - a[:rank, rank:] @ xa,
        b[:rank] - a[:rank, rank:] @ xb,
        c[:, :rank] - c[:, rank:] @ xa,
        D - c[:, rank:] @ xb,
    )


def _units(E: Array, A: Array) -> tuple[Array, Array]:
    """Return factors of equations and variables, powers of two, that make the columns of E and the rows of both alike.

    A variable without derivative and an equation without one are measured by A alone, for E knows nothing of them.
    """
    rows = to_unit_size(np.linalg.norm(np.hstack([E, A]), axis=1))
    E, A = E * rows[:, None], A * rows[:, None]
    columns = to_unit_size(np.linalg.norm(np.where(np.any(E, axis=0), E, A), axis=0))
    return rows * np.where(np.any(E, axis=1), 1.0, to_unit_size(np.linalg.norm(A * columns, axis=1))), columns
