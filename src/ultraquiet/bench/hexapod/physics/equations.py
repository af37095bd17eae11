"""Eqs. (2), (3) and (5)-(8) of the paper, each as a function in its symbols; (4), (9), (10) are `sensors`, `strut`.

They are plain algebra, so that signals, phasors or single numbers may be put in.
"""

from typing import Any

Value = Any  # a number, a phasor, or an array of either; what comes back is of the same kind


def coil_force(z_ddot: Value, z_dot: Value, z: Value, m_g: float, b_g: float, k_g: float) -> Value:
    """Return the left side of eq. (2) in N: m_g z'' + b_g z' + k_g z, which is -m_g x''.

    Args:
        z_ddot: acceleration of the coil against its magnet in m/s^2.
        z_dot: its speed in m/s.
        z: its way in m.
        m_g: mass of the coil in kg.
        b_g: damping in N s/m.
        k_g: stiffness of its spring in N/m.

    >>> coil_force(2.0, 1.0, 0.5, m_g=0.01, b_g=1.0, k_g=60.0)
    31.02
    """
    return m_g * z_ddot + b_g * z_dot + k_g * z


def coil_voltage(z_dot: Value, K: float) -> Value:
    """Return V_out = K z' of eq. (3) in V: the voltage induced in the coil.

    Args:
        z_dot: speed of the coil against its magnet in m/s.
        K: sensitivity in V s/m.

    >>> coil_voltage(0.02, K=100.0)
    2.0
    """
    return K * z_dot


def input_voltage(V_RC: Value, V_t: Value) -> Value:
    """Return V_in = V_RC + V_t of eq. (5) in V: the Maxwell circuit and the transformer lie in series.

    Args:
        V_RC: voltage over the Maxwell resistor-capacitor circuit in V.
        V_t: voltage over the transformer in V.

    >>> input_voltage(2.0, 23.0)
    25.0
    """
    return V_RC + V_t


def circuit_voltage(q_dot: Value, q: Value, R_M: float, C_M: float) -> Value:
    """Return V_RC = R_M q' + q / C_M in V: what eq. (9) takes for the Maxwell circuit, a resistor and a capacitor.

    It is linear and lags by an angle that depends on frequency; the rate-independent hysteresis that the text ascribes
    to it needs elements that slip, see `hysteresis.Plays`. The paper prints no equation of its own for it.

    Args:
        q_dot: current in A.
        q: charge in C.
        R_M: resistance in ohm.
        C_M: capacitance in F.

    >>> circuit_voltage(0.01, 6e-6, R_M=100.0, C_M=6e-6)
    2.0
    """
    return R_M * q_dot + q / C_M


def charge(x: Value, V_t: Value, n: float, C: float) -> Value:
    """Return q = n x + C V_t of eq. (6) in C: charge of the transformer's and the capacitor's side.

    Args:
        x: displacement of the stack's end in m.
        V_t: voltage over the transformer in V.
        n: electromechanical transformer ratio in C/m.
        C: capacitance in parallel with the transformer in F.

    >>> charge(0.5, 2.0, n=8.0, C=1.0)
    6.0
    """
    return n * x + C * V_t


def stack_force(x_ddot: Value, x_dot: Value, x: Value, m_p: float, b_p: float, k_p: float) -> Value:
    """Return the left side of eq. (7) in N: m_p x'' + b_p x' + k_p x, which is F_t + F_ext.

    Args:
        x_ddot: acceleration of the stack's end in m/s^2.
        x_dot: its speed in m/s.
        x: its displacement in m.
        m_p: mass in kg.
        b_p: damping in N s/m.
        k_p: stiffness in N/m.

    >>> stack_force(0.0, 0.0, 1e-6, m_p=0.06, b_p=12.0, k_p=5e6)
    5.0
    """
    return m_p * x_ddot + b_p * x_dot + k_p * x


def transformer_force(V_t: Value, n: float) -> Value:
    """Return F_t = n V_t of eq. (8) in N.

    Args:
        V_t: voltage over the transformer in V.
        n: electromechanical transformer ratio in N/V, the same as in C/m.

    >>> transformer_force(2.5, n=8.0)
    20.0
    """
    return n * V_t
