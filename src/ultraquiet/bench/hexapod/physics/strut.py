"""The paper's electromechanical strut, eqs. (5)-(9), in the paper's symbols."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive


@dataclass(frozen=True)
class Stack:
    """A piezo stack with its Maxwell resistor-capacitor circuit.

    Args:
        m_p: mass in kg.
        b_p: damping in N s/m.
        k_p: stiffness in N/m.
        n: electromechanical transformer ratio in C/m.
        C: capacitance in parallel with the transformer in F.
        C_M, R_M: capacitance in F and resistance in ohm of the Maxwell circuit.
    """

    m_p: float
    b_p: float
    k_p: float
    n: float
    C: float
    C_M: float
    R_M: float

    def __post_init__(self) -> None:
        for name in ("m_p", "b_p", "k_p", "n", "C", "C_M", "R_M"):
            positive("Stack", name, getattr(self, name))

    def displacement(self) -> tuple[FloatArray, FloatArray]:
        """Return X / V_in of eq. (9) as polynomials in s, highest power first.

        X / V_in = (n / C) / [(m_p s^2 + b_p s + k_p)(1/C + 1/C_M + R_M s) + (n^2 / C)(1/C_M + R_M s)]

        The circuit is linear and its phase depends on frequency. The paper calls it rate-independent; a
        rate-independent hysteresis needs elements that slip, see Goldfarb and Celanovic, IEEE Control Systems 17 (1997)
        69-79, doi:10.1109/37.588158.

        >>> num, den = Stack(0.062, 11.7, 5.5e6, 8.0, 1.8e-6, 6e-6, 100.0).displacement()
        >>> len(den) - 1
        3
        """
        mechanics = np.array([self.m_p, self.b_p, self.k_p])
        circuit = np.array([self.R_M, 1.0 / self.C_M])
        den = np.polymul(mechanics, np.polyadd(circuit, [1.0 / self.C]))
        return np.array([self.n / self.C]), np.asarray(np.polyadd(den, self.n**2 / self.C * circuit), float)
