"""A drawn table: a rigid top on soft mounts, 20 accelerometers and 4 inclined actuators at 8 kHz, one unplugged."""

import numpy as np
from scipy.linalg import expm

from ultraquiet.bench import Wrapped
from ultraquiet.values import Channel, StateSpace
from ultraquiet.values.blended.matrices import actuator_matrix, rigid_body, sensor_matrix

RATE_HZ, CONTROL_HZ = 8000.0, 2000.0
MODES = ["x", "y", "z", "rx", "ry", "rz"]
DRIVEN = [2, 3, 4, 5]  # four legs at the corners, inclined along the edge of a circle: z and the rotations
MASS_KG, INERTIA = 120.0, np.array([9.0, 14.0, 20.0])
NOISE = 2e-3  # m/s^2, of each accelerometer


def legs():
    """Where the four actuators stand and push."""
    angle = np.pi / 4 + np.pi / 2 * np.arange(4)
    p = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(4, -0.1)], axis=1)
    turn = np.where(np.arange(4) % 2, 0.5, 0.6)  # not all alike, so that no mode is driven by symmetry alone
    return p, np.stack([-turn * np.sin(angle), turn * np.cos(angle), np.full(4, 0.8)], axis=1)


def drawn_table(seed, sensors=20):
    """The linear truth at 8 kHz without the bench's sample of delay, and where its sensors stand and point."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-0.6, -0.4, -0.1], [0.6, 0.4, 0.2], (sensors, 3))
    d = np.eye(3)[np.arange(sensors) % 3] + 0.05 * rng.standard_normal((sensors, 3))
    shapes = rigid_body(p, d)
    push = rigid_body(*legs())
    f = rng.uniform(6.0, 25.0, 6)  # suspension
    flexible = rng.uniform(180.0, 420.0, 3)  # of the top itself
    w = 2 * np.pi * np.concatenate([f, flexible])
    zeta = np.concatenate([rng.uniform(0.01, 0.03, 6), np.full(3, 0.01)])
    mass = np.concatenate([np.full(3, MASS_KG), INERTIA])
    # Suspension modes are rigid motions turned into one another; each flexible one is seen by all.
    turn = np.linalg.qr(np.eye(6) + 0.15 * rng.standard_normal((6, 6)))[0]
    motion = (1 / np.sqrt(mass))[:, None] * turn
    see = np.hstack([shapes @ motion, 0.03 * rng.standard_normal((sensors, 3))])
    drive = np.vstack([motion.T @ push.T, 0.02 * rng.standard_normal((3, 4))]) * 30.0  # newtons a volt
    return _discrete(w, zeta, see, drive), p, d


def _discrete(w, zeta, see, drive):
    """Modes from force to acceleration between amplifiers (one pole at 400 Hz) and accelerometers (1500 Hz), held."""
    m, (ny, nu) = w.size, (see.shape[0], drive.shape[1])
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-np.diag(w**2), -np.diag(2 * zeta * w)]])
    B, C = np.vstack([np.zeros((m, nu)), drive]), see @ A[m:]
    D, amplifier, sensor = see @ drive, 2 * np.pi * 400.0, 2 * np.pi * 1500.0
    n = 2 * m
    F = np.zeros((n + nu + ny, n + nu + ny))
    F[:n, :n], F[:n, n : n + nu] = A, B
    F[n : n + nu, n : n + nu] = -amplifier * np.eye(nu)
    F[n + nu :, :n], F[n + nu :, n : n + nu] = sensor * C, sensor * D
    F[n + nu :, n + nu :] = -sensor * np.eye(ny)
    G = np.zeros((n + nu + ny, nu))
    G[n : n + nu] = amplifier * np.eye(nu)
    held = expm(np.block([[F, G], [np.zeros((nu, F.shape[0] + nu))]]) / RATE_HZ)
    H = np.hstack([np.zeros((ny, n + nu)), np.eye(ny)])
    states = F.shape[0]
    return StateSpace(held[:states, :states], held[:states, states:], H, np.zeros((ny, nu)), RATE_HZ)


def wires(sensors=20):
    """Channels of the bench."""
    return [Channel(f"leg {k + 1}", "V", -10.0, 10.0) for k in range(4)], [
        Channel(f"acc {k + 1}", "m/s^2", -50.0, 50.0) for k in range(sensors)
    ]


def drawn_bench(truth, seed, dead=None):
    """The table as a Python function, with noise; the dead sensor gives noise alone."""
    rng, x = np.random.default_rng(seed), np.zeros(truth.states)
    A, B, C = truth.A, truth.B, truth.C

    def reset():
        x[:] = 0.0

    def step(u, d):
        y = C @ x + NOISE * rng.standard_normal(len(C))
        x[:] = A @ x + B @ (u + d)
        if dead is not None:
            y[dead] = 5 * NOISE * rng.standard_normal()
        return y

    return Wrapped(step, reset, RATE_HZ, *wires(len(C)))


def matrices(p, d):
    """Ts of all six rigid modes, Ta of the four that the legs drive; volts per newton or newton metre left at one."""
    return sensor_matrix(rigid_body(p, d)), actuator_matrix(rigid_body(*legs())[:, DRIVEN])


def delayed(truth):
    """The truth behind the bench's one sample of delay."""
    nu = truth.D.shape[1]
    A = np.block([[truth.A, truth.B], [np.zeros((nu, truth.states + nu))]])
    B = np.vstack([np.zeros_like(truth.B), np.eye(nu)])
    return StateSpace(A, B, np.hstack([truth.C, truth.D]), np.zeros_like(truth.D), RATE_HZ)
