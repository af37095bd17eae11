"""Named problems with known answers, small enough for every test run."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray
from ultraquiet.linalg import realize
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values import Record, StateSpace

RATE_HZ = 1000.0
# Size of states that hardly matter, as a share of the gain of the law that carries them.
FAINT = 1e-5


def two_modes(seed: int, samples: int = 3000, noise: float = 0.01) -> tuple[Record, StateSpace]:
    """Return a record of white excitation on a plant with modes at 20 and 70 Hz, and the plant."""
    rng = np.random.default_rng(seed)
    plant = _modal(rng, [20.0, 70.0], [0.05, 0.03], inputs=1, outputs=1)
    u = rng.standard_normal((1, samples))
    y = plant.simulate(u)
    return Record(u, y + noise * y.std() * rng.standard_normal(y.shape), RATE_HZ), plant


def damped_plant(seed: int, channels: int = 2) -> StateSpace:
    """Return a square plant with collocated, damped modes between 15 and 120 Hz and one sample of delay."""
    rng = np.random.default_rng(seed)
    return _modal(rng, [15.0, 40.0, 120.0], [0.1, 0.08, 0.05], channels, channels)


def observer_law(plant: StateSpace) -> StateSpace:
    """Return a mild observer-based law u = K y of the plant's order, from two textbook Riccati equations."""
    from scipy.linalg import solve_discrete_are

    A, B, C = plant.A, plant.B, plant.C
    n, nu, ny = plant.states, B.shape[1], C.shape[0]
    X = solve_discrete_are(A, B, C.T @ C, 10.0 * np.eye(nu))
    Y = solve_discrete_are(A.T, C.T, B @ B.T, 10.0 * np.eye(ny))
    F = np.linalg.solve(10.0 * np.eye(nu) + B.T @ X @ B, B.T @ X @ A)
    L = np.linalg.solve(10.0 * np.eye(ny) + C @ Y @ C.T, C @ Y @ A.T).T
    return StateSpace(A - B @ F - L @ C, L, -F, np.zeros((nu, ny)), plant.rate_hz) if n else plant


def with_faint_states(law: StateSpace) -> StateSpace:
    """Return the law with two quick states in front that hardly matter: whoever keeps the first states keeps these."""
    n, nu, ny = law.states, law.C.shape[0], law.B.shape[1]
    size = np.sqrt(FAINT * distance(law))
    A = np.block([[np.diag([0.5, 0.3]), np.zeros((2, n))], [np.zeros((n, 2)), law.A]])
    B = np.vstack([size * np.eye(2, ny), law.B])
    C = np.hstack([size * np.eye(nu, 2), law.C])
    return StateSpace(A, B, C, law.D, law.rate_hz)


def distance(first: StateSpace, second: StateSpace | None = None) -> float:
    """Return the largest singular value of the difference (of `first` itself when alone) over a grid of frequencies."""
    f_hz = np.linspace(0.0, RATE_HZ / 2, 1001)
    gap = first.frequency_response(f_hz) - (0.0 if second is None else second.frequency_response(f_hz))
    return float(principal_gains(gap).max())


def loop_poles(plant: StateSpace, law: StateSpace) -> ComplexArray:
    """Return the poles of the loop that u = K y closes round the plant; both may have a direct part."""
    nu, ny = plant.B.shape[1], plant.C.shape[0]
    inner = np.linalg.inv(np.block([[np.eye(nu), -law.D], [-plant.D, np.eye(ny)]]))
    outer = np.block([[np.zeros((nu, plant.states)), law.C], [plant.C, np.zeros((ny, law.states))]])
    drive = np.block(
        [[plant.B, np.zeros((plant.states, ny))], [np.zeros((law.states, nu)), law.B]],
    )
    diagonal = np.block(
        [[plant.A, np.zeros((plant.states, law.states))], [np.zeros((law.states, plant.states)), law.A]]
    )
    return np.linalg.eigvals(diagonal + drive @ inner @ outer).astype(np.complex128)


def _modal(rng: np.random.Generator, f_hz: list[float], zeta: list[float], inputs: int, outputs: int) -> StateSpace:
    """Return modes with random shapes (collocated where square), unit peak-to-peak scale, one sample of delay."""
    n = 2 * len(f_hz)
    A, B, C = np.zeros((n, n)), np.zeros((n, inputs)), np.zeros((outputs, n))
    for k, (f, z) in enumerate(zip(f_hz, zeta, strict=True)):
        pole = np.exp(2 * np.pi * f / RATE_HZ * (-z + 1j * np.sqrt(1 - z * z)))
        a = np.asarray(np.poly([pole, pole.conjugate()]).real, dtype=np.float64)
        block, b, c, _ = realize.sections(np.array([0.0, 1.0, -1.0]), a)  # a velocity: zero at z = 1
        rows = slice(2 * k, 2 * k + 2)
        shape = rng.uniform(0.5, 1.5, max(inputs, outputs)) * rng.choice([-1.0, 1.0], max(inputs, outputs))
        A[rows, rows], B[rows], C[:, rows] = block, b @ shape[None, :inputs], shape[:outputs, None] @ c
    return StateSpace(A, B, C, np.zeros((outputs, inputs)), RATE_HZ)
