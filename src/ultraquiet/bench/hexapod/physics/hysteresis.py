"""Rate-independent hysteresis of the stacks: Maxwell elements that slip."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray

# Thresholds in volts and weights, typical of soft piezo stacks (assumed); the first element never slips.
THRESHOLDS_V = (0.0, 2.0, 5.0, 10.0, 17.5, 27.5, 40.0, 55.0, 75.0)
WEIGHTS = (0.70, 0.045, 0.045, 0.045, 0.045, 0.05, 0.05, 0.06, 0.06)
# At this amplitude the gain is one, so that the linear bench is the hysteretic one at a typical level.
UNIT_GAIN_V = 15.0


@dataclass(frozen=True, eq=False)
class Plays:
    """w = sum_j g_j p_j, each p_j dragged along by v once they are r_j apart: |v - p_j| <= r_j.

    The elements of Goldfarb and Celanovic, IEEE Control Systems 17 (1997) 69-79, doi:10.1109/37.588158, told by the
    anchors of their springs. The loop is the same at every frequency: the paper calls its hysteresis so, while its
    eq. (9) is linear and depends on frequency.

    differs from the stack: the plays act on the held command, before the amplifier's RC, where they can be sampled.
    """

    thresholds_v: FloatArray
    weights: FloatArray


def typical() -> Plays:
    """Return the plays of a typical stack, scaled to unit gain at UNIT_GAIN_V.

    >>> plays = typical()
    >>> moved = np.maximum(15.0 - plays.thresholds_v, 0.0)
    >>> round(float(plays.weights @ moved), 9)
    15.0
    """
    r, g = np.array(THRESHOLDS_V), np.array(WEIGHTS)
    return Plays(r, g * UNIT_GAIN_V / float(g @ np.maximum(UNIT_GAIN_V - r, 0.0)))


def none() -> Plays:
    """Return no plays: the voltage passes unchanged."""
    return Plays(np.zeros(0), np.zeros(0))
