"""Conditioned anti-windup: the correction that tells the state what the actuators really did."""

import numpy as np
from scipy.linalg import solve_discrete_are

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import NumericalError

# Variance of the fictitious noise on u, relative to the law's own direct gain or response: -40 dB keeps the Riccati
# equation regular where D is singular and moves the poles of A - L C by less than their own distance to the circle.
FLOOR = 1e-4


def conditioning_gain(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> FloatArray:
    """Return L of x+ = (A - L C) x + (B - L D) y + L sat(u), `(n, nu)`.

    L is the predictor gain of the law driven by white measurements, A P C' + B D' over C P C' + D D' + floor: A - L C
    then has the law's zeros, mirrored into the unit circle where they lie outside, for poles. For D invertible and a
    law of minimum phase this is Hanus' conditioning gain B D^-1, free of its trouble with zeros outside.

    Raises:
        NumericalError: when the law has a mode on the unit circle that u does not show.

    Reference: Hanus, Kinnaert & Henrotte, Automatica 23 (1987), doi:10.1016/0005-1098(87)90029-X.
    """
    nu = C.shape[0]
    floor = FLOOR * max(float(np.trace(D @ D.T)), float(np.trace(C @ B @ B.T @ C.T)), np.finfo(float).tiny) / nu
    R = D @ D.T + floor * np.eye(nu)
    try:
        P = solve_discrete_are(A.T, C.T, B @ B.T, R, s=B @ D.T)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise NumericalError(
            f"deploy: no anti-windup gain exists for this law ({error}); use anti_windup=False."
        ) from None
    return np.linalg.solve((C @ P @ C.T + R).T, (A @ P @ C.T + B @ D.T).T).T
