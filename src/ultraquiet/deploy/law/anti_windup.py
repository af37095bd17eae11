"""Conditioned anti-windup: the correction that tells the state what the actuators really did."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ultraquiet._base.constraints import FloatArray, real_array
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.deploy.law.law import loop_coupling
from ultraquiet.linalg.equations import discrete_gain, discrete_riccati
from ultraquiet.values.state_space import StateSpace

# A state slower than the band of isolation (5 Hz and up) remembers a limit long after the disturbance has left it.
SLOW_HZ = 1.0

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
    if not C.any() or not (B.any() or D.any()):
        return np.zeros((A.shape[0], C.shape[0]))  # nothing that a limit takes away reaches a state by the commands
    # In units of its own, powers of two: what the sensors count in must not decide whether there is a gain.
    y_unit, u_unit = _unit(B), _unit(C)
    return _gain(A, B / y_unit, C / u_unit, D / (y_unit * u_unit)) / u_unit


def _unit(matrix: FloatArray) -> float:
    largest = float(np.abs(matrix).max(initial=0.0))
    return float(2.0 ** np.round(np.log2(largest))) if largest > 0 else 1.0


def _gain(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> FloatArray:
    nu = C.shape[0]
    floor = FLOOR * max(float(np.trace(D @ D.T)), float(np.trace(C @ B @ B.T @ C.T)), np.finfo(float).tiny) / nu
    R = D @ D.T + floor * np.eye(nu)
    try:
        P = discrete_riccati(A.T, C.T, B @ B.T, R, B @ D.T).X
    except (np.linalg.LinAlgError, NumericalError) as error:
        raise NumericalError(
            f"deploy: no anti-windup gain exists for this law ({error}); use anti_windup=False."
        ) from None
    return discrete_gain(A.T, C.T, R, B @ D.T, P).T


@dataclass(frozen=True)
class AntiWindupDecision:
    """Whether to correct the state by what the limits took away, and the sentence that says why."""

    on: bool
    why: str


def decide_anti_windup(
    setting: bool | str,
    controller: StateSpace,
    limits: FloatArray,
    plant: StateSpace | None = None,
    disturbance_v: ArrayLike | None = None,
) -> AntiWindupDecision:
    """Return whether a law wants anti-windup; `auto` decides by the law's poles and by the commands it would give.

    `auto` says yes when a pole is unstable or slower than 1 Hz, or when the command meets a limit under the design
    disturbance: u = K (I - G K)^-1 d with a plant, u = K d without.

    Args:
        setting: True, False or `auto`.
        controller: K, discrete.
        limits: `(nu, 2)`, low and high, in the commands' units.
        plant: G of y = G u + d.
        disturbance_v: d, what the sensors show without control, `(ny, n)` in their units at the law's rate.

    Raises:
        InputError: a disturbance of another number of channels, a plant that closes no loop with the law.
    """
    if isinstance(setting, bool):
        return AntiWindupDecision(setting, "asked for" if setting else "not asked for")
    rate_hz = float(controller.rate_hz or 0)
    poles = controller.poles()
    size = np.abs(poles)
    if np.any(size >= 1):
        return AntiWindupDecision(True, f"a pole of the law lies at {size.max():.6f}, on or outside the unit circle")
    moving = poles[size > 0]
    slowest = float(np.abs(np.log(moving)).min(initial=np.inf)) * rate_hz / (2 * np.pi)
    if slowest < SLOW_HZ:
        return AntiWindupDecision(True, f"a pole of the law at {slowest:.2g} Hz is slower than {SLOW_HZ:g} Hz")
    if disturbance_v is None:
        return AntiWindupDecision(
            False, f"no pole is unstable or slower than {SLOW_HZ:g} Hz, and no design disturbance was given"
        )
    u = _commands(controller, plant, disturbance_v)
    low, high = limits.T
    over = (u < low[:, None]) | (u > high[:, None])
    share = float(over.any(axis=0).mean())
    if share > 0:
        return AntiWindupDecision(
            True, f"the design disturbance drives a command to its limit in {100 * share:.2g} % of its samples"
        )
    peaks = np.abs(u).max(axis=1, initial=0.0)
    largest = "no command" if not peaks.size else controller.sensors[int(peaks.argmax())].in_unit(float(peaks.max()), 3)
    return AntiWindupDecision(False, f"under the design disturbance commands peak at {largest}, inside all limits")


def _commands(controller: StateSpace, plant: StateSpace | None, disturbance_v: ArrayLike) -> FloatArray:
    """Return u = K (I - G K)^-1 d, `(nu, n)`."""
    d = real_array("deploy", "disturbance_v", disturbance_v, 2)
    if d.shape[0] != controller.D.shape[1]:
        raise InputError(f"deploy: 'disturbance_v' must have {controller.D.shape[1]} channels, got {d.shape}.")
    if plant is None:
        return controller.simulate(d)
    G, K, coupling = plant, controller, loop_coupling(plant, controller)
    y = coupling @ np.hstack([G.C, G.D @ K.C])
    C = K.D @ y + np.hstack([np.zeros((K.C.shape[0], G.states)), K.C])
    D = K.D @ coupling
    A = np.asarray(block_diag(G.A, K.A)) + np.vstack([G.B @ C, K.B @ y])
    B = np.vstack([G.B @ D, K.B @ coupling])
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop is refused by who judges its rounding
        return StateSpace(A, B, C, D, rate_hz=K.rate_hz).simulate(d)
