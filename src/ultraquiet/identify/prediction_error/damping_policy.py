"""The damping and acceptance policy of every prediction-error search: Levenberg and Marquardt's.

Plain functions of numbers: `levenberg_marquardt.minimise` calls them as they are, the search in memory compiled.
"""

FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-12
INNER_TRIES = 14
STALLED_STEPS = 3
CONVERGED, RUNNING, STUCK = 1, 0, -1


def at_minimum(promised: float, small: int, least: float) -> bool:
    """Return whether an undamped step promises less than the least decrease, or enough steps in a row gained less."""
    return promised <= least or small >= STALLED_STEPS


def after_gain(damping: float, gain: float, promised: float) -> float:
    """Return the damping after a step that gained: less where the linear model kept its promise."""
    factor = 0.1 if gain > 0.75 * promised else (0.5 if gain > 0.25 * promised else 2.0)
    return max(LEAST_DAMPING, damping * factor)


def after_loss(damping: float) -> float:
    """Return the damping after a step that gained nothing or was not admissible."""
    return max(damping, 1e-9) * 6.0
