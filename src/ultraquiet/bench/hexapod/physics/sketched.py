"""The hexapod as points and lines, and how its platform moves with what its struts read."""

import numpy as np

from ultraquiet.bench.hexapod.physics.geometry import Joints, jacobian
from ultraquiet.bench.hexapod.physics.parameters import STRUTS
from ultraquiet.values.sketch import Sketch


def sketch(at: Joints, readings: int) -> Sketch:
    """Return base joints, then platform joints; the platform is rigid: v_p = v + w x (p - c), strut rates J (v, w).

    Args:
        at: where the joints stand.
        readings: of the bench; the first six are those of the struts.
    """
    centre = at.platform.mean(axis=0)
    rigid = np.linalg.inv(jacobian(at.platform, at.directions, centre))
    moves = np.zeros((2 * STRUTS, 3, readings))
    for k, arm in enumerate(at.platform - centre):
        spin = np.array([[0.0, arm[2], -arm[1]], [-arm[2], 0.0, arm[0]], [arm[1], -arm[0], 0.0]])
        moves[STRUTS + k, :, :STRUTS] = rigid[:3] + spin @ rigid[3:]
    around = [(side + k, side + (k + 1) % STRUTS) for side in (0, STRUTS) for k in range(STRUTS)]
    return Sketch(np.vstack([at.base, at.platform]), [*around, *((k, STRUTS + k) for k in range(STRUTS))], moves)
