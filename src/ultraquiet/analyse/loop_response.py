"""A closed loop's response at single frequencies, also at those where the plant or the controller has a pole."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.peaks import response_at
from ultraquiet.values.interconnect import lft
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
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        G, K = (np.moveaxis(response_at(system)(f_hz), 2, 0) for system in (plant, controller))
        L = G @ K
        lost = ~(np.abs(L).max(axis=(1, 2), initial=0.0) < LOST)
    L[lost] = 0.0
    S = np.asarray(np.linalg.inv(np.eye(L.shape[1]) - L), dtype=np.complex128)
    with np.errstate(invalid="ignore"):
        KS = K @ S
    if lost.any():
        closed = np.moveaxis(closed_system(plant, controller).frequency_response(f_hz[lost]), 2, 0)
        S[lost], KS[lost] = np.split(closed, [L.shape[1]], axis=1)
    return S, np.asarray(KS, dtype=np.complex128)


def closed_system(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return [S; K S], from a disturbance at the plant's output: `ny + nu` outputs, `ny` inputs."""
    ny, nu = plant.D.shape
    B = np.hstack([np.zeros((plant.states, ny)), plant.B])
    C = np.vstack([plant.C, np.zeros((nu, plant.states)), plant.C])
    D = np.block([[np.eye(ny), plant.D], [np.zeros((nu, ny)), np.eye(nu)], [np.eye(ny), plant.D]])
    return lft(StateSpace(plant.A, B, C, D, plant.rate_hz), controller, measurements=ny, controls=nu)
