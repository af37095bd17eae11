"""The unit disc on which limits are computed: frequency warped so that the band takes a good share of the circle.

s = 2 rate (z - 1) / (z + 1) takes discrete time to a half-plane, w = (k + s) / (k - s) takes the half-plane back to a
disc in which the frequency k lies at a right angle. Both keep stability, gains and state counts: what is best there is
best in the plant's own time, and 5 Hz at 3.5 kHz is no longer a speck beside w = 1.
"""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.limits.half_plane import speeds
from ultraquiet.linalg import discretize
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace

# The angle that stands for pi, which is infinity in the half-plane: 10^6 times the frequency in the middle.
LAST = np.pi - 2e-6


@dataclass(frozen=True)
class Circle:
    """The warped circle of one time axis: `centre_hz` lies at a right angle, Nyquist (or infinity) at -1."""

    rate_hz: float | None
    centre_hz: float

    @property
    def speed(self) -> float:
        """The constant k in rad/s of the half-plane."""
        return float(speeds(np.array([self.centre_hz]), self.rate_hz)[0])

    def angles(self, f_hz: FloatArray) -> FloatArray:
        """Return the angles of frequencies, 0 to pi."""
        return 2 * np.arctan(speeds(f_hz, self.rate_hz) / self.speed)

    def frequencies(self, angles: FloatArray) -> FloatArray:
        """Return the frequencies in Hz of angles from 0 to pi."""
        w = self.speed * np.tan(np.minimum(angles, LAST) / 2)
        if self.rate_hz is None:
            return w / (2 * np.pi)
        f = np.arctan(w / (2 * self.rate_hz)) * self.rate_hz / np.pi
        return np.where(angles >= LAST, self.rate_hz / 2, f)

    def roots(self, s: ComplexArray) -> ComplexArray:
        """Return where points of the half-plane (rad/s) lie in the disc."""
        return (self.speed + s) / (self.speed - s)

    def unwarped(self, M: Matrices) -> StateSpace:
        """Return the system in the plant's own time of matrices on the warped circle."""
        A, B, C, D = discretize.bilinear_to_continuous(*M)
        scale = self.speed / (1.0 if self.rate_hz is None else 2 * self.rate_hz)
        A, B, C = A * scale, B * np.sqrt(scale), C * np.sqrt(scale)
        if self.rate_hz is not None:
            A, B, C, D = discretize.bilinear_to_discrete(A, B, C, D)
        return StateSpace(A, B, C, D, rate_hz=self.rate_hz)
