"""A generalised plant in units of its own: what is asked of it does not depend on those it was written in."""

from typing import NamedTuple

import numpy as np

from ultraquiet.design.hinf.riccati import speed
from ultraquiet.linalg.even import even_states, to_unit_size
from ultraquiet.linalg.ordered import Array
from ultraquiet.values.state_space import StateSpace

ROUNDS = 20  # states, controls, measurements and the level depend on each other; they stand still after two to six


class EvenProblem(NamedTuple):
    """A generalised plant with its states, controls, measurements and level scaled by powers of two.

    `u = controls * u_even`, `y_even = measurements * y`, `gamma_even = level * gamma`.
    """

    plant: StateSpace
    controls: Array
    measurements: Array
    level: float

    def law(self, even: StateSpace) -> StateSpace:
        """Return the controller of the plant as it was given from one of the even plant."""
        return StateSpace(
            even.A,
            even.B * self.measurements,
            even.C * self.controls[:, None],
            even.D * self.measurements * self.controls[:, None],
            even.rate_hz,
        )

    def even_law(self, K: StateSpace) -> StateSpace:
        """Return the controller as it meets the even plant."""
        return EvenProblem(self.plant, 1 / self.controls, 1 / self.measurements, 1 / self.level).law(K)


def even_problem(P: StateSpace, ny: int, nu: int) -> EvenProblem:
    """Return the problem in even units: rows of [A B] as large as columns of [A; C], every control and measurement one.

    The disturbance is scaled as a whole such that P11 is to P12 as P21 to P22; the norm sought scales with it. Sizes
    of A, B and D are compared in the problem's own unit of time; the plant returned is in the one it was given in.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y).
        ny: number of last outputs y.
        nu: number of last inputs u.
    """
    p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
    x, u, y, level = np.ones(P.states), np.ones(nu), np.ones(ny), 1.0
    A, B, C, D = P.A, P.B, P.C, P.D
    root = 1.0 if P.rate_hz is not None else float(np.exp2(np.round(np.log2(speed((A, B, C, D), ny, nu)) / 2)))
    A, B, C = A / root**2, B / root, C / root
    for _ in range(ROUNDS):
        A, B, C, d = even_states(A, B, C)
        across = to_unit_size(np.hypot(np.linalg.norm(B[:, m:], axis=0), np.linalg.norm(D[:p, m:], axis=0)))
        down = to_unit_size(np.hypot(np.linalg.norm(C[p:], axis=1), np.linalg.norm(D[p:, :m], axis=1)))
        loud = _ratio(B[:, m:] * across, B[:, :m]) * _ratio(C[p:] * down[:, None], C[:p])
        s = float(np.exp2(np.round(np.log2(loud) / 2)))
        inputs, outputs = np.concatenate([np.full(m, s), across]), np.concatenate([np.ones(p), down])
        B, C, D = B * inputs, C * outputs[:, None], D * inputs * outputs[:, None]
        x, u, y, level = x * d, u * across, y * down, level * s
        if s == 1 and np.all(d == 1) and np.all(across == 1) and np.all(down == 1):
            break
    return EvenProblem(StateSpace(A * root**2, B * root, C * root, D, P.rate_hz), u, y, level)


def _ratio(over: Array, under: Array) -> float:
    a, b = float(np.linalg.norm(over)), float(np.linalg.norm(under))
    return a / b if a > 0 and b > 0 else 1.0
