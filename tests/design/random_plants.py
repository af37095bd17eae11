"""Stable plants of every kind that identification or modelling may hand to a design."""

import numpy as np
from scipy.linalg import block_diag

from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import series

CHAINED = 1 - 1e-4  # chained poles nearer to the unit circle would be unstable in double precision


def random_stable(rng):
    """Return a stable discrete plant of 1 to 40 states and 1 to 6 channels each way, of an arbitrary kind.

    Resonances damped down to 1e-6, repeated poles (chained or side by side), delays, zeros outside the unit circle,
    inputs or outputs without any effect, units spread over twelve decades, modal or mixed coordinates.
    """
    rate_hz = 10 ** rng.uniform(1.5, 4.5)
    ny, nu = rng.integers(1, 7, 2)
    delay = int(rng.integers(0, 3)) if rng.random() < 0.5 else 0
    wanted = max(int(rng.integers(1, 41)) - delay * nu, 1)
    A = _poles(rng, wanted)
    n = A.shape[0]
    B, C = rng.standard_normal((n, nu)), rng.standard_normal((ny, n))
    D = rng.standard_normal((ny, nu)) * (rng.random() < 0.3)
    for matrix in (B, C.T):
        if rng.random() < 0.15:
            matrix[:, rng.integers(matrix.shape[1])] = 0.0
        if rng.random() < 0.15:
            matrix[rng.integers(n)] = 0.0
    if rng.random() < 0.15:
        D[:, ~np.any(B, axis=0)] = 0.0
    inputs, outputs = 10.0 ** rng.uniform(-3, 3), 10.0 ** rng.uniform(-3, 3)
    T = _coordinates(rng, n)
    Ti = np.linalg.inv(T)
    G = StateSpace(Ti @ A @ T, Ti @ B * inputs, C @ T * outputs, D * inputs * outputs, rate_hz)
    assert G.is_stable()
    return series(StateSpace(*discretize.delay(delay, nu), rate_hz=rate_hz), G) if delay else G


def _poles(rng, wanted):
    blocks = []
    while sum(len(b) for b in blocks) < wanted:
        if wanted - sum(len(b) for b in blocks) >= 2 and rng.random() < 0.7:
            w, zeta = 2 * np.pi * 10 ** rng.uniform(-2.5, np.log10(0.49)), 10 ** rng.uniform(-6, -0.3)
            z = np.exp(w * (-zeta + 1j * np.sqrt(1 - zeta**2)))
            blocks.append(np.array([[z.real, z.imag], [-z.imag, z.real]]))
        else:
            blocks.append(np.array([[rng.choice([-1, 1]) * (1 - 10 ** rng.uniform(-4, 0))]]))
        again = blocks[-1]
        if rng.random() < 0.1 and sum(len(b) for b in blocks) + len(again) <= wanted:
            m = len(again)
            blocks[-1] = block_diag(again, again)
            if np.abs(np.linalg.eigvals(again)).max() < CHAINED:
                blocks[-1][:m, m:] = np.eye(m) * rng.integers(0, 2) * 0.1
    return block_diag(*blocks)


def _coordinates(rng, n):
    kind = rng.integers(3)
    if kind == 0:
        return np.eye(n)
    if kind == 1:
        return np.diag(10 ** rng.uniform(-3, 3, n))
    return np.linalg.qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-1, 1, n)
