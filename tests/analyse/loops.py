"""Loops with lightly damped modes, and their poles once the channels of one end are changed."""

import numpy as np
from scipy.linalg import block_diag

from ultraquiet.linalg.riccati_discrete import discrete_riccati
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback, gain


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


def slow_loop(zeros, poles, rate_hz, shape=(1, 1), mirrored=False):
    """Return a plant and a law whose first channel has S of three zeros and poles, in rad/s, far below the rate.

    The other channels are fast and only hear of the first; mirrored, z is -z and what was near 0 Hz is near Nyquist.
    """
    (ny, nu), sign, more = shape, -1.0 if mirrored else 1.0, min(shape) - 1
    numerator, denominator = np.poly(zeros), np.poly(poles)
    slow = sign * (np.eye(3) + np.vstack([-numerator[1:], np.eye(2, 3)]) / rate_hz)
    B, C = np.zeros((3 + more, nu)), np.zeros((ny, 3 + more))
    B[0, 0], C[0, :3], C[1:, :3] = sign / rate_hz, (numerator - denominator)[1:], 0.01
    B[3:], C[1:, 3:] = np.eye(more, nu, 1), np.eye(ny - 1, more)
    law = np.diag(np.r_[1.0, np.full(more, -0.2)])
    law = np.pad(law, ((0, nu - more - 1), (0, ny - more - 1)))
    return StateSpace(block_diag(slow, 0.5 * np.eye(more)), B, C, np.zeros((ny, nu)), rate_hz), gain(law, rate_hz)


def stiff(rng, ny, nu, rate_hz=2e4):
    """Return modes decades apart, in coordinates at random, and a law of 0.4 times the static inverse, sign and all."""
    z = np.exp(2 * np.pi * np.array([0.01, 30.0, 900.0]) / rate_hz * (-0.3 + 1j))
    A = block_diag(*([[p.real, p.imag], [-p.imag, p.real]] for p in z))
    B, C = rng.standard_normal((6, nu)), rng.standard_normal((ny, 6))
    Q = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    plant = StateSpace(Q @ A @ Q.T, Q @ B, C @ Q.T, np.zeros((ny, nu)), rate_hz)
    return plant, gain(0.4 * np.linalg.pinv(plant.frequency_response([0.0])[:, :, 0].real), rate_hz)


def in_other_units(plant, law):
    """Return the same loop with every channel in a unit of its own."""
    u, y = 10.0 ** np.linspace(-5, 4, plant.B.shape[1]), 10.0 ** np.linspace(3, -6, plant.C.shape[0])
    other = StateSpace(plant.A, plant.B * u, plant.C * y[:, None], plant.D * u * y[:, None], plant.rate_hz)
    return other, StateSpace(law.A, law.B / y, law.C / u[:, None], law.D / u[:, None] / y, law.rate_hz)


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
