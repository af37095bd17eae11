"""State space of a sum of held fractions: real modal blocks, as many states as residues have rank, and the delay."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.provenance import Provenance
from ultraquiet.linalg.discretize import delay as delay_line
from ultraquiet.values import Channel, StateSpace

# Directions of a residue below this share of its largest are rounding.
RANK = 1e-10

Blocks = list[tuple[FloatArray, FloatArray, FloatArray]]


def realised(
    terms: Sequence[tuple[ComplexArray, ComplexArray]],
    delay: int,
    rate_hz: float,
    actuators: Sequence[Channel],
    sensors: Sequence[Channel],
    provenance: Provenance,
) -> StateSpace:
    """Return z^(1 - delay) sum_k R_k / (z - p_k).

    Args:
        terms: poles `(k,)` in z, conjugates included, and residues `(k, ny, nu)`; poles that appear twice are merged
            where they are equal to the last digit.
        delay: samples from input to first effect.
        rate_hz: of the samples.
        actuators: of the system.
        sensors: likewise.
        provenance: likewise.
    """
    merged: dict[complex, ComplexArray] = {}
    for poles, residues in terms:
        for p, R in zip(poles, residues, strict=True):
            merged[complex(p)] = merged.get(complex(p), 0.0) + R
    blocks = [block(p, R) for p, R in merged.items() if p.imag >= 0.0]
    A, B, C = chained(blocks)
    nu, ny = B.shape[1], C.shape[0]
    Ad, Bd, Cd, Dd = delay_line(delay - 1, nu)
    A = np.block([[A, B @ Cd], [np.zeros((len(Ad), len(A))), Ad]])
    B, C = np.vstack([B @ Dd, Bd]), np.hstack([C, np.zeros((ny, len(Ad)))])
    return StateSpace(A, B, C, np.zeros((ny, nu)), rate_hz, actuators, sensors, provenance)


def block(pole: complex, residue: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Realise R / (z - p), with its conjugate for a complex pole, in as many states as R has rank."""
    real = pole.imag == 0.0
    U, s, Vh = np.linalg.svd(residue.real if real else residue)
    r = max(1, int(np.count_nonzero(s > RANK * s[0])))
    c = np.asarray(U[:, :r] * np.sqrt(s[:r]), dtype=np.complex128)
    b = np.asarray(np.sqrt(s[:r])[:, None] * Vh[:r], dtype=np.complex128)
    if real:
        return pole.real * np.eye(r), b.real, c.real
    # The complex state x+ = p x + b u, y = 2 Re(c x), written with its real and imaginary parts.
    A = np.asarray(np.kron(np.eye(r), [[pole.real, -pole.imag], [pole.imag, pole.real]]), dtype=np.float64)
    B = np.stack([b.real, b.imag], axis=1).reshape(2 * r, -1) * np.sqrt(2.0)
    C = np.stack([c.real, -c.imag], axis=2).reshape(c.shape[0], 2 * r) * np.sqrt(2.0)
    return A, B, C


def chained(blocks: Blocks) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the blocks side by side as one system."""
    from scipy.linalg import block_diag

    A = np.asarray(block_diag(*(a for a, _, _ in blocks)), dtype=np.float64)
    return A, np.vstack([b for _, b, _ in blocks]), np.hstack([c for _, _, c in blocks])
