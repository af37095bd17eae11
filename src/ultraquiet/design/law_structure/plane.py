"""The plane in which controllers are tuned: bilinear for discrete time, scaled for continuous time, poles near one."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg.discretize import bilinear_to_continuous, bilinear_to_discrete
from ultraquiet.linalg.even import evened
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace

AT_REST = 1e-7  # poles slower than this, relatively, are integrators
SAME = 1e-9  # points nearer than this, relatively, are one


@dataclass(frozen=True, eq=False)
class Plane:
    """The bilinear plane of discrete time (s = (z - 1) / (z + 1)), or continuous time in units of 1 / speed."""

    rate_hz: float | None
    speed: float = 1.0

    def to_plane(self, G: StateSpace) -> Matrices:
        """Return the matrices of a system in the plane."""
        if self.rate_hz is not None:
            return bilinear_to_continuous(G.A, G.B, G.C, G.D)
        root = np.sqrt(self.speed)
        return G.A / self.speed, G.B / root, G.C / root, G.D

    def from_plane(self, M: Matrices) -> StateSpace:
        """Return the system that has these matrices in the plane."""
        if self.rate_hz is not None:
            return StateSpace(*bilinear_to_discrete(*M), rate_hz=self.rate_hz)
        root = np.sqrt(self.speed)
        return StateSpace(M[0] * self.speed, M[1] * root, M[2] * root, M[3])

    def of_hz(self, f_hz: FloatArray | float) -> FloatArray:
        """Return the place of frequencies in Hz on the imaginary axis."""
        f = np.asarray(f_hz, dtype=np.float64)
        if self.rate_hz is None:
            return 2 * np.pi * f / self.speed
        return np.tan(np.pi * np.minimum(f / self.rate_hz, 0.5 - SAME))

    def hz(self, w: FloatArray) -> FloatArray:
        """Return frequencies in Hz."""
        return w * self.speed / (2 * np.pi) if self.rate_hz is None else self.rate_hz / np.pi * np.arctan(w)


def plane_of(P: StateSpace) -> Plane:
    """Return the plane in which the poles of a system are near one."""
    size = np.abs(P.poles())
    size = size[size > AT_REST * max(float(size.max(initial=0.0)), _speed(P))]
    return Plane(P.rate_hz, float(np.exp(np.mean(np.log(size)))) if P.rate_hz is None and size.size else 1.0)


def _speed(P: StateSpace) -> float:
    """Return how fast a system is by the size of its A: rounding moves a chain of integrators off zero by its root."""
    return float(np.linalg.norm(evened(P.A, P.B, P.C)[0])) if P.states else 0.0
