"""Every loop that a stabilising controller can make with a plant, as a straight line in one stable function Q.

u = K y; S = (I - G K)^-1 = (V + N Q) Mt and K S = (U + M Q) Mt, with the coprime factors G = N M^-1 = Mt^-1 Nt and
Mt V - Nt U = I of an observer and a state feedback (Youla, Jabr and Bongiorno 1976, doi:10.1109/TAC.1976.1101223; Zhou,
Doyle and Glover 1996, theorem 12.8). For a stable plant both gains are zero: S = I + G Q, K S = Q.
"""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg import equations
from ultraquiet.linalg.response import frequency_response, points
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class AffineLoops:
    """S = a + b Q and K S = c + d Q at some frequencies, `(nf,)` each, for a scalar loop."""

    a: ComplexArray
    b: ComplexArray
    c: ComplexArray
    d: ComplexArray


@dataclass(frozen=True, eq=False)
class Loops:
    """The stabilising controllers of a scalar plant: state feedback F and observer gain H, zero for a stable one."""

    plant: StateSpace
    F: FloatArray
    H: FloatArray

    def at(self, f_hz: FloatArray) -> AffineLoops:
        """Return S and K S as lines in Q."""
        G, F, H = self.plant, self.F, self.H
        one = np.ones(f_hz.size, dtype=np.complex128)
        if not (F.any() or H.any()):
            return AffineLoops(one, G.frequency_response(f_hz)[0, 0], 0 * one, one)
        z = points(f_hz, G.rate_hz)
        left = np.vstack([F, G.C + G.D @ F])
        direct = np.array([[1.0, 0.0], [G.D[0, 0], 1.0]])
        right = frequency_response(G.A + G.B @ F, np.hstack([G.B, -H]), left, direct, z)
        dual = frequency_response(G.A + H @ G.C, H, G.C, np.ones((1, 1)), z)[0, 0]
        (M, U), (N, V) = right
        return AffineLoops(V * dual, N * dual, U * dual, M * dual)

    def controller(self, Q: StateSpace) -> StateSpace:
        """Return the controller u = K y of a stable Q."""
        G, F, H = self.plant, self.F, self.H
        A = G.A + G.B @ F + H @ (G.C + G.D @ F)
        D = np.block([[np.zeros((1, 1)), np.ones((1, 1))], [np.ones((1, 1)), -G.D]])
        J = StateSpace(A, np.hstack([-H, G.B + H @ G.D]), np.vstack([F, -G.C - G.D @ F]), D, G.rate_hz)
        return lft(J, Q)


def stabilised(plant: StateSpace) -> Loops:
    """Return the loops of a scalar plant.

    Raises:
        NumericalError: an unstable mode cannot be moved.
    """
    n = plant.states
    if plant.is_stable():
        return Loops(plant, np.zeros((1, n)), np.zeros((n, 1)))
    try:
        F = _feedback(plant.A, plant.B, plant.C, plant.rate_hz)
        H = _feedback(plant.A.T, plant.C.T, plant.B.T, plant.rate_hz).T
    except NumericalError as error:
        raise NumericalError(f"the plant cannot be stabilised ({error})") from None
    return Loops(plant, F, H)


def _feedback(A: FloatArray, B: FloatArray, C: FloatArray, rate_hz: float | None) -> FloatArray:
    """Return F with A + B F stable, from the regulator that weighs the output as much as the input."""
    b, c = B / (np.linalg.norm(B) or 1.0), C / (np.linalg.norm(C) or 1.0)
    if rate_hz is None:
        F = -b.T @ equations.continuous_riccati(A, b @ b.T, c.T @ c).X
    else:
        R = np.eye(B.shape[1])
        X = equations.discrete_riccati(A, b, c.T @ c, R).X
        F = -equations.discrete_gain(A, b, R, np.zeros_like(b), X)
    return F / (np.linalg.norm(B) or 1.0)
