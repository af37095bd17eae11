"""Banks of second-order sections: laws that fall apart into channels of one measurement and one command each."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.values.state_space import StateSpace

# A matrix counts as of rank one, and two directions as one, up to some hundred roundings of float64.
SAME = 1e-12


@dataclass(frozen=True, eq=False)
class BankChannel:
    """A scalar law k with u += s k(t' y): `source` is t `(ny,)`, `sink` is s `(nu,)`, both of unit length."""

    law: StateSpace
    source: FloatArray
    sink: FloatArray


def channels(law: StateSpace) -> list[BankChannel]:
    """Return the scalar laws whose sum, each between its own directions, is the law: K = sum_c s_c k_c t_c'.

    States that exchange nothing belong to different parts; each part must take in one combination of the measurements
    and put out one combination of the commands, as the struts of a decentralised law do, or the loops of a decoupled
    one. Parts with the same directions are one channel.

    Raises:
        InputError: a part with several inputs or outputs, or a direct gain between channels.

    >>> one = [[0.9, 0.0], [0.0, 0.5]]
    >>> law = StateSpace(one, np.eye(2), np.eye(2), np.zeros((2, 2)), rate_hz=1.0)
    >>> [(c.law.states, c.source.tolist()) for c in channels(law)]
    [(1, [1.0, 0.0]), (1, [0.0, 1.0])]
    """
    groups: list[tuple[FloatArray, FloatArray, list[NDArray[np.intp]]]] = []
    for part in parts_of(law.A):
        t, s = _direction(law.B[part]), _direction(law.C[:, part].T)
        if t is None or s is None:
            continue  # neither driven nor seen: it never leaves zero, or nobody knows
        for source, sink, members in groups:
            if abs(source @ t) > 1 - SAME and abs(sink @ s) > 1 - SAME:
                members.append(part)
                break
        else:
            groups.append((t, s, [part]))
    gains = _gains(law.D, groups)
    order = sorted(range(len(groups)), key=lambda c: int(np.argmax(np.abs(groups[c][1]))))
    return [_channel(law, *groups[c], gains[c]) for c in order]


def parts_of(A: FloatArray) -> list[NDArray[np.intp]]:
    """Return the states of each part of x+ = A x that exchanges nothing with the others."""
    if not len(A):
        return []
    count, label = connected_components(A != 0, directed=False)
    return [np.flatnonzero(label == k) for k in range(count)]


def _direction(matrix: FloatArray) -> FloatArray | None:
    """Return the unit row whose multiples the rows of a matrix are; None for a matrix of zeros."""
    used = np.flatnonzero(np.any(matrix != 0, axis=0))
    if not used.size:
        return None
    unit = np.zeros(matrix.shape[1])
    if used.size == 1:
        unit[used] = 1.0
        return unit
    _, size, rows = np.linalg.svd(matrix, full_matrices=False)
    if size.size > 1 and size[1] > SAME * size[0]:
        raise InputError(
            f"deploy: a bank needs channels of one measurement and one command, but {matrix.shape[0]} states of this"
            f" law join {used.size}; take form='modal' or 'auto'."
        )
    return rows[0] * np.sign(rows[0, np.argmax(np.abs(rows[0]))])


def _gains(D: FloatArray, groups: list[Any]) -> FloatArray:
    """Return g with D = sum_c g_c s_c t_c'; channels without states are added for direct gains of their own."""
    for i, j in zip(*np.nonzero(D), strict=True):
        t, s = np.eye(D.shape[1])[j], np.eye(D.shape[0])[i]
        units = all(np.count_nonzero(v) == 1 for one in groups for v in one[:2])
        if units and not any(one[0] @ t == 1 and one[1] @ s == 1 for one in groups):
            groups.append((t, s, []))
    basis = np.stack([np.outer(s, t).ravel() for t, s, _ in groups], axis=1) if groups else np.zeros((D.size, 0))
    gains = np.linalg.lstsq(basis, D.ravel())[0] if groups else np.zeros(0)
    left = np.abs(D.ravel() - basis @ gains).max(initial=0.0)
    if left > SAME * np.abs(D).max(initial=0.0) or not groups:
        raise InputError(
            f"deploy: a bank needs a direct gain within its channels, but {left:.1e} of this law's lies between"
            " them; take form='modal' or 'auto'."
        )
    return np.asarray(gains, dtype=np.float64)


def _channel(law: StateSpace, t: FloatArray, s: FloatArray, parts: list[NDArray[np.intp]], gain: float) -> BankChannel:
    own = np.concatenate([*parts, np.zeros(0, dtype=np.intp)]).astype(np.intp)
    B, C = law.B[own] @ t[:, None], s[None, :] @ law.C[:, own]
    return BankChannel(StateSpace(law.A[np.ix_(own, own)], B, C, [[gain]], rate_hz=law.rate_hz), t, s)


class BankArithmetic:
    """The arithmetic of a bank, sums from left to right as in the code; arrays in the code's precision.

    z = T y; v_c = D_c z_c + sum of C_k x_k over the states of channel c; u = v or S v.
    """

    def __init__(self, law: Any) -> None:
        states = 2 * np.array(law.channels)
        starts = np.concatenate([[0], np.cumsum(states)])[:-1]
        self._last = states
        width = int(states.max(initial=0))
        self._at = np.minimum(starts[:, None] + np.arange(width), law.states - 1)
        self._of = np.repeat(np.arange(states.size), states)
        B, C, self._D = sections(law)
        self._B, self._C = B, C[self._at]
        self._in, self._out = law.turn_in, law.turn_out
        self._L = None if law.L is None else (law.L if law.turned else law.L[np.arange(law.states), self._of][:, None])
        pairs = np.stack(law.blocks)
        self._A = pairs.reshape(-1, 2, 2)
        self._turned, self._delta = law.turned, law.delta

    def seen(self, y: NDArray[Any]) -> NDArray[Any]:
        """Return what each channel measures, `(channels,)`."""
        return y if self._in is None else (self._in * y).cumsum(axis=1)[:, -1]

    def output(self, y: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
        """Return the commands before the limits, `(nu,)`."""
        direct = (self._D * self.seen(y))[:, None]
        sums = np.concatenate([direct, self._C * x[self._at]], axis=1).cumsum(axis=1)
        v = sums[np.arange(self._last.size), self._last]
        return v if self._out is None else (self._out * v).cumsum(axis=1)[:, -1]

    def advance(self, y: NDArray[Any], x: NDArray[Any], missed: NDArray[Any]) -> NDArray[Any]:
        """Return the next states; `missed` is sat(u) - u."""
        own = (self._A * x.reshape(-1, 1, 2)).reshape(-1, 2)
        terms = [own, (self._B * self.seen(y)[self._of])[:, None]]
        if self._L is not None:
            terms.append(self._L * (missed if self._turned else missed[self._of][:, None]))
        following = np.concatenate(terms, axis=1).cumsum(axis=1)[:, -1]
        return x + following if self._delta else following


def sections(law: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return a bank's B and C, one number for each state, and D, one for each channel."""
    of = np.repeat(np.arange(len(law.channels)), 2 * np.array(law.channels))
    at = np.arange(law.states)
    return law.B[at, of].copy(), law.C[of, at].copy(), np.diag(law.D).copy()
