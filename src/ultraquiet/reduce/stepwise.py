"""A law made smaller a few states at a time, each few chosen by the loop that the law so far closes."""

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.linalg import balance
from ultraquiet.reduce._abstract import METHODS, project
from ultraquiet.values.interconnect import lft, repeated
from ultraquiet.values.state_space import StateSpace

STEPS = 30  # a law goes down by so small a part of its states at a time: the loop changes little under each
LEAST = 2  # states of a usual step: a mode has as many
LARGER = 3  # times that, by which a step may go down where a smaller one loses the loop


def in_steps(
    P: StateSpace, law: StateSpace, copies: int, order: int, methods: Sequence[str] = METHODS
) -> tuple[StateSpace, FloatArray] | None:
    """Return the law of `order` states reached by projections of a few at a time, and its last Hankel values.

    The error of a reduced law counts by P12 (I - K P22)^-1 dK (I - P22 K)^-1 P21 to first order only: where states by
    the dozen leave that matter nearly alike, the factors of the full law's loop say nothing of the loop that is left.
    They are formed anew for each step from the law so far. Where a step loses the loop the other method is tried, then
    fewer states, then some more.

    Args:
        P: generalised plant, its loop with the law stable.
        law: the law on one channel, or the whole one.
        copies: channels that the law is repeated on.
        order: states of `law` to be kept.
        methods: of projection, the first of which is tried first in each step.

    Returns:
        None where no step from some law on the way keeps the loop.

    Wortelboer 1994.
    """
    hankel, usual = np.zeros(0), max(LEAST, law.states // STEPS)
    while law.states > order:
        found = _one_step(P, law, copies, product(_sizes(usual, law.states - order), methods))
        if found is None:
            return None
        law, hankel = found
    return law, hankel


def _one_step(
    P: StateSpace, law: StateSpace, copies: int, tries: Iterable[tuple[int, str]]
) -> tuple[StateSpace, FloatArray] | None:
    """Return the first law that keeps the loop, of those so many states smaller by a method, and its Hankel values."""
    Pc, Qo = loop_gramians(P, lft(P, repeated(law, copies)), copies)
    for size, method in tries:
        try:
            M, hankel = project((law.A, law.B, law.C, law.D), Pc, Qo, law.states - size, P.rate_hz is not None, method)
            smaller = StateSpace(*M, rate_hz=P.rate_hz)
            if lft(P, repeated(smaller, copies)).is_stable():
                return smaller, hankel
        except (np.linalg.LinAlgError, InputError, NumericalError):
            continue
    return None


def _sizes(usual: int, most: int) -> list[int]:
    """Return by how many states a step may go down: as usual, by halves of it, then by more."""
    first = min(usual, most)
    halves = [first >> k for k in range(first.bit_length())]
    return halves + list(range(first + 1, min(LARGER * usual, most) + 1))


def loop_gramians(P: StateSpace, loop: StateSpace, copies: int) -> tuple[FloatArray, FloatArray]:
    """Return the Gramians of the law's state inside the loop, for copies of a law their mean over the copies."""
    both = _gramians(loop)
    controllability, observability = (mean_block(W[P.states :, P.states :], copies) for W in both)
    return controllability, observability


def _gramians(loop: StateSpace) -> tuple[FloatArray, FloatArray]:
    """Return the Gramians of a loop; in discrete time from their factors, which slow modes do not make indefinite."""
    if loop.rate_hz is None:
        return balance.gramians(loop.A, loop.B, loop.C, discrete=False)
    R, L = balance.gramian_factors(loop.A, loop.B, loop.C, discrete=True)
    return R @ R.T, L @ L.T


def mean_block(gramian: FloatArray, copies: int) -> FloatArray:
    """Return the mean of a Gramian's diagonal blocks: what the copies' states have in common."""
    m = gramian.shape[0] // copies
    return np.mean([gramian[k * m : (k + 1) * m, k * m : (k + 1) * m] for k in range(copies)], axis=0)
