"""Worst cases of 2x2 blocks: how far states can go for measurements within range, and for rounding errors."""

import numpy as np

from ultraquiet._base.constraints import FloatArray

# Impulse responses are summed exactly over this many samples; what comes later is bounded by its envelope.
SAMPLES = 4096
CHUNK = 1024


def peaks(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return the largest |x_k| of x+ = A x + B y for |y_j| <= 1: sum_t sum_j |(A^t B)_kj|, from above.

    Args:
        A: stable blocks, `(blocks, 2, 2)`, rotations with damping or diagonal.
        B: `(blocks, 2, inputs)`.

    Returns:
        `(blocks, 2)`.
    """
    total = np.zeros(B.shape[:2])
    now = B.copy()
    left = SAMPLES
    radius = np.abs(np.linalg.eigvals(A)).max(axis=1)
    powers = _powers(A, CHUNK)
    while left > 0:
        ahead = np.einsum("btij,bjm->btim", powers[:, :CHUNK], now)
        total += np.abs(ahead).sum(axis=(1, 3))
        now = powers[:, CHUNK] @ now
        left -= CHUNK
        if np.abs(now).max(initial=0.0) <= 1e-12 * np.abs(total).max(initial=0.0):
            break
    # |x| of a rotation shrinks by its radius each sample; a diagonal block's by no less.
    rest = np.linalg.norm(now, axis=1).sum(axis=1) / (1.0 - radius)
    return total + rest[:, None]


def rounding_peaks(A: FloatArray, seen: FloatArray) -> FloatArray:
    """Return sum_t sum_k |(seen' A^t)_k|: what errors of one in each state at each step can do, from above.

    Args:
        A: `(blocks, 2, 2)`.
        seen: `(blocks, 2, outputs)`.

    Returns:
        `(blocks, outputs)`.
    """
    flipped = A.transpose(0, 2, 1)
    whole = [peaks(flipped, seen[:, :, k : k + 1]).sum(axis=1) for k in range(seen.shape[2])]
    return np.stack(whole, axis=1)


def energies(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return the variance of each state for measurements white and even over their range: P = A P A' + B B' / 3."""
    return np.stack([np.diag(_gramian(a, b @ b.T / 3.0)) for a, b in zip(A, B, strict=True)])


def rounding_powers(A: FloatArray, seen: FloatArray) -> FloatArray:
    """Return for each block and output the sum of squares of seen' A^t, `(blocks, outputs)`."""
    each = [np.einsum("im,ij,jm->m", s, _gramian(a, np.eye(2)), s) for a, s in zip(A, seen, strict=True)]
    return np.stack(each)


def _gramian(A: FloatArray, Q: FloatArray) -> FloatArray:
    """Return P of P = A P A' + Q, two by two."""
    return np.asarray(np.linalg.solve(np.eye(4) - np.kron(A, A), Q.ravel()), dtype=np.float64).reshape(2, 2)


def _powers(A: FloatArray, count: int) -> FloatArray:
    """Return A^0 to A^count, `(blocks, count + 1, 2, 2)`, by doubling."""
    powers = np.repeat(np.eye(2)[None, None], len(A), axis=0)
    step = A[:, None]
    while powers.shape[1] <= count:
        powers = np.concatenate([powers, powers @ step], axis=1)
        step = step @ step
    return powers[:, : count + 1]
