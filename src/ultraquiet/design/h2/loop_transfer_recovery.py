"""Loop transfer recovery: how near a loop is to the target it is meant to recover."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.design.h2.riccati import Solution
from ultraquiet.values.interconnect import series
from ultraquiet.values.state_space import StateSpace

POINTS = 200
SPAN = 2500.0  # between the ends of the grid of frequencies, whose upper one is Nyquist


def recovery(
    at: str, plant: StateSpace, loop: StateSpace | None, core: StateSpace, P: StateSpace, solution: Solution
) -> dict[str, FloatArray | str]:
    """Return where the loop was to be recovered and how far it is from its target over frequency.

    At the input: L = K G against F (zI - A)^-1 B, full state feedback. At the output: L = G K against C (zI - A)^-1 L,
    the filter; where the controller carries a filter of its own, the loop is broken behind it.

    Args:
        at: `input` or `output`.
        plant: G.
        loop: the filter in the controller, None without one.
        core: the rest of the controller.
        P: generalised plant, its last inputs and outputs those of `core`.
        solution: solution of both Riccati equations.
    """
    assert plant.rate_hz is not None
    f = np.geomspace(plant.rate_hz / 2 / SPAN, plant.rate_hz / 2, POINTS)
    seen = plant if loop is None else series(plant, loop)
    ny, nu = seen.D.shape
    if at == "input":
        target = StateSpace(P.A, P.B[:, -nu:], -solution.feedback, np.zeros((nu, nu)), P.rate_hz)
        error = recovery_error(series(seen, core), target, f)
    else:
        target = StateSpace(P.A, solution.injection, -P.C[-ny:], np.zeros((ny, ny)), P.rate_hz)
        error = recovery_error(series(core, seen), target, f)
    return {"at": at, "f_hz": f, "error": error[0], "relative_error": error[1]}


def recovery_error(loop: StateSpace, target: StateSpace, f_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest singular value of L - L_target over frequency, and the same over that of L_target.

    Args:
        loop: L, the loop with the controller, broken at the point of recovery.
        target: L_target, the loop with full state feedback (input) or of the filter (output).
        f_hz: frequencies, Hz.

    Returns:
        Two arrays `(nf,)`. A relative error well below one means recovery; delays and zeros outside the unit circle
        keep it near one however large the recovery factor, which is why it is measured and never assumed.
    """
    wanted = target.frequency_response(f_hz)
    error = _size(loop.frequency_response(f_hz) - wanted)
    return error, error / np.maximum(_size(wanted), 1e-300)


def _size(g: np.ndarray) -> FloatArray:
    return np.linalg.norm(np.moveaxis(g, 2, 0), 2, axis=(1, 2))
