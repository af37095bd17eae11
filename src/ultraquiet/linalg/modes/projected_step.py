"""Levenberg and Marquardt's step on modes of rank one, the output directions taken out of the equations first.

With the same weight for all channels, the equations of every output have the same matrix W = F o (conj(b) b'), F the
Gram matrix of the functions 1 / (z - p): one Cholesky factor serves them all, and what is left for input directions and
poles is (conj(c') c) o (K - P' W^-1 P), whose cost does not grow with the outputs. The step is that of the whole matrix
(variable projection's block elimination; Golub and Pereyra 2003, doi:10.1088/0266-5611/19/2/201, section 4).
"""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

HEADS = 8  # a few rows of a matrix at a time

Step = tuple[ComplexArray, ComplexArray, ComplexArray]


class ProjectedEquations(NamedTuple):
    """The equations for steps of c, b and p, of upper and real poles (heads): conjugates follow by symmetry.

    Attributes:
        upper: number of complex pairs, which come first among the heads.
        W: `(m, m)` real: of the unknowns of any output.
        P: `(m, heads, nu + 1)`: from each output's equations to input directions and poles, less a factor c.
        K, L: `(heads, nu + 1, heads, nu + 1)`: among input directions and poles of heads, and from heads to the
            conjugates of heads, less the factors cc and dd.
        c: `(ny, heads)`.
        cc, dd: `(heads, heads)` products conj(c') c and conj(c' c).
        g_c, g: `(m, ny)` real and `(heads, nu + 1)`: products of the sensitivities with what is left.
    """

    upper: int
    W: FloatArray
    P: ComplexArray
    K: ComplexArray
    L: ComplexArray
    c: ComplexArray
    cc: ComplexArray
    dd: ComplexArray
    g_c: FloatArray
    g: ComplexArray

    @classmethod
    def of(
        cls, c: ComplexArray, b: ComplexArray, upper: int, phi: ComplexArray, psi: ComplexArray, left: ComplexArray
    ) -> "ProjectedEquations":
        """Return the equations.

        Args:
            c: `(ny, m)` of poles of the upper half plane, their conjugates, real ones.
            b: `(m, nu)` likewise.
            upper: number of pairs.
            phi: `(nf, m)` weighted functions 1 / (z - p).
            psi: `(nf, m)` their slopes by p.
            left: `(ny, nu, nf)` what the modes leave of the weighted samples.
        """
        m = len(b)
        heads = np.concatenate([np.arange(upper), np.arange(2 * upper, m)])
        mirrored = np.concatenate([np.arange(upper, 2 * upper), np.arange(2 * upper, m)])
        # Squares of real and imaginary parts are counted: half at the samples, half at their mirror images.
        swapped = np.concatenate([mirrored[:upper], heads])
        pairs = ((phi, phi), (phi, psi), (psi, psi))
        F, FS, S = (_both_halves(x.conj().T @ y, swapped, swapped) for x, y in pairs)
        bb = b.conj() @ b.T
        P = np.concatenate([F[:, heads, None] * b.conj()[:, None], (FS * bb)[:, heads, None]], axis=2)
        by_phi = _both_halves(np.tensordot(phi.conj(), left, axes=(0, 2)), swapped)
        by_psi = _both_halves(np.tensordot(psi.conj(), left, axes=(0, 2)), swapped)[heads]
        c_h, b_h = c[:, heads], b[heads]
        g_b = np.einsum("kij,ik->kj", by_phi[heads], c_h.conj())
        g_p = np.einsum("kij,ik,kj->k", by_psi, c_h.conj(), b_h.conj(), optimize=True)
        return cls(
            upper,
            _real_part(_rows_of_parts(_columns_of_parts(F * bb, upper), upper)),
            _rows_of_parts(P, upper),
            _among(F, FS, S * bb, b, heads, heads),
            _among(F, FS, S * bb, b, heads, mirrored),
            c_h,
            c_h.conj().T @ c_h,
            c_h.conj().T @ c_h.conj(),
            _real_part(_rows_of_parts(np.einsum("kij,kj->ki", by_phi, b.conj()), upper)),
            np.concatenate([g_b, g_p[:, None]], axis=1),
        )

    def step(self, damping: float) -> Step | None:
        """Return the changes of p `(heads,)`, c `(ny, heads)`, b `(heads, nu)`; None where no digits are left."""
        from scipy.linalg import LinAlgError, cholesky, solve_triangular
        from scipy.linalg.lapack import dpotrf, dpotrs  # pyright: ignore[reportAttributeAccessIssue]

        m, heads, size = self.P.shape
        root_c = np.sqrt(np.maximum(np.diag(self.W), np.finfo(float).tiny))
        scaled = self.W / np.outer(root_c, root_c)
        scaled[np.diag_indices_from(scaled)] += damping
        both = np.concatenate([self.P.real.reshape(m, -1), self.P.imag.reshape(m, -1), self.g_c], axis=1)
        try:
            R = cholesky(scaled, check_finite=False)
            both = solve_triangular(R, both / root_c[:, None], trans=1, check_finite=False)
            k = heads * size
            Z, y = np.ascontiguousarray(both[:, : 2 * k]), both[:, 2 * k :]
            root = np.sqrt(np.maximum(self._diagonal(), np.finfo(float).tiny))
            N, g = self._reduced(Z, y, root)
            N[np.diag_indices_from(N)] += damping
            # of N' in Fortran's order, which is not copied, the upper triangle is the lower one of N
            U, failed = dpotrf(N.T, clean=0, overwrite_a=1)
            if failed:
                return None
            x, _ = dpotrs(U, g / root)
        except LinAlgError:
            return None
        v = self._complex(x / root)
        moved = (self._share()[:, None, None] * v[:, :, None] * self.c.T[:, None]).reshape(k, -1)
        y = y - 2 * Z @ np.concatenate([moved.real, -moved.imag])
        x_c = solve_triangular(R, y, check_finite=False) / root_c[:, None]
        u = self.upper
        dc = np.concatenate([x_c[:u] + 1j * x_c[u : 2 * u], x_c[2 * u :]]).T
        return v[:, -1], np.asarray(dc, dtype=np.complex128), v[:, :-1]

    def _share(self) -> FloatArray:
        """Return 1 for heads with a conjugate, 1/2 for real ones, which are their own."""
        return np.where(np.arange(self.P.shape[1]) < self.upper, 1.0, 0.5)

    def _reduced(self, Z: FloatArray, y: FloatArray, root: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the equations of real unknowns of b and p once c is taken out: the lower triangle, and right sides.

        `Z`, real parts beside imaginary ones, and y are P and g_c divided by W's root. With A and B what K and L
        become, hermitian and symmetric, the matrix is of real parts 2 (A + B), of imaginary ones 2 (A - B), both real,
        and the imaginary part of 2 (A + B) between them; it is divided by the roots of its diagonal on both sides.
        """
        shape, k = self.K.shape, Z.shape[1] // 2
        u = self.upper * shape[1]
        products = Z.T @ Z
        K, L = self.K.reshape(k, k), self.L.reshape(k, k)
        row, low = np.sqrt(2.0) * np.repeat(self._share(), shape[1]) / root[:k], np.sqrt(2.0) / root[k:]
        factors = np.array([self.cc.real, self.cc.imag, self.dd.real, self.dd.imag])[:, :, None]
        N = np.empty((k + u, k + u))
        for first in range(0, shape[0], HEADS):  # rows that stay near the processor
            at = slice(first * shape[1], min(first + HEADS, shape[0]) * shape[1])
            both = slice(at.start, max(min(at.stop, u), at.start))
            many = both.stop - both.start
            rr, ri, ir, ii = products[at, :k], products[at, k:], products[k:][at, :k], products[k:][at, k:]
            p, p_, q, q_ = K.real[at] - rr - ii, K.imag[at] - ri + ir, L.real[at] - rr + ii, L.imag[at] + ri + ir
            by = np.repeat(factors[:, first : first + HEADS], shape[1], axis=3) * row
            c, c_, d, d_ = np.repeat(by, shape[1], axis=2).reshape(4, -1, k)
            A, B = p * c - p_ * c_, q * d - q_ * d_
            N[at, :k] = (A + B) * row[at, None]
            N[k:][both, :k] = (p * c_ + p_ * c + q * d_ + q_ * d)[:many] * low[both, None]
            N[k:][both, k:] = (A - B)[:many, :u] * low[both, None] * (low / row[:u])
        parts = Z.T @ y
        taken = (parts[:k] - 1j * parts[k:]).reshape(*shape[:2], -1)
        g = self.g - np.einsum("lqi,il->lq", taken, self.c.conj())
        return N, self._real_rows(g)

    def _diagonal(self) -> FloatArray:
        """Return the diagonal for b and p before c is taken out: what the damping is measured in."""
        at = np.arange(self.K.shape[0])[:, None], np.arange(self.K.shape[1])
        A = self.K[at[0], at[1], at[0], at[1]].real * np.diag(self.cc).real[:, None]
        B = (self.L[at[0], at[1], at[0], at[1]] * np.diag(self.dd)[:, None]).real
        share = self._share()[:, None]
        return np.concatenate([(2 * (A + B) * share**2).ravel(), 2 * (A - B)[: self.upper].ravel()])

    def _real_rows(self, g: ComplexArray) -> FloatArray:
        return np.concatenate([(2 * self._share()[:, None] * g.real).ravel(), 2 * g.imag[: self.upper].ravel()])

    def _complex(self, x: FloatArray) -> ComplexArray:
        heads, size = self.K.shape[:2]
        v = x[: heads * size].reshape(heads, size).astype(np.complex128)
        v[: self.upper] += 1j * x[heads * size :].reshape(self.upper, size)
        return v


def _among(
    F: ComplexArray, FS: ComplexArray, S: ComplexArray, b: ComplexArray, rows: np.ndarray, columns: np.ndarray
) -> ComplexArray:
    """Return `(rows, nu + 1, columns, nu + 1)` of input directions and poles."""
    nu = b.shape[1]
    K = np.zeros((rows.size, nu + 1, columns.size, nu + 1), dtype=np.complex128)
    at = np.arange(nu)
    K[:, at, :, at] = F[np.ix_(rows, columns)]
    K[:, :nu, :, nu] = FS[np.ix_(rows, columns)][:, None] * b[columns].T
    K[:, nu, :, :nu] = FS[np.ix_(columns, rows)].conj().T[:, :, None] * b[rows].conj()[:, None]
    K[:, nu, :, nu] = S[np.ix_(rows, columns)]
    return K


def _both_halves(X: ComplexArray, rows: np.ndarray, columns: np.ndarray | None = None) -> ComplexArray:
    """Return the mean of products at the samples and at their mirror images, where conjugates change places."""
    other = X[rows] if columns is None else X[np.ix_(rows, columns)]
    return np.asarray((X + other.conj()) / 2, dtype=np.complex128)


def _columns_of_parts(X: ComplexArray, upper: int) -> ComplexArray:
    """Return columns of real and imaginary parts for those of v and its conjugate, which come first."""
    one, other = X[:, :upper], X[:, upper : 2 * upper]
    return np.concatenate([one + other, 1j * (one - other), X[:, 2 * upper :]], axis=1)


def _rows_of_parts(X: ComplexArray, upper: int) -> ComplexArray:
    one, other = X[:upper], X[upper : 2 * upper]
    return np.concatenate([one + other, -1j * (one - other), X[2 * upper :]])


def _real_part(X: ComplexArray) -> FloatArray:
    return np.ascontiguousarray(X.real)
