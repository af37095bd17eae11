"""Real state space of a sum of residues over poles, each pole as often as its residue has directions that matter."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from ultraquiet._base.constraints import ComplexArray, FloatArray

Block = tuple[FloatArray, FloatArray, FloatArray]


def block(pole: complex, residue: ComplexArray, smallest: float) -> Block:
    """Realise 2 Re(R / (z - p)), or R / (z - p) of a real pole,, of the singular values above `smallest`."""
    real = pole.imag == 0
    U, s, Vh = np.linalg.svd(residue.real if real else residue)
    r = int(np.count_nonzero(s > smallest))
    c = np.asarray(U[:, :r] * np.sqrt(s[:r]), dtype=np.complex128)
    b = np.asarray(np.sqrt(s[:r])[:, None] * Vh[:r], dtype=np.complex128)
    if real:
        return pole.real * np.eye(r), b.real, c.real
    rotation = np.array([[pole.real, -pole.imag], [pole.imag, pole.real]])
    # The complex state x+ = p x + b u, y = 2 Re(c x), written with its real and imaginary parts.
    A = np.asarray(np.kron(np.eye(r), rotation), dtype=np.float64)
    B = np.stack([b.real, b.imag], axis=1).reshape(2 * r, b.shape[1]) * np.sqrt(2.0)
    C = np.stack([c.real, -c.imag], axis=2).reshape(c.shape[0], 2 * r) * np.sqrt(2.0)
    return A, B, C


def joined(blocks: Sequence[Block]) -> Block:
    """Return the sum of blocks as A, B, C."""
    A = np.asarray(block_diag(*[a for a, _, _ in blocks]), dtype=np.float64)
    return A, np.vstack([b for _, b, _ in blocks]), np.hstack([c for _, _, c in blocks])


def delayed(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, samples: int) -> tuple[FloatArray, ...]:
    """Return the discrete system with each input held back by whole samples."""
    nu = B.shape[1]
    for _ in range(samples):
        n = A.shape[0]
        A = np.block([[A, B], [np.zeros((nu, n + nu))]])
        C = np.hstack([C, D])
        B = np.vstack([np.zeros((n, nu)), np.eye(nu)])
        D = np.zeros_like(D)
    return A, B, C, D
