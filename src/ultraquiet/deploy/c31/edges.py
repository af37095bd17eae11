"""Frames in which a command lies a count beyond a limit and a count within it: what compares them is seen to."""

import numpy as np
from numpy.typing import NDArray

from ultraquiet.deploy.c31.assembly import VOLTS_PER_COUNT
from ultraquiet.deploy.c31.pushes import FULL, Push, answers
from ultraquiet.deploy.c31.twin import C31Twin

# Of the converter's range, to go towards a limit that one frame does not reach: the opposites of what drove a command
# there bring it back where others' corrections hold it, but may carry it far past; the quieter, the less.
NUDGES = (1.0, 0.25, 0.0)
PATIENCE = 64  # frames of such a way back, or as many as its push has


def edges(twin: C31Twin, push: Push) -> list[NDArray[np.int64]]:
    """Play a push from rest and return codes, frame by frame after it, that bring its command back to its limit.

    A count beyond it first, then a count within. While commands go to their limits together, what is cut off one and
    what is asked of the next lie beyond a limit together too, and to compare the wrong one of them would not be
    noticed. Where measurements within the converter's range do not stop it there, neither at once nor after some
    frames towards it, it passes the limit as it comes.

    Args:
        twin: of the law; it is left where the last of these frames leaves it.
        push: what drives the command beyond its limit.
    """
    rows = list[NDArray[np.int64]]()
    for towards in (None, *NUDGES, None):  # where none stops it the twin is left by the first way, once more
        rows, stopped = _way_back(twin, push, towards)
        if stopped:
            break
    return rows


def _way_back(twin: C31Twin, push: Push, towards: float | None) -> tuple[list[NDArray[np.int64]], bool]:
    """Return codes after a push from rest, and whether they stop its command on both sides of its limit.

    A frame that does not reach the limit goes `towards` it at this share of the range, or is the push's opposite, None.
    """
    twin.reset()
    for counts in push.counts:
        twin.frame(counts)
    # a law without a direct part answers a frame later
    answered = answers(twin.law, push.command, 2)
    later = int(not np.any(answered[0]))
    signs, gain = np.sign(answered[later]).astype(np.int64), np.abs(answered[later]).sum() * VOLTS_PER_COUNT
    if not gain:
        return [], False
    limit = twin.limits[push.command, (push.side + 1) // 2]
    made, met = list[NDArray[np.int64]](), 0
    frames = len(push.counts)
    for k in range(frames if towards is None else max(PATIENCE, frames)):
        code = (limit - _free(twin, push.command, later)) / gain
        reached = abs(code) < FULL - 2
        if reached:
            row = signs * (round(code) + push.side * (1, -1)[met])
        elif towards is None:
            row = -push.counts[k]  # opposites of what drove it there bring it back
        else:
            row = signs * int(np.sign(code) * towards * (FULL - 1))
        rows = [row, *[np.zeros_like(row)] * (later * reached)]
        for each in rows:
            twin.frame(each)
        made, met = [*made, *rows], met + reached
        within = push.side * (twin.u[push.command] - limit) < 0
        if met == 2 or (within and not reached and towards is None):
            break
    return made, met == 2


def _free(twin: C31Twin, command: int, later: int) -> float:
    """Return what a command comes to by itself, so many frames on, without moving the twin."""
    x, u, silent = twin.x, twin.u, np.zeros(twin.law.inputs)
    for _ in range(later):
        twin.frame(silent)
    free = float(twin.output(silent)[command])
    twin.x, twin.u = x, u
    return free
