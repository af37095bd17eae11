"""How far one step carries a command or a state of a whole-number law: where its code needs a limit and where not."""

from collections.abc import Callable
from itertools import product

import numpy as np

from ultraquiet.deploy.fixed_point.exact import least_squares
from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole
from ultraquiet.deploy.fixed_point.twin import FixedTwin

TRIED = 4096  # words for one of two gains, to find a sum that is just so large
SIGNS = np.array(list(product((1, -1), repeat=2)), dtype=np.int64)  # of the two states of a block


def all_corners(law: FixedLaw) -> tuple[Whole, int]:
    """Return the corners from which the self-test begins, `(corners, n + ny)`: those of commands, and last of steps.

    The number returned besides says how many are followed by a whole step.
    """
    touching, beyond = touching_corners(law), state_corners(law)
    # where no command touches its end, a state must, for the code that limits both is the same
    just = touching_steps(law) if len(beyond) and not len(touching) else beyond[:0]
    turning = turning_corners(law)
    steps = np.concatenate([turning, beyond, just])
    return np.concatenate([command_corners(law), touching, balanced_corners(law, turning), steps]), len(steps)


def turning_corners(law: FixedLaw) -> Whole:
    """Return all states at half their range or less, `(2, n + ny)`, with like and with unlike signs in each block.

    From rest a state of a law scaled by its bound may stay so small that a count of its coefficients is never seen;
    from here one turn of every block shows it, and carries no state out of its range.
    """
    corners, top = np.zeros((2, law.states + law.inputs), np.int64), law.top
    if not law.states:
        return corners[:0]
    own, parities = law.A.reshape(-1, 2), np.arange(law.states) % 2
    for corner, signs in zip(corners, SIGNS[:2], strict=True):
        size = top // 2
        while size > 0:
            turned = _rounded(size * (own @ signs), np.repeat(law.shift_a, 2) + 2)
            held = size * signs[parities]
            if np.abs(_rounded(turned, law.bits - 4) + held * law.delta).max() <= top:
                corner[: law.states] = held
                break
            size //= 2
    return corners


def balanced_corners(law: FixedLaw, turning: Whole) -> Whole:
    """Return states `(corners, n + ny)` that keep a command inside its range where a count of any gain moves it by one.

    One corner for each command that no `turning` corner shows so: it is beyond its range there, or states are smaller.
    A state of 2^s words, s the places by which its sum goes down, carries it as far as its gain says, and signs that
    balance the gains, the largest first, carry it no further than the largest of them.
    """
    top, rows, downs = law.top, law.C.T, law.shift_u + law.bits - 2
    if not law.states:
        return turning[:0]
    x = turning[:, : law.states]
    inside = np.abs(_rounded(x @ rows.T, downs)) <= top
    large = np.abs(x).min(axis=1)[:, None] >= np.minimum(np.left_shift(np.int64(1), downs), top // 2)
    unseen = ~(inside & large).any(axis=0)
    corners = np.zeros((int(unseen.sum()), law.states + law.inputs), np.int64)
    for corner, k in zip(corners, np.flatnonzero(unseen), strict=True):
        total, size = 0, min(1 << int(downs[k]), top)
        for i in np.argsort(-np.abs(rows[k]), kind="stable"):
            sign = -1 if total * rows[k, i] > 0 else 1
            total += sign * int(rows[k, i])
            corner[i] = sign * size
    return corners


def command_corners(law: FixedLaw) -> Whole:
    """Return states and measurements, `(corners, n + ny)`, that carry commands furthest beyond their range.

    At such a corner every product of a command's sum has the same sign: u = r(sum |c| x, s). A command has an upper and
    a lower corner where one of them lies beyond its range, and none where no state and no measurement gets there: its
    limit would be code that nothing can run.
    """
    rows = np.hstack([law.C.T, law.D])
    corners = np.stack([_at(rows, law), _at(-rows, law)], axis=1)
    return corners[limited_commands(law)].reshape(-1, law.states + law.inputs)


def touching_corners(law: FixedLaw) -> Whole:
    """Return states and measurements, `(corners, n + ny)`, that carry a command just to its end and one count beyond.

    At the end a limit must change nothing and count nothing, one count further it must. The count is that of all
    commands, so that a step in which another one goes beyond its range shows nothing: they are those of a command,
    the loudest first, for which words are found that leave all others inside; of any command where there are none
    such, and none where the words of no command are fine enough.
    """
    top = law.top
    rows, downs = np.hstack([law.C.T, law.D]), law.shift_u + law.bits - 2
    ends = [(end, sign) for end in (top, top + 1) for sign in (1, -1)]
    found = np.zeros((0, rows.shape[1]), np.int64)
    for k in np.argsort(-largest_commands(law), kind="stable"):
        for drawn in (_drawn_back, _others_at_rest):
            corners = [_touching(drawn, sign * rows, k, downs, law, end, sign) for end, sign in ends]
            if any(corner is None for corner in corners):
                continue
            words = np.array(corners, np.int64)
            if (np.abs(_rounded(np.delete(words @ rows.T, k, axis=1), np.delete(downs, k))) <= top).all():
                return words
            found = found if found.size else words
    return found


def _touching(
    drawn: Callable[..., Whole | None], rows: Whole, k: int, downs: Whole, law: FixedLaw, end: int, sign: int
) -> Whole | None:
    """Return words whose sum in row k rounds to `end` on its own side, or None where none were found.

    All products with the row's corner are positive. The two words of the smallest gains are sought among `TRIED` pairs,
    those nearest to half of what they may be first; all others are `drawn` so that these halves are about what is
    missing.
    """
    row, down = rows[k], int(downs[k])
    corner = _at(rows[k : k + 1], law)[0]
    fine = [i for i in np.argsort(np.abs(row), kind="stable") if row[i] != 0][:2]
    if len(fine) < 2:
        return None
    last, other = fine
    wanted = (end << down) - (1 << (down - 1))
    if wanted > int((row * corner).sum()):
        return None  # out of every word's reach, and where the sum goes down by many places out of 64 bits too
    words = drawn(rows, k, downs, corner, fine, wanted)
    if words is None:
        return None
    missing = wanted - int((row * words).sum())
    most = abs(int(corner[other]))
    first = np.unique(np.linspace(0, most, TRIED).astype(np.int64))
    # a sign may take half a count to the other side: one more than the least that reaches the end does no harm
    second = -((abs(int(row[other])) * first - missing) // abs(int(row[last])))
    for more in (0, 1):
        sums = abs(int(row[other])) * first + abs(int(row[last])) * (second + more) - missing
        held = (second + more >= 0) & (second + more <= abs(int(corner[last])))
        good = np.flatnonzero(held & (sign * _rounded(sign * (sums + wanted), down) == end))
        if good.size:
            best = good[np.argmin(np.abs(first[good] - most // 2))]
            words[other], words[last] = first[best], second[best] + more
            words[fine] *= np.sign(corner[fine])
            return words
    return None


def _drawn_back(rows: Whole, k: int, downs: Whole, corner: Whole, fine: list[int], wanted: int) -> Whole:
    """Return the corner of a row with all words but the fine ones, which are zero, drawn back together."""
    products = rows[k] * corner
    rest = int(products.sum() - products[fine].sum())
    share = (wanted - int(products[fine].sum()) // 2) / rest if rest else 0.0
    words = np.trunc(corner * min(max(share, 0.0), 1.0)).astype(np.int64)
    words[fine] = 0
    return words


def _others_at_rest(rows: Whole, k: int, downs: Whole, corner: Whole, fine: list[int], wanted: int) -> Whole | None:
    """Return the least words that carry the other rows nowhere, the fine ones zero; None where that takes too much."""
    rest = np.delete(np.arange(rows.shape[1]), fine)
    if not rest.size:
        return None
    target = -(rows[:, fine] @ (corner[fine] // 2))
    target[k] += wanted
    found = least_squares(rows[:, rest], target.tolist(), (downs.max() - downs).tolist())
    if max(map(abs, found)) > int(np.abs(corner).max()):
        return None
    words = np.zeros(rows.shape[1], np.int64)
    words[rest] = [int(x) for x in found]
    return words


def largest_commands(law: FixedLaw) -> Whole:
    """Return the furthest that any state and any measurement carries each command, `(nu,)`, before its limit."""
    rows = np.hstack([law.C.T, law.D])
    down = law.shift_u + law.bits - 2
    both = [np.abs(_rounded((_at(sign * rows, law) * rows).sum(axis=1), down)) for sign in (1, -1)]
    return np.maximum(*both)


def limited_commands(law: FixedLaw) -> list[bool]:
    """Return for each command whether anything carries it beyond its range."""
    return [bool(size > law.top) for size in largest_commands(law)]


def state_corners(law: FixedLaw) -> Whole:
    """Return states and measurements, `(corners, n + ny)`, from which one step carries a state beyond its range.

    For each of the two rows of a block the state that goes furthest up and the one that goes furthest down; none for
    a law scaled by its bound, whose states need no limit, and none where no word of state and measurements gets there.
    """
    if not law.saturates or not law.states:
        return np.zeros((0, law.states + law.inputs), np.int64)
    top = law.top
    own, parities = law.A.reshape(-1, 2), np.arange(law.states) % 2
    corners = []
    for sign in (1, -1):
        y = np.where(sign * law.B > 0, top, np.where(law.B == 0, 0, -top - 1))
        drive = _rounded((law.B * y).sum(axis=1), law.shift_b + 2)[:, None]
        turned = _rounded(top * (own @ SIGNS.T), (np.repeat(law.shift_a, 2) + 2)[:, None])
        held = top * SIGNS.T[parities] if law.delta else 0
        reached = sign * (_rounded(turned + drive, law.bits - 4) + held)
        best = reached.argmax(axis=1)
        furthest = reached.max(axis=1)
        for parity in range(2):
            k = 2 * int(furthest[parity::2].argmax()) + parity
            if furthest[k] > top:
                x = np.zeros(law.states, np.int64)
                x[k - parity : k - parity + 2] = top * SIGNS[best[k]]
                corners.append(np.concatenate([x, y[k]]))
    return np.array(corners, np.int64).reshape(-1, law.states + law.inputs)


def touching_steps(law: FixedLaw) -> Whole:
    """Return states and measurements, `(corners, n + ny)`, from which one step carries a state just to its end.

    And one count beyond, on both sides, all other states inside their range; none where no state is found that does.
    """
    ends = [(end, sign) for end in (law.top, law.top + 1) for sign in (1, -1)]
    twin = FixedTwin(law)
    for k in range(law.states):
        for driven in (False, True):
            corners = [_stepping(twin, k, end, sign, driven) for end, sign in ends]
            found = [corner for corner in corners if corner is not None]
            if len(found) == len(ends):
                return np.array(found, np.int64)
    return np.zeros((0, law.states + law.inputs), np.int64)


def _stepping(twin: FixedTwin, k: int, end: int, sign: int, driven: bool) -> Whole | None:
    """Return words from which state k becomes `end` on its own side and no other leaves its range, or None.

    From the words that carry it furthest, those that move it least per count are drawn to the other end first, one
    after the other, until one of them crosses what is sought: what that becomes rises with it, or falls.
    """
    law = twin.law
    gains, words = np.zeros(law.states + law.inputs), np.zeros(law.states + law.inputs, np.int64)
    block = slice(k - k % 2, k - k % 2 + 2)
    gains[block] = law.A.reshape(-1, 2)[k] * 2.0 ** -float(law.shift_a[k // 2] + law.bits - 2)
    gains[k] += float(law.delta)
    if driven:
        gains[law.states :] = law.B[k] * 2.0 ** -float(law.shift_b[k] + law.bits - 2)
    words[:] = sign * law.top * np.sign(gains)

    def reached() -> Whole:
        return np.asarray(sign * twin.following(words[: law.states], words[law.states :]))

    for at in np.argsort(np.abs(gains), kind="stable"):
        if gains[at] == 0 or reached()[k] < end:
            continue
        near, far = int(words[at]), -int(words[at])
        while abs(near - far) > 1:
            words[at] = (near + far) // 2
            if reached()[k] >= end:
                near = int(words[at])
            else:
                far = int(words[at])
        words[at] = near
    inside = np.abs(np.delete(reached(), k)).max(initial=0) <= law.top
    return words if reached()[k] == end and inside else None


def _at(rows: Whole, law: FixedLaw) -> Whole:
    """Return the words that make every product with a row positive, as large as they can be.

    States are held within -top and top, a measurement is whatever word a converter gives.
    """
    top = law.top
    low = np.where(np.arange(rows.shape[1]) < law.states, -top, -top - 1)
    return np.where(rows > 0, top, np.where(rows < 0, low, 0))


def _rounded(value: Whole, shift: Whole | int) -> Whole:
    """Return floor(value / 2^shift + 1/2)."""
    return np.right_shift(value + np.left_shift(np.int64(1), np.asarray(shift, np.int64) - 1), shift)
