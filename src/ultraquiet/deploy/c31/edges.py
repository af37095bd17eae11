"""Frames in which a command lies a count beyond a limit and a count within it: what compares them is seen to."""

import numpy as np
from numpy.typing import NDArray

from ultraquiet.deploy.c31.assembly import VOLTS_PER_COUNT
from ultraquiet.deploy.c31.pushes import FULL, Push, answers
from ultraquiet.deploy.c31.twin import C31Twin


def edges(twin: C31Twin, push: Push) -> list[NDArray[np.int64]]:
    """Play a push from rest and return codes, frame by frame after it, that bring its command back to its limit.

    A count beyond it first, then a count within. While commands go to their limits together, what is cut off one and
    what is asked of the next lie beyond a limit together too, and to compare the wrong one of them would not be
    noticed. Where measurements within the converter's range do not stop it there it passes the limit as it comes.

    Args:
        twin: of the law; it is left where the last of these frames leaves it.
        push: what drives the command beyond its limit.
    """
    twin.reset()
    for counts in push.counts:
        twin.frame(counts)
    # a law without a direct part answers a frame later
    answered = answers(twin.law, push.command, 2)
    later = int(not np.any(answered[0]))
    signs, gain = np.sign(answered[later]).astype(np.int64), np.abs(answered[later]).sum() * VOLTS_PER_COUNT
    if not gain:
        return []
    limit = twin.limits[push.command, (push.side + 1) // 2]
    made, met = list[NDArray[np.int64]](), 0
    for back in -push.counts:  # they drove it there, and their opposites bring it back
        code = (limit - _free(twin, push.command, later)) / gain
        reached = abs(code) < FULL - 2
        row = signs * (round(code) + push.side * (1, -1)[met]) if reached else back
        rows = [row, *[np.zeros_like(row)] * (later * reached)]
        for each in rows:
            twin.frame(each)
        made, met = [*made, *rows], met + reached
        within = push.side * (twin.u[push.command] - limit) < 0
        if met == 2 or (within and not reached):
            break
    return made


def _free(twin: C31Twin, command: int, later: int) -> float:
    """Return what a command comes to by itself, so many frames on, without moving the twin."""
    x, u, silent = twin.x, twin.u, np.zeros(twin.law.inputs)
    for _ in range(later):
        twin.frame(silent)
    free = float(twin.output(silent)[command])
    twin.x, twin.u = x, u
    return free
