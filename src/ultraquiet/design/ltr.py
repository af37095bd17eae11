"""Loop transfer recovery: how near a loop is to the target it is meant to recover."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.values.state_space import StateSpace


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
