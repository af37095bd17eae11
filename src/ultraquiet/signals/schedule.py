"""Which actuator a signal goes to."""

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, real_array, whole


def on_actuator(signal_v: ArrayLike, actuator: int, actuators: int) -> FloatArray:
    """Return `(actuators, samples)` commands, zero but for row `actuator` (counted from 0).

    One actuator driven, all sensors read, repeated for each actuator: the paper's experiment (section 3.4).

    >>> on_actuator([1.0, 2.0], actuator=1, actuators=3).tolist()
    [[0.0, 0.0], [1.0, 2.0], [0.0, 0.0]]
    """
    u = real_array("on_actuator", "signal_v", signal_v, 1)
    rows = whole("on_actuator", "actuators", actuators, 1)
    out = np.zeros((rows, u.size))
    out[whole("on_actuator", "actuator", actuator, 0, rows - 1)] = u
    return out
