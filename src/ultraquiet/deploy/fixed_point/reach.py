"""How far one step carries a command or a state of a whole-number law: where its code needs a limit and where not."""

from itertools import product

import numpy as np

from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole

SIGNS = np.array(list(product((1, -1), repeat=2)), dtype=np.int64)  # of the two states of a block


def command_corners(law: FixedLaw) -> Whole:
    """Return states and measurements, `(corners, n + ny)`, that carry commands furthest beyond their range.

    At such a corner every product of a command's sum has the same sign: u = r(sum |c| x, s). A command has an upper and
    a lower corner where one of them lies beyond its range, and none where no state and no measurement gets there: its
    limit would be code that nothing can run.
    """
    top = 2 ** (law.bits - 1) - 1
    rows = np.hstack([law.C.T, law.D])
    corners = np.stack([_at(rows, law), _at(-rows, law)], axis=1)
    down = law.shift_u + law.bits - 2
    reached = _rounded((corners * rows[:, None, :]).sum(axis=2), down[:, None])
    return corners[np.abs(reached).max(axis=1) > top].reshape(-1, law.states + law.inputs)


def largest_commands(law: FixedLaw) -> Whole:
    """Return the furthest that any state and any measurement carries each command, `(nu,)`, before its limit."""
    rows = np.hstack([law.C.T, law.D])
    down = law.shift_u + law.bits - 2
    both = [np.abs(_rounded((_at(sign * rows, law) * rows).sum(axis=1), down)) for sign in (1, -1)]
    return np.maximum(*both)


def limited_commands(law: FixedLaw) -> list[bool]:
    """Return for each command whether anything carries it beyond its range."""
    return [bool(size > 2 ** (law.bits - 1) - 1) for size in largest_commands(law)]


def state_corners(law: FixedLaw) -> Whole:
    """Return states and measurements, `(corners, n + ny)`, from which one step carries a state beyond its range.

    For each of the two rows of a block the state that goes furthest up and the one that goes furthest down; none for
    a law scaled by its bound, whose states need no limit, and none where no word of state and measurements gets there.
    """
    if not law.saturates or not law.states:
        return np.zeros((0, law.states + law.inputs), np.int64)
    top = 2 ** (law.bits - 1) - 1
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


def _at(rows: Whole, law: FixedLaw) -> Whole:
    """Return the words that make every product with a row positive, as large as they can be.

    States are held within -top and top, a measurement is whatever word a converter gives.
    """
    top = 2 ** (law.bits - 1) - 1
    low = np.where(np.arange(rows.shape[1]) < law.states, -top, -top - 1)
    return np.where(rows > 0, top, np.where(rows < 0, low, 0))


def _rounded(value: Whole, shift: Whole | int) -> Whole:
    """Return floor(value / 2^shift + 1/2)."""
    return np.right_shift(value + np.left_shift(np.int64(1), np.asarray(shift, np.int64) - 1), shift)
