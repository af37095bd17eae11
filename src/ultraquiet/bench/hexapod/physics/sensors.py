"""The paper's geophone, eqs. (2)-(4), and the strut from stack to geophone, eq. (10), in the paper's symbols."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet.bench.hexapod.physics.strut import Stack


@dataclass(frozen=True)
class Geophone:
    """A coil of mass m_g (kg) on a spring k_g (N/m) with damping b_g (N s/m) that moves past a magnet.

    Eq. (2): m_g z'' + b_g z' + k_g z = -m_g x''; eq. (3): V_out = K z', K in V/(m/s).
    """

    m_g: float
    b_g: float
    k_g: float
    K: float

    def __post_init__(self) -> None:
        for name in ("m_g", "b_g", "k_g", "K"):
            positive("Geophone", name, getattr(self, name))

    @classmethod
    def at(cls, suspension_hz: float, damping: float, v_per_m_s: float, m_g: float = 0.01) -> "Geophone":
        """Return the geophone with a given suspension frequency, fraction of critical damping and sensitivity.

        Its response does not depend on m_g, a free scale.

        >>> round(Geophone.at(12.0, 0.65, 100.0).k_g, 3)
        56.849
        """
        w = 2.0 * np.pi * positive("Geophone.at", "suspension_hz", suspension_hz, "Hz")
        return cls(m_g, 2.0 * damping * w * m_g, w**2 * m_g, v_per_m_s)

    def voltage(self) -> tuple[FloatArray, FloatArray]:
        """Return V_out / X of eq. (4), -m_g K s^3 / (m_g s^2 + b_g s + k_g), as polynomials in s, highest power first.

        Above its suspension frequency it reads velocity, below it jerk.
        """
        return np.array([-self.m_g * self.K, 0.0, 0.0, 0.0]), np.array([self.m_g, self.b_g, self.k_g])


def strut_voltage(stack: Stack, geophone: Geophone) -> tuple[FloatArray, FloatArray]:
    """Return V_out / V_in of eq. (10), eq. (4) times eq. (9), as polynomials in s: order five, three zeros at s = 0.

    >>> stack = Stack(0.062, 11.7, 5.5e6, 8.0, 1.8e-6, 6e-6, 100.0)
    >>> num, den = strut_voltage(stack, Geophone.at(12.0, 0.65, 100.0))
    >>> len(den) - 1, int(np.count_nonzero(np.roots(num) == 0))
    (5, 3)
    """
    (b_g, a_g), (b_p, a_p) = geophone.voltage(), stack.displacement()
    return np.asarray(np.polymul(b_g, b_p), float), np.asarray(np.polymul(a_g, a_p), float)
