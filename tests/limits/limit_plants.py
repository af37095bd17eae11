"""Random plants and loops for limits, written without the package's own designs."""

import numpy as np
from scipy.linalg import solve_discrete_are

from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace

RATE_HZ = 1000.0


def modal(rng, channels=1, growth=1.0):
    """Return a plant of one to three modes between 5 and 200 Hz; `growth` above one makes some of them unstable."""
    modes = int(rng.integers(1, 4)) if channels == 1 else channels + 1
    n, w = 2 * modes, 2 * np.pi * rng.uniform(5, 200, modes)
    zeta = rng.uniform(0.02, 0.4, modes)
    A, B, C = np.zeros((n, n)), np.zeros((n, channels)), np.zeros((channels, n))
    for k in range(modes):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, 1], [-(w[k] ** 2), -2 * zeta[k] * w[k]]]
        B[2 * k + 1], C[:, 2 * k + 1] = w[k] * rng.standard_normal(channels), rng.standard_normal(channels)
    A, B, C, D = discretize.zero_order_hold(A, B, C, np.zeros((channels, channels)), 1 / RATE_HZ)
    return StateSpace(A * growth, B, C, D, rate_hz=RATE_HZ)


def rectangular(rng, shape):
    """Return such a plant of so many outputs and inputs."""
    ny, nu = shape
    square = modal(rng, max(shape))
    return StateSpace(square.A, square.B[:, :nu], square.C[:ny], square.D[:ny, :nu], RATE_HZ)


def regulator(plant, rng):
    """Return an LQG law u = K y of random weights from SciPy's Riccati equations."""
    A, B, C, m = plant.A, plant.B, plant.C, plant.D.shape[0]
    r, s = 10.0 ** rng.uniform(-4, 1, 2)
    X = solve_discrete_are(A, B, C.T @ C, r * np.eye(m))
    Y = solve_discrete_are(A.T, C.T, B @ B.T, s * np.eye(m))
    F = np.linalg.solve(r * np.eye(m) + B.T @ X @ B, B.T @ X @ A)
    L = np.linalg.solve(s * np.eye(m) + C @ Y @ C.T, C @ Y @ A.T).T
    return StateSpace(A - B @ F - L @ C, L, -F, np.zeros((m, m)), plant.rate_hz)


def band(rng):
    """Return a band of a third to two octaves below 240 Hz."""
    low = rng.uniform(5, 60)
    return low, low * rng.uniform(1.3, 4)


def responses(plant, law, f_hz):
    """Return |S| and |K S| over frequency, largest singular values, without the package's loops."""
    G, K = (np.moveaxis(s.frequency_response(f_hz), 2, 0) for s in (plant, law))
    S = np.linalg.inv(np.eye(plant.D.shape[0]) - G @ K)
    return np.linalg.norm(S, 2, axis=(1, 2)), np.linalg.norm(K @ S, 2, axis=(1, 2))
