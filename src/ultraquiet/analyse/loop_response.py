"""A closed loop's response at single frequencies, also at those where the plant or the controller has a pole."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.peaks import response_at
from ultraquiet.values.interconnect import lft, sensitivity
from ultraquiet.values.state_space import StateSpace

# Size of an entry of G K above which I - G K has lost half of its digits: of rank one, it would be singular at twice.
LOST = 1e8


def loop_response(plant: StateSpace, controller: StateSpace, f_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return S = (I - G K)^-1 and K S at each line.

    A line on a pole of G or K, as 0 Hz of an integrator, has a loop without bound, and yet S is as ordinary there as
    anywhere: it is taken from the closed loop's own matrices.

    Args:
        plant: G.
        controller: K, its sign inside.
        f_hz: `(nf,)`, Hz.

    Returns:
        `(nf, ny, ny)` and `(nf, nu, ny)`.

    >>> from ultraquiet.values.interconnect import gain
    >>> integrator = StateSpace([[1.0]], [[0.1]], [[1.0]], [[0.0]], rate_hz=10.0)
    >>> S, KS = loop_response(integrator, gain([[-1.0]], 10.0), np.array([0.0, 5.0]))
    >>> np.round(np.abs(np.ravel([S, KS])), 3).tolist()
    [0.0, 1.053, 0.0, 1.053]
    """
    G, K = _responses(plant, controller)(f_hz)
    S, lost = _inverted(G, K)
    with np.errstate(invalid="ignore"):
        KS = K @ S
    if lost.any():
        closed = np.moveaxis(closed_system(plant, controller).frequency_response(f_hz[lost]), 2, 0)
        S[lost], KS[lost] = np.split(closed, [S.shape[1]], axis=1)
    return S, np.asarray(KS, dtype=np.complex128)


def both_sensitivities(
    plant: StateSpace, controller: StateSpace
) -> Callable[[FloatArray], tuple[ComplexArray, ComplexArray]]:
    """Return what gives (I - K G)^-1 and (I - G K)^-1 at lines in Hz, `(nf, nu, nu)` and `(nf, ny, ny)`.

    As `loop_response` does; to be asked as often as wanted.
    """
    at = _responses(plant, controller)

    def both(f_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        G, K = at(f_hz)
        return _sensitivity(controller, plant, f_hz, K, G), _sensitivity(plant, controller, f_hz, G, K)

    return both


def _responses(plant: StateSpace, controller: StateSpace) -> Callable[[FloatArray], tuple[ComplexArray, ComplexArray]]:
    """Return what gives G and K at lines, `(nf, ny, nu)` and `(nf, nu, ny)`."""
    of_plant, of_law = response_at(plant), response_at(controller)

    def at(f_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.moveaxis(of_plant(f_hz), 2, 0), np.moveaxis(of_law(f_hz), 2, 0)

    return at


def _inverted(G: ComplexArray, K: ComplexArray) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Return (I - G K)^-1 at each line, and the lines at which it is lost."""
    with np.errstate(invalid="ignore", over="ignore"):
        L = G @ K
        lost = ~(np.abs(L).max(axis=(1, 2), initial=0.0) < LOST)
    L[lost] = 0.0
    return np.asarray(np.linalg.inv(np.eye(L.shape[1]) - L), dtype=np.complex128), lost


def _sensitivity(
    first: StateSpace, second: StateSpace, f_hz: FloatArray, G: ComplexArray, K: ComplexArray
) -> ComplexArray:
    S, lost = _inverted(G, K)
    if lost.any():
        S[lost] = np.moveaxis(sensitivity(first, second).frequency_response(f_hz[lost]), 2, 0)
    return S


def closed_system(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return [S; K S], from a disturbance at the plant's output: `ny + nu` outputs, `ny` inputs."""
    ny, nu = plant.D.shape
    B = np.hstack([np.zeros((plant.states, ny)), plant.B])
    C = np.vstack([plant.C, np.zeros((nu, plant.states)), plant.C])
    D = np.block([[np.eye(ny), plant.D], [np.zeros((nu, ny)), np.eye(nu)], [np.eye(ny), plant.D]])
    return lft(StateSpace(plant.A, B, C, D, plant.rate_hz), controller, measurements=ny, controls=nu)
