"""Finite impulse responses as balanced state space: the Hankel matrix of the response, and nothing else."""

import numpy as np

from ultraquiet._base.constraints import FloatArray

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
NEGLIGIBLE = 1e-13  # of the largest Hankel value: rounding of a single channel
NEGLIGIBLE_GRAM = 1e-7  # of several channels, whose values are roots of a Gram matrix's


class HankelForm:
    """The Hankel values of a finite response and its balanced truncations.

    A response that ends after K samples has the Hankel matrix H_ij = h_(1+i+j), zero beyond K, of finite size. Its
    singular vectors balance the chain of delays exactly, so every truncation is stable and its error over frequency is
    at most twice the sum of the values left out.

    Args:
        response: `(ny, nu, K + 1)`, h_0 (the feedthrough) first.

    Reference: Kung 1978; Antoulas, Approximation of Large-Scale Dynamical Systems, section 4.5 and 7.1.
    """

    def __init__(self, response: FloatArray) -> None:
        self.response = response
        ny, nu, length = response.shape
        count = length - 1
        padded = np.concatenate([response[:, :, 1:], np.zeros((ny, nu, count))], axis=2)
        index = np.arange(count)[:, None] + np.arange(count)[None, :]
        H = padded[:, :, index].transpose(2, 0, 3, 1).reshape(count * ny, count * nu)
        if ny == nu == 1:  # symmetric: its eigenvalues keep all digits
            values, vectors = np.linalg.eigh(H)
            order = np.argsort(-np.abs(values))
            self.values, U = np.abs(values[order]), vectors[:, order]
            V, least = U * np.sign(values[order]), NEGLIGIBLE
        else:
            squares, vectors = np.linalg.eigh(H @ H.T if ny <= nu else H.T @ H)
            self.values = np.sqrt(np.maximum(squares[::-1], 0.0))
            first = vectors[:, ::-1]
            safe = np.where(self.values > 0, self.values, 1.0)
            U, V = (first, H.T @ first / safe) if ny <= nu else (H @ first / safe, first)
            least = NEGLIGIBLE_GRAM
        self.rank = int(np.count_nonzero(self.values > least * max(float(self.values[0]), 1e-300)))
        self._U, self._V = U[:, : self.rank], V[:, : self.rank]

    def system(self, states: int | None = None) -> Matrices:
        """Return A, B, C, D with the largest Hankel values kept (all that are not rounding when absent)."""
        n = self.rank if states is None else min(states, self.rank)
        ny, nu, _ = self.response.shape
        root = np.sqrt(self.values[:n])
        U, V = self._U[:, :n], self._V[:, :n]
        up = np.vstack([U[ny:], np.zeros((ny, n))])  # the observability matrix one sample later
        A = (U.T @ up) * root / root[:, None]
        return A, root[:, None] * V[:nu].T, U[:ny] * root, self.response[:, :, 0].copy()


def response_of(system: Matrices, length: int) -> FloatArray:
    """Return `(ny, nu, length)` samples of the impulse response, the feedthrough first."""
    A, B, C, D = system
    out = np.empty((*D.shape, length))
    out[:, :, 0] = D
    state = B
    for k in range(1, length):
        out[:, :, k] = C @ state
        state = A @ state
    return out
