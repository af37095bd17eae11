"""Signal subspaces of Hankel matrices from their Gram matrix: no matrix ever has the length of the record.

The same triangular factor says what the state sequence holds of inputs and noise: B, D, noise covariances and the
Kalman gain, without another pass over the record.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg import equations

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
    """Return the factor of a record `(nu, n)`, `(ny, n)` with `rows` block rows of past and of future.

    Every row of the Hankel matrix loses its own mean, see `without_levels`.
    """
    from ultraquiet.identify.subspace.kernels import hankel_gram

    z = np.ascontiguousarray(np.vstack([u, y]))
    G = without_levels(hankel_gram(z, 2 * rows), z.sum(axis=1), z[:, : 2 * rows], z[:, -2 * rows :], z.shape[1])
    return factored(G, u.shape[0], y.shape[0], rows, u.shape[1])


def without_levels(G: FloatArray, total: FloatArray, head: FloatArray, tail: FloatArray, samples: int) -> FloatArray:
    """Return the Gram matrix of a block Hankel matrix whose rows have each lost their mean.

    Outputs answer inputs from the state that a record begins in, so that their mean is not what the inputs' mean does:
    signals without their means still differ from a linear system's by a constant, which a subspace takes for a mode at
    z = 1 and bends the others to. Rows without their means differ by none.

    Args:
        G: of the Hankel matrix of signals `(m, samples)`, `(rows m, rows m)`.
        total: sums of the signals, `(m,)`.
        head: their first `rows` samples or more.
        tail: their last `rows` samples.
        samples: of the signals.
    """
    rows = len(G) // len(total)
    before = np.cumsum(np.pad(head[:, : rows - 1], ((0, 0), (1, 0))), axis=1)
    after = np.cumsum(np.pad(tail[:, :-rows:-1], ((0, 0), (1, 0))), axis=1)[:, ::-1]
    sums = (total[:, None] - before - after).T.ravel()
    return G - np.outer(sums, sums) / (samples - rows + 1)


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


class StochasticRealisation(NamedTuple):
    """x+ = A x + B u + w, y = C x + D u + v with covariances Q, R, S of w, v and between them; K the Kalman gain."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    K: FloatArray
    Q: FloatArray
    R: FloatArray
    S: FloatArray


def realised(lq: Factor, basis: FloatArray, values: FloatArray, order: int) -> StochasticRealisation:
    """Return the whole model of the first `order` directions.

    A and C follow from the shift structure. With the state sequences X_i = Gamma^+ (Z_i - H U_f), whose H holds the
    unknown B and D, the regression of [X_{i+1}; Y_i] on [X_i; U_f] gives noise covariances as its residual, and B and D
    from its coefficient of U_f.

    Reference: Van Overschee and De Moor 1996, chapter 4, algorithm 3; SLICOT IB01BD, method C.
    """
    ny, nu, first, last = lq.ny, lq.nu, lq.first, lq.last
    gamma = basis[:, :order] * np.sqrt(values[:order])
    inverse = np.linalg.pinv(gamma).astype(np.float64)
    shorter = np.linalg.pinv(gamma[:-ny]).astype(np.float64)
    A, C = shorter @ gamma[ny:], gamma[:ny]
    projected = np.hstack([lq.L[last:, :last], np.zeros((len(basis), ny))])
    ahead = np.vstack([shorter @ lq.L[last + ny :, : last + ny], lq.L[last : last + ny, : last + ny]])
    future = np.hstack([lq.L[:first, :first], np.zeros((first, last + ny - first))])
    known = np.vstack([inverse @ projected, future])
    regression = np.linalg.lstsq(known.T, ahead.T, rcond=None)[0].T.astype(np.float64)
    rest = ahead - regression @ known
    noise = rest @ rest.T / lq.samples
    Q, R, S = noise[:order, :order], noise[order:, order:], noise[:order, order:]
    left = np.vstack([A, C]) @ inverse
    B, D = _inputs_of(lq, gamma, left, shorter, regression[:, order:] @ lq.L[:first, :first])
    return StochasticRealisation(A, B.reshape(order, nu), C, D, kalman_gain(A, C, Q, R, S), Q, R, S)


def _inputs_of(
    lq: Factor, gamma: FloatArray, left: FloatArray, shorter: FloatArray, target: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return B and D from the coefficient of the future inputs, times those: a linear map of [D; B], column by column.

    Block column q of the coefficient is N_q [D; B]; N_q holds what an input at row q does to the states.
    """
    ny, nu, rows, order = lq.ny, lq.nu, lq.rows, gamma.shape[1]
    below = np.zeros((ny + gamma.shape[0], ny + order))  # [D; B] -> response of all rows to an input at row 0
    below[:ny, :ny] = np.eye(ny)
    below[ny:, ny:] = gamma
    below = below[: rows * ny]
    N = np.zeros((rows, order + ny, ny + order))
    N[0, :order, ny:], N[0, order:, :ny] = np.eye(order), np.eye(ny)
    for q in range(rows):
        if q > 0:
            N[q, :order] = shorter[:, (q - 1) * ny :] @ below[: (rows - q) * ny]
        N[q] -= left[:, q * ny :] @ below[: (rows - q) * ny]
    future = lq.L[: lq.first, : lq.first].reshape(rows, nu, lq.first)
    total = np.tensordot(N, future, axes=(0, 0)).transpose(0, 3, 1, 2).reshape(target.size, -1)
    solution = np.linalg.lstsq(total, target.ravel(), rcond=None)[0].reshape(ny + order, nu).astype(np.float64)
    return solution[ny:], solution[:ny]


def kalman_gain(A: FloatArray, C: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray) -> FloatArray:
    """Return K = (A P C' + S) (C P C' + R)^-1 of the stationary one-step predictor; zero where there is none."""
    try:
        P = equations.discrete_riccati(A.T, C.T, Q, R, S).X
    except NumericalError:
        return np.zeros((A.shape[0], C.shape[0]))
    return np.linalg.solve((C @ P @ C.T + R).T, (A @ P @ C.T + S).T).T
