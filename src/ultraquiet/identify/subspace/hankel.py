"""Signal subspaces of Hankel matrices from their Gram matrix: no matrix ever has the length of the record."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Added to the Gram matrix, as a share of its mean diagonal. A band-limited input leaves most directions of a Hankel
# matrix empty; without it the Cholesky factor of what remains there is round-off.
RIDGE = 1e-10

WEIGHTS = ("moesp", "n4sid", "cva")


@dataclass(frozen=True, eq=False)
class Factor:
    """L of [U_f; U_p; Y_p; Y_f] = L Q, lower triangular; all that a subspace method needs to know of a record.

    `rows` block rows of past and of future, over `samples` samples of nu inputs and ny outputs.
    """

    L: FloatArray
    nu: int
    ny: int
    rows: int
    samples: int

    @property
    def first(self) -> int:
        """Where the future inputs end."""
        return self.rows * self.nu

    @property
    def last(self) -> int:
        """Where the future outputs begin."""
        return self.rows * (2 * self.nu + self.ny)


def factor(u: FloatArray, y: FloatArray, rows: int) -> Factor:
    """Return the factor of a record `(nu, n)`, `(ny, n)` with `rows` block rows of past and of future."""
    from ultraquiet.identify.subspace.kernels import hankel_gram

    z = np.ascontiguousarray(np.vstack([u, y]))
    return factored(hankel_gram(z, 2 * rows), u.shape[0], y.shape[0], rows, u.shape[1])


def factored(G: FloatArray, nu: int, ny: int, rows: int, samples: int) -> Factor:
    """Return the factor from the Gram matrix of the block Hankel matrix of [u; y] with `2 rows` block rows."""
    slot = np.arange(2 * rows * (nu + ny)).reshape(2 * rows, nu + ny)
    past, future = slot[:rows], slot[rows:]
    order = np.concatenate([future[:, :nu].ravel(), past[:, :nu].ravel(), past[:, nu:].ravel(), future[:, nu:].ravel()])
    G = G[np.ix_(order, order)]
    G[np.diag_indices_from(G)] += RIDGE * np.trace(G) / len(G)
    return Factor(np.linalg.cholesky(G).astype(np.float64), nu, ny, rows, samples)


def observability(u: FloatArray, y: FloatArray, rows: int, weight: str = "moesp") -> tuple[FloatArray, FloatArray]:
    """Return basis and singular values of the extended observability matrix, `(rows ny, .)`; see `directions`."""
    return directions(factor(u, y, rows), weight)


def directions(lq: Factor, weight: str = "moesp") -> tuple[FloatArray, FloatArray]:
    """Return basis and singular values of the extended observability matrix, `(rows ny, .)`.

    The future outputs are projected on the past inputs and outputs along the future inputs: O = L32 L22^-1 [L21 L22].
    The singular values are those of O (`n4sid`), of O on what the future inputs do not hold, which is L32 (`moesp`),
    and of the latter in units of its own spread (`cva`: canonical correlations).

    Reference: Van Overschee and De Moor 1996, chapter 4; Verhaegen 1994, doi:10.1016/0005-1098(94)90229-1.
    """
    from scipy.linalg import solve_triangular

    L, first, last = lq.L, lq.first, lq.last
    M = L[last:, first:last]
    if weight == "n4sid":
        across = solve_triangular(L[first:last, first:last], L[first:last, :first], lower=True)
        M = np.hstack([M @ across, M])
    if weight != "cva":
        basis, values, _ = np.linalg.svd(M, full_matrices=False)
        return basis.astype(np.float64), values
    rest = L[last:, first:]
    spread = np.linalg.cholesky(rest @ rest.T)
    basis, values, _ = np.linalg.svd(solve_triangular(spread, M, lower=True), full_matrices=False)
    return (spread @ basis).astype(np.float64), values


def transition(basis: FloatArray, values: FloatArray, order: int, ny: int) -> tuple[FloatArray, FloatArray]:
    """Return A and C of the shift structure of the first `order` directions."""
    gamma = basis[:, :order] * np.sqrt(values[:order])
    A = np.linalg.lstsq(gamma[:-ny], gamma[ny:], rcond=None)[0]
    return A.astype(np.float64), gamma[:ny].astype(np.float64)


def poles(basis: FloatArray, values: FloatArray, order: int) -> ComplexArray:
    """Return the eigenvalues of a single-output subspace of the given order."""
    return np.linalg.eigvals(transition(basis, values, order, 1)[0]).astype(np.complex128)
