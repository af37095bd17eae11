"""Loops with lightly damped modes, and their poles once the channels of one end are changed."""

import numpy as np
from scipy.linalg import block_diag

from ultraquiet.linalg.riccati_discrete import discrete_riccati
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback


def lightly_damped(rng, ny, nu, modes=4, rate_hz=2000.0, zeta=1e-3):
    """Return a discrete plant of resonances between 10 and 700 Hz."""
    w = 2 * np.pi * np.sort(10 ** rng.uniform(1.0, 2.85, modes)) / rate_hz
    z = np.exp(w * (-zeta + 1j * np.sqrt(1 - zeta**2)))
    A = block_diag(*([[p.real, p.imag], [-p.imag, p.real]] for p in z))
    B = rng.standard_normal((2 * modes, nu)) * np.repeat(np.sqrt(w * zeta), 2)[:, None]
    C = rng.standard_normal((ny, 2 * modes)) * np.repeat(np.sqrt(w * zeta), 2)
    return StateSpace(A, B, C, np.zeros((ny, nu)), rate_hz)


def estimated_feedback(plant, cheap=1e-2):
    """Return a state feedback on a predictor's states, as fragile as `cheap` makes it."""
    nu, ny = plant.B.shape[1], plant.C.shape[0]
    X = discrete_riccati(plant.A, plant.B, plant.C.T @ plant.C, cheap * np.eye(nu)).X
    Y = discrete_riccati(plant.A.T, plant.C.T, plant.B @ plant.B.T, cheap * np.eye(ny)).X
    F = -np.linalg.solve(cheap * np.eye(nu) + plant.B.T @ X @ plant.B, plant.B.T @ X @ plant.A)
    L = np.linalg.solve(cheap * np.eye(ny) + plant.C @ Y @ plant.C.T, plant.C @ Y @ plant.A.T).T
    law = StateSpace(plant.A + plant.B @ F - L @ plant.C, L, F, np.zeros((nu, ny)), plant.rate_hz)
    assert feedback(plant, law).is_stable()
    return law


def radius(plant, law, side, factors):
    """Return the largest modulus of a pole of the loop with a complex factor on every channel of one end."""
    F = np.diag(np.asarray(factors, complex))
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    B, C, D = (B @ F, C, D @ F) if side == "input" else (B, F @ C, F @ D)
    inverse = np.linalg.inv(np.eye(law.D.shape[0]) - law.D @ D)
    u = np.hstack([inverse @ law.D @ C, inverse @ law.C])
    y = np.hstack([C, np.zeros((C.shape[0], law.states))]) + D @ u
    own = block_diag(A, law.A).astype(complex)
    return float(np.abs(np.linalg.eigvals(own + np.vstack([B @ u, law.B @ y]))).max())


def alone(count, channel, factor):
    """Return one factor on one of several channels."""
    factors = np.ones(count, complex)
    factors[channel] = factor
    return factors
