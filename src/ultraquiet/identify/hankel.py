"""Signal subspaces of Hankel matrices from their Gram matrix: no matrix ever has the length of the record."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Added to the Gram matrix, as a share of its mean diagonal. A band-limited input leaves most directions of a Hankel
# matrix empty; without it the Cholesky factor of what remains there is round-off.
RIDGE = 1e-10


def observability(u: FloatArray, y: FloatArray, rows: int) -> tuple[FloatArray, FloatArray]:
    """Return basis and singular values of the extended observability matrix, `(rows ny, .)`: PO-MOESP.

    The future outputs are projected on the past inputs and outputs, orthogonal to the future inputs, by the Cholesky
    factor of the Gram matrix of [U_f; U_p, Y_p; Y_f] (Verhaegen 1994, doi:10.1016/0005-1098(94)90229-1).
    """
    from ultraquiet.identify.state_kernels import hankel_gram

    nu, ny = u.shape[0], y.shape[0]
    width = nu + ny
    z = np.ascontiguousarray(np.vstack([u, y]))
    G = hankel_gram(z, 2 * rows)
    slot = np.arange(2 * rows * width).reshape(2 * rows, width)
    past, future = slot[:rows], slot[rows:]
    order = np.concatenate([future[:, :nu].ravel(), past[:, :nu].ravel(), past[:, nu:].ravel(), future[:, nu:].ravel()])
    G = G[np.ix_(order, order)]
    G[np.diag_indices_from(G)] += RIDGE * np.trace(G) / len(G)
    L = np.linalg.cholesky(G)
    first = rows * nu
    last = 2 * rows * nu + rows * ny
    basis, values, _ = np.linalg.svd(L[last:, first:last], full_matrices=False)
    return basis.astype(np.float64), values


def transition(basis: FloatArray, values: FloatArray, order: int, ny: int) -> tuple[FloatArray, FloatArray]:
    """Return A and C of the shift structure of the first `order` directions."""
    gamma = basis[:, :order] * np.sqrt(values[:order])
    A = np.linalg.lstsq(gamma[:-ny], gamma[ny:], rcond=None)[0]
    return A.astype(np.float64), gamma[:ny].astype(np.float64)


def poles(basis: FloatArray, values: FloatArray, order: int) -> ComplexArray:
    """Return the eigenvalues of a single-output subspace of the given order."""
    return np.linalg.eigvals(transition(basis, values, order, 1)[0]).astype(np.complex128)
