"""Controllers that are one scalar law repeated on every channel: reduced once, so that they stay alike."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.values.interconnect import append
from ultraquiet.values.state_space import StateSpace


def one_of_many(K: StateSpace) -> tuple[StateSpace, int]:
    """Return the scalar law k and the number of copies when K = diag(k, ..., k) state by state, else K and one."""
    n = K.D.shape[0]
    if n < 2 or K.D.shape != (n, n) or K.states % n:
        return K, 1
    m = K.states // n
    first = StateSpace(K.A[:m, :m], K.B[:m, :1], K.C[:1, :m], K.D[:1, :1], K.rate_hz)
    copy = append(*[first] * n)
    same = all(np.array_equal(getattr(K, key), getattr(copy, key)) for key in "ABCD")
    return (first, n) if same else (K, 1)


def averaged(gramian: FloatArray, copies: int) -> FloatArray:
    """Return the mean of a Gramian's diagonal blocks: what the copies' states have in common."""
    m = gramian.shape[0] // copies
    return np.mean([gramian[k * m : (k + 1) * m, k * m : (k + 1) * m] for k in range(copies)], axis=0)


def joined(k: StateSpace, copies: int) -> StateSpace:
    """Return diag(k, ..., k)."""
    return k if copies == 1 else append(*[k] * copies)
