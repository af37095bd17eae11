"""Margins of all loops at once: the structured singular value, bounded from above by diagonal scaling."""

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, one_of
from ultraquiet.analyse.margins import default_grid
from ultraquiet.values.interconnect import append, gain, sensitivity
from ultraquiet.values.state_space import StateSpace

SWEEPS = 60  # of the balancing that starts the search
DESCENTS = 200
SETTLED = 1e-7  # relative gain of a descent below which the scaling stands


def mu_upper_bound(M: ComplexArray) -> FloatArray:
    """Return the smallest scaled norm inf over diagonal D > 0 of the largest singular value of D M D^-1, per frequency.

    Args:
        M: square response `(n, n, nf)`.

    Returns:
        `(nf,)`, never below the structured singular value for n independent complex perturbations, and equal to it for
        n up to 3. Its inverse is the size of perturbation, one on each channel, that the loop is sure to stand.

    >>> float(mu_upper_bound(np.array([[[0.0], [10.0]], [[0.1], [0.0]]], dtype=complex))[0].round(6))
    1.0

    Packard and Doyle 1993, doi:10.1016/0005-1098(93)90175-S.
    """
    return np.array([_bound(M[:, :, k]) for k in range(M.shape[2])])


def disk_margin(
    plant: StateSpace, controller: StateSpace, side: str = "output", f_hz: ArrayLike | None = None
) -> float:
    """Return alpha, the symmetric disk of gain and phase changes that all loops stand at the same time.

    alpha = 1 / max over f of mu(S - I / 2), each channel multiplied by its own (1 + d / 2) / (1 - d / 2), |d| < alpha.

    Args:
        plant: G.
        controller: K, u = K y.
        side: `output`, `input`, or `both` for perturbations at sensors and actuators together.
        f_hz: grid, Hz; log-spaced up to Nyquist when absent.

    Returns:
        alpha between 0 and 2 (0 for an unstable loop). Every channel's gain may vary by the factor
        (1 + alpha / 2) / (1 - alpha / 2) either way, or its phase by 2 atan(alpha / 2), all of them independently.

    >>> G = StateSpace([[0.0, 10.0], [-10.0, 0.0]], np.eye(2), [[1.0, 10.0], [-10.0, 1.0]], np.zeros((2, 2)))
    >>> round(disk_margin(G, gain(-np.eye(2))), 3)
    0.1

    Seiler, Packard and Gahinet 2020, doi:10.1109/MCS.2020.3005277.
    """
    one_of("disk_margin", "side", side, ("output", "input", "both"))
    if side == "both":
        S = _both_sides(plant, controller)
    else:
        S = sensitivity(plant, controller) if side == "output" else sensitivity(controller, plant)
    if not S.is_stable():
        return 0.0
    f = default_grid(S) if f_hz is None else frequency_array("disk_margin", f_hz)
    response = S.frequency_response(f) - 0.5 * np.eye(S.D.shape[0])[:, :, None]
    # only the frequencies that can matter: the unscaled norm is above every scaled one
    norms = np.linalg.norm(np.moveaxis(response, 2, 0), 2, axis=(1, 2))
    worst = 0.0
    for k in np.argsort(-norms):
        if norms[k] <= worst:
            break
        worst = max(worst, _bound(response[:, :, k]))
    return 1.0 / worst


def _both_sides(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return (I - L)^-1 for L = [0 G; K 0], the loop seen from outputs and inputs together."""
    ny, nu = plant.D.shape
    swap = np.block([[np.zeros((ny, nu)), np.eye(ny)], [np.eye(nu), np.zeros((nu, ny))]])
    loop = append(controller, plant)  # inputs (y, u), outputs (u, y)
    L = StateSpace(loop.A, loop.B, swap @ loop.C, swap @ loop.D, loop.rate_hz)
    return sensitivity(L, gain(np.eye(ny + nu), plant.rate_hz))


def _bound(M: ComplexArray) -> float:
    """Balance rows against columns, then descend on the logarithms of D along the gradient of the singular value."""
    x = _balanced(np.abs(M))
    best, gradient = _value(M, x)
    step = 0.5
    for _ in range(DESCENTS):
        trial = x - step * gradient
        value, slope = _value(M, trial)
        if value < best * (1 - SETTLED * step):
            x, best, gradient, step = trial, value, slope, min(1.5 * step, 4.0)
        else:
            step *= 0.5
            if step < SETTLED:
                break
    return best


def _value(M: ComplexArray, x: FloatArray) -> tuple[float, FloatArray]:
    """Return the largest singular value of D M D^-1, D = diag(exp x), and the gradient of its logarithm."""
    d = np.exp(x)
    U, s, Vh = np.linalg.svd(d[:, None] * M / d[None, :])
    return float(s[0]), np.abs(U[:, 0]) ** 2 - np.abs(Vh[0]) ** 2


def _balanced(A: FloatArray) -> FloatArray:
    """Return log D by Osborne's iteration, which makes off-diagonal rows and columns equally long."""
    A, x = A - np.diag(np.diag(A)), np.zeros(A.shape[0])
    for _ in range(SWEEPS):
        rows, columns = np.linalg.norm(A, axis=1), np.linalg.norm(A, axis=0)
        safe = (rows > 0) & (columns > 0)
        change = np.zeros_like(x)
        change[safe] = 0.25 * np.log(columns[safe] / rows[safe])
        x = x + change
        A = A * np.exp(change)[:, None] / np.exp(change)[None, :]
        if np.abs(change).max(initial=0.0) < SETTLED:
            break
    return x
