"""Measurements that drive each command to each of its limits, searched on the law as its limits leave it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet.deploy.c31.assembly import COUNTS_PER_VOLT, VOLTS_PER_COUNT, converter_limits
from ultraquiet.deploy.c31.reach import blocks_of, largest_commands, turned_by
from ultraquiet.deploy.c31.twin import C31Twin
from ultraquiet.deploy.law.law import Law

FULL = 2**15
LENGTHS = (16, 64, 256)  # frames of a push: slow states take long, and every frame is a line of the vectors
# What a command answers depends on which others stand at a limit: on none, on all, or for some of the time.
LIMITED_SHARES = (0.0, 1.0, 0.5)
# Louder is not further where a correction takes back what the others exceed; the last frame is always at full range.
LOUDNESS = (1.0, 0.25, 0.0625)
SIDES = (1, -1)
SURELY = 1.001  # the frame's own rounding is a millionth


@dataclass(frozen=True)
class Push:
    """Codes of the converters, frame by frame from rest, and where they bring one command.

    Args:
        counts: `(frames, ny)`.
        command: its number.
        side: 1 for the upper limit, -1 for the lower.
        share: of that limit, at the last frame; above 1 beyond it.
        corrected: states that a wrong sign of what is cut off the command would leave elsewhere, `(n,)`.
    """

    counts: NDArray[np.int64]
    command: int
    side: int
    share: float
    corrected: NDArray[np.bool_]


def twin_of(law: Law) -> C31Twin:
    """Return the law in the frame's own arithmetic, between the converters of the emitted text."""
    return C31Twin(law, converter_limits(law), VOLTS_PER_COUNT, COUNTS_PER_VOLT)


def pushes(law: Law) -> list[Push]:
    """Return for each command a push to its upper and one to its lower limit: the first that does all it can do.

    That is to pass the limit and to have every state with a correction corrected by a bit or more; a longer or quieter
    push is taken only where it does more of that.
    """
    twin, most = twin_of(law), unlimited_shares(law)
    made = [[_push(law, twin, i, side, most[i, k]) for k, side in enumerate(SIDES)] for i in range(law.outputs)]
    return [push for both in made for push in both]


def unlimited_shares(law: Law) -> FloatArray:
    """Return how far measurements at full range can bring each command, in shares of its limits, `(nu, 2)`.

    Infinite where a limit of another command may help, since its correction is one more input.
    """
    most_v = largest_commands(law, FULL * VOLTS_PER_COUNT)
    limits = converter_limits(law)[:, ::-1]  # upper first, as SIDES
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(limits == 0, np.inf, most_v[:, None] / np.abs(limits))
    alone = law.L is None or law.channels or (shares * SURELY < 1).all()
    return shares if alone else np.full_like(shares, np.inf)


def reach_words(law: Law, made: list[Push]) -> str:
    """Return in words which limits the pushes meet, and how far the others are known to be."""
    most = unlimited_shares(law)
    missed = []
    for push in made:
        if push.share <= 1:
            end, farthest = ("upper", "lower")[SIDES.index(push.side)], most[push.command, SIDES.index(push.side)]
            why = "which no measurement reaches" if farthest * SURELY < 1 else "and no push was found that reaches it"
            missed.append(f"command {push.command} comes to {100 * push.share:.3g} % of its {end} limit, {why}")
    return "; ".join(missed) if missed else "every command meets both limits"


def _push(law: Law, twin: C31Twin, command: int, side: int, most: float) -> Push:
    wanted = 0 if law.L is None else int(np.count_nonzero(law.L[:, command]))
    best, best_key = None, (False, -1, -np.inf)
    for counts in _candidates(law, command, side, most):
        push = _played(twin, counts, command, side)
        met = push.share > 1
        # Of those that pass the limit, the first that corrects most; of the others, the one that comes nearest.
        key = (met, int(push.corrected.sum()), 0.0 if met else push.share)
        if best is None or key > best_key:
            best, best_key = push, key
        if met and key[1] == wanted:
            break
    assert best is not None
    return best


def _candidates(law: Law, command: int, side: int, most: float) -> Iterator[NDArray[np.int64]]:
    """Yield codes `(frames, ny)` with the signs of the command's answers, the shortest and loudest first."""
    linear = law.L is None or most * SURELY < 1
    for length in LENGTHS[:1] if most * SURELY < 1 else LENGTHS:
        for share in LIMITED_SHARES[:1] if linear else LIMITED_SHARES:
            signs = np.where(side * answers(law, command, length, share) < 0, -1, 1)[::-1]
            for loudness in LOUDNESS[:1] if linear else LOUDNESS:
                size = np.full(length, int(loudness * (FULL - 1)))
                size[-1] = FULL - 1
                yield signs * size[:, None]


def answers(law: Law, command: int, length: int, share: float = 0.0) -> FloatArray:
    """Return one command, before its limits, after an impulse of each measurement, `(length, ny)`.

    Args:
        law: in modal, delta or bank form.
        command: its number.
        length: frames.
        share: of each correction L (sat(u) - u) that counts, as if every command stood at a limit for so long: x+ =
            (A - share L C) x + (B - share L D) y.

    Sums run from left to right, so that no sign is another with another BLAS.
    """
    C, D = law.C.astype(np.float64), law.D.astype(np.float64)
    kept = np.zeros(law.states) if law.L is None else share * law.L.astype(np.float64)
    row, seen = C[command], np.empty((length, D.shape[1]))
    seen[0] = D[command]
    blocks, B = blocks_of(law), law.B.astype(np.float64)
    for k in range(1, length):
        seen[k] = _times(row, B)
        following = turned_by(row, blocks)
        if share and law.L is not None:
            back = _times(row, kept)
            seen[k] -= _times(back, D)
            following = following - _times(back, C)
        row = following
    return seen


def _times(row: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return row @ matrix, summed from left to right."""
    return (matrix * row[:, None]).cumsum(axis=0)[-1] if len(row) else np.zeros(matrix.shape[1])


def _played(twin: C31Twin, counts: NDArray[np.int64], command: int, side: int) -> Push:
    twin.reset()
    corrected = np.zeros(twin.law.states, bool)
    limit = twin.limits[command, (side + 1) // 2]
    for row in counts:
        before = twin.x
        twin.frame(row)
        if twin.law.L is not None and side * (twin.u[command] - limit) > 0:
            corrected |= _corrected(twin, before, row, command)
    pushed = side * twin.u[command]
    share = pushed / abs(limit) if limit else (np.inf if pushed > 0 else 0.0)
    return Push(counts, command, side, float(share), corrected)


def _corrected(twin: C31Twin, before: FloatArray, counts: NDArray[np.int64], command: int) -> NDArray[np.bool_]:
    """Return the states of the last frame that the other sign of what was cut off a command would have changed."""
    after, u = twin.x, twin.u
    limited = np.clip(u, twin.limits[:, 0], twin.limits[:, 1])
    limited[command] = 2 * u[command] - limited[command]
    twin.x = before
    twin.update(twin.read(counts), u, limited)
    changed, twin.x = twin.x != after, after
    return changed
