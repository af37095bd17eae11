"""Realisations of a control law: the same response in coordinates that cost less and lose fewer digits."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ultraquiet._base.constraints import FloatArray, one_of
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.law.biquad import BankChannel, channels, parts_of
from ultraquiet.deploy.law.blocks import block_diagonal
from ultraquiet.deploy.law.decoupling import separated
from ultraquiet.values.state_space import StateSpace

# ||X|| up to which a split counts as well conditioned: sqrt(eps) of float32 is 3e-4, so a tenth of its digits' half.
SCHUR_BOUND = 1e3
# For blocks of two whatever it costs; beyond it float64 itself would lose more than half its digits (1/sqrt(eps)).
MODAL_BOUND = 6.7e7


@dataclass(frozen=True, eq=False)
class Realisation(Shown):
    """A law as blocks on the diagonal of A, with B, C, D; `A_k - I` is held instead of `A_k` when `delta`.

    `condition` is the condition number of the law's eigenvectors (of unit length): the factor by which modal
    coordinates can magnify a rounding error. A bank is x+ = A x + B T y, u = S (C x + D T y): `channels` holds how many
    blocks each channel has, `turn_in` T and `turn_out` S, both None where they are the identity.
    """

    form: str
    blocks: tuple[FloatArray, ...]
    B: FloatArray
    C: FloatArray
    D: FloatArray
    condition: float
    channels: tuple[int, ...] = ()
    turn_in: FloatArray | None = None
    turn_out: FloatArray | None = None

    @property
    def delta(self) -> bool:
        """True when the blocks hold A - I."""
        return self.form in DELTA_FORMS

    @property
    def states(self) -> int:
        """Number of stored states, a padding state included."""
        return self.B.shape[0]

    def A(self) -> FloatArray:
        """Return the whole matrix A, `(n, n)`."""
        full = np.asarray(block_diag(*self.blocks), dtype=np.float64)
        return full + np.eye(self.states) if self.delta else full

    def state_space(self, rate_hz: float | None) -> StateSpace:
        """Return the whole law, from measurements to commands."""
        return turned(self.A(), self.B, self.C, self.D, self.turn_in, self.turn_out, rate_hz)


def turned(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    turn_in: FloatArray | None,
    turn_out: FloatArray | None,
    rate_hz: float | None,
) -> StateSpace:
    """Return the law between its transforms, in float64."""
    B, C, D = (np.asarray(M, dtype=np.float64) for M in (B, C, D))
    if turn_in is not None and turn_out is not None:
        T, S = (np.asarray(M, dtype=np.float64) for M in (turn_in, turn_out))
        B, C, D = B @ T, S @ C, S @ D @ T
    return StateSpace(A, B, C, D, rate_hz=rate_hz)


def realisation(law: StateSpace, form: str) -> Realisation:
    """Return the law in the coordinates of `form`.

    `modal`: 2x2 blocks [[re, im], [-im, re]] (two reals share a block), ||B_k|| = ||C_k|| in each block.
    `delta`: the same with A - I stored, x+ = x + (A - I) x + B y, which keeps poles near z = 1 apart.
    `schur`: blocks as small as a well-conditioned change of coordinates allows. `dense`: the law as it is.
    `bank`, `bank-delta`: a law that falls apart into channels (`law.biquad.channels`) as modal or delta blocks for
    each channel, driven by and seen by that channel alone; equal poles of different channels do not meet.

    Args:
        law: discrete `StateSpace` from measurements to commands.
        form: one of the six.

    Raises:
        InputError: an unknown form, `modal`/`delta` where poles coincide so closely that 2x2 blocks do not exist, or
            `bank`/`bank-delta` for a law whose channels are coupled.

    >>> law = StateSpace([[0.9, 1.0], [0.0, 0.5]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], rate_hz=1.0)
    >>> [block.shape for block in realisation(law, "modal").blocks]
    [(2, 2)]
    """
    one_of("deploy", "form", form, tuple(FORMS))
    return FORMS[form](law)


def _modal(law: StateSpace) -> Realisation:
    blocks, B, C = _split(law, MODAL_BOUND)
    condition = eigenvector_condition(law.A)
    largest = max((len(b) for b in blocks), default=0)
    if largest > 2:
        raise InputError(
            f"deploy: modal form needs 2x2 blocks, but {largest} poles cannot be told apart (eigenvector condition"
            f" {condition:.1e}); take form='schur' or 'auto'."
        )
    return Realisation("modal", *_pairs(blocks, B, C), law.D.copy(), condition)


def _delta(law: StateSpace) -> Realisation:
    modal = _modal(law)
    blocks = tuple(block - np.eye(2) for block in modal.blocks)
    return Realisation("delta", blocks, modal.B, modal.C, modal.D, modal.condition)


def _schur(law: StateSpace) -> Realisation:
    blocks, B, C = _pad(*_split(law, SCHUR_BOUND))
    return Realisation("schur", tuple(blocks), B, C, law.D.copy(), eigenvector_condition(law.A))


def _dense(law: StateSpace) -> Realisation:
    blocks, B, C = _pad([law.A.copy()] if law.states else [], law.B.copy(), law.C.copy())
    return Realisation("dense", tuple(blocks), B, C, law.D.copy(), eigenvector_condition(law.A))


def _bank(law: StateSpace) -> Realisation:
    own_channels = _channels(law)
    parts = [_modal(channel.law) if channel.law.states else None for channel in own_channels]
    modal_parts = [p for p in parts if p is not None]
    blocks = tuple(block for p in modal_parts for block in p.blocks)
    if not blocks:
        raise InputError("deploy: a bank needs states, and this law is a gain; take form='modal' or 'auto'.")
    B, C = np.zeros((2 * len(blocks), len(own_channels))), np.zeros((len(own_channels), 2 * len(blocks)))
    at = 0
    for c, p in enumerate(parts):
        size = 0 if p is None else p.states
        if p is not None:
            B[at : at + size, c], C[c, at : at + size] = p.B[:, 0], p.C[0]
        at += size
    T, S = np.stack([c.source for c in own_channels]), np.stack([c.sink for c in own_channels], axis=1)
    plain = all(M.shape == (len(M), len(M)) and np.array_equal(M, np.eye(len(M))) for M in (T, S))
    return Realisation(
        "bank",
        blocks,
        B,
        C,
        np.diag([float(c.law.D[0, 0]) for c in own_channels]),
        max(p.condition for p in modal_parts),
        tuple(0 if p is None else len(p.blocks) for p in parts),
        None if plain else T,
        None if plain else S,
    )


def _channels(law: StateSpace) -> list[BankChannel]:
    """Return the channels of a law as it stands, else those that its response shows."""
    try:
        return channels(law)
    except InputError:
        apart = separated(law)
        if apart is None:
            raise
        return channels(apart)


def _bank_delta(law: StateSpace) -> Realisation:
    bank = _bank(law)
    return replace(bank, form="bank-delta", blocks=tuple(block - np.eye(2) for block in bank.blocks))


FORMS: Mapping[str, Callable[[StateSpace], Realisation]] = MappingProxyType(
    {"modal": _modal, "delta": _delta, "bank": _bank, "bank-delta": _bank_delta, "schur": _schur, "dense": _dense}
)
DELTA_FORMS = ("delta", "bank-delta")


def eigenvector_condition(A: FloatArray) -> float:
    """Return the condition number of the eigenvectors of A, each of unit length; infinite for a defective matrix."""
    if A.shape[0] == 0:
        return 1.0
    values = np.linalg.svd(np.linalg.eig(A)[1], compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0 else float("inf")


def _split(law: StateSpace, bound: float) -> tuple[list[FloatArray], FloatArray, FloatArray]:
    """Return balanced blocks with the matching rows of B and columns of C."""
    if law.states == 0:
        return [], law.B.copy(), law.C.copy()
    split = [_block_diagonal(law, part, bound) for part in parts_of(law.A)]
    blocks = [block for own, _, _ in split for block in own]
    B, C = np.concatenate([B for _, B, _ in split]), np.concatenate([C for _, _, C in split], axis=1)
    at = 0
    for k, block in enumerate(blocks):
        part = slice(at, at + len(block))
        turn = _normal(block)
        blocks[k] = block * (turn[None, :] / turn[:, None])
        B[part], C[:, part] = B[part] / turn[:, None], C[:, part] * turn
        size_b, size_c = np.linalg.norm(B[part]), np.linalg.norm(C[:, part])
        if size_b > 0 and size_c > 0:
            t = np.sqrt(size_c / size_b)
            B[part], C[:, part] = B[part] * t, C[:, part] / t
        at += len(block)
    return blocks, B, C


def _block_diagonal(
    law: StateSpace, part: NDArray[np.intp], bound: float
) -> tuple[list[FloatArray], FloatArray, FloatArray]:
    """Return the blocks of states that exchange nothing with the others."""
    blocks, V = block_diagonal(law.A[np.ix_(part, part)], bound)
    return blocks, np.asarray(np.linalg.solve(V, law.B[part]), dtype=np.float64), law.C[:, part] @ V


def _normal(block: FloatArray) -> FloatArray:
    """Return the diagonal scaling that turns [[a, b], [c, a]], bc < 0, into a rotation with damping."""
    if len(block) != 2 or block[0, 1] * block[1, 0] >= 0:
        return np.ones(len(block))
    return np.array([1.0, np.sqrt(-block[1, 0] / block[0, 1])])


def _pairs(
    blocks: list[FloatArray], B: FloatArray, C: FloatArray
) -> tuple[tuple[FloatArray, ...], FloatArray, FloatArray]:
    """Let reals share a block, neighbours first; an odd one is paired with a state that stays at zero."""
    starts = np.cumsum([0, *(len(b) for b in blocks)])
    twos = [(k, [int(starts[k]), int(starts[k]) + 1]) for k, b in enumerate(blocks) if len(b) == 2]
    ones = sorted((k for k, b in enumerate(blocks) if len(b) == 1), key=lambda k: float(blocks[k][0, 0]))
    order = [i for _, pair in twos for i in pair] + [int(starts[k]) for k in ones]
    paired = [blocks[k] for k, _ in twos]
    reals = [float(blocks[k][0, 0]) for k in ones]
    B, C = B[order], C[:, order]
    if len(reals) % 2 or not order:
        pad = 1 if order else 2
        reals += [0.0] * pad
        B, C = _zeros_below(B, pad), _zeros_below(C.T, pad).T
    paired += [np.diag(reals[i : i + 2]) for i in range(0, len(reals), 2)]
    return tuple(paired), B, C


def _pad(blocks: list[FloatArray], B: FloatArray, C: FloatArray) -> tuple[list[FloatArray], FloatArray, FloatArray]:
    """Give a static gain one state at rest, since C has no arrays of length zero."""
    if blocks:
        return blocks, B, C
    return [np.zeros((1, 1))], _zeros_below(B, 1), _zeros_below(C.T, 1).T


def _zeros_below(M: FloatArray, rows: int) -> FloatArray:
    return np.vstack([M, np.zeros((rows, M.shape[1]))])
