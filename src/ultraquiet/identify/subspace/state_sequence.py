"""What the state sequence of a subspace says of inputs and noise: B, D, noise covariances and the Kalman gain.

All of it comes from the triangular factor of the Hankel data, without another pass over the record.
"""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import NumericalError
from ultraquiet.identify.subspace.hankel import Factor
from ultraquiet.linalg import equations


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
    B, D = _inputs(lq, gamma, left, shorter, regression[:, order:] @ lq.L[:first, :first])
    return StochasticRealisation(A, B.reshape(order, nu), C, D, kalman_gain(A, C, Q, R, S), Q, R, S)


def _inputs(
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
    total = np.zeros((target.size, (ny + order) * nu))
    future = lq.L[: lq.first, : lq.first].reshape(rows, nu, lq.first)
    for q in range(rows):
        N = np.zeros((order + ny, ny + order))
        if q == 0:
            N[:order, ny:] = np.eye(order)
            N[order:, :ny] = np.eye(ny)
        else:
            N[:order] = shorter[:, (q - 1) * ny :] @ below[: (rows - q) * ny]
        N -= left[:, q * ny :] @ below[: (rows - q) * ny]
        total += np.einsum("rp,jc->rcpj", N, future[q]).reshape(total.shape)
    solution = np.linalg.lstsq(total, target.ravel(), rcond=None)[0].reshape(ny + order, nu).astype(np.float64)
    return solution[ny:], solution[:ny]


def kalman_gain(A: FloatArray, C: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray) -> FloatArray:
    """Return K = (A P C' + S) (C P C' + R)^-1 of the stationary one-step predictor; zero where there is none."""
    try:
        P = equations.discrete_riccati(A.T, C.T, Q, R, S).X
    except NumericalError:
        return np.zeros((A.shape[0], C.shape[0]))
    return np.linalg.solve((C @ P @ C.T + R).T, (A @ P @ C.T + S).T).T
