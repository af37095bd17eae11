"""What the norm of a shaped loop says of S, T and KS of the plant: loop shaping's weights on the loop itself."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.design.weights.filters import reciprocal
from ultraquiet.values.interconnect import append, gain, series
from ultraquiet.values.state_space import StateSpace


class EvenWeight(NamedTuple):
    """A weight W = w X: one channel w, with a feedthrough, on each signal, and a constant X."""

    one: StateSpace
    mix: FloatArray


def on_loop(pre: StateSpace, post: StateSpace, factor: StateSpace) -> dict[str, StateSpace]:
    """Return weights W with sigma(S), sigma(T), sigma(KS) <= b / sigma_min(W), b the norm of the shaped loop.

    Gs = W2 G W1 = M^-1 N, M M* + N N* = I, K = W1 Ks W2 and b = ||[I; Ks] Ss [I, Gs]||, Ss = (I - Gs Ks)^-1. As
    [I, Gs] = M^-1 [M, N] and [M, N] is co-inner, sigma(Ss M^-1) and sigma(Ks Ss M^-1) are at most b. The projection
    [I; Ks] Ss [I, -Gs] has the norm of its complement, and of that one block is -Ts = -Gs Ks Ss, at most b as well.
    With Ss = W2 S W2^-1, Ts = W2 T W2^-1, Ks Ss = W1^-1 KS W2^-1 and W1 = w1 X1, W2 = w2 X2

        sigma(S) <= b sigma(M) cond(X2),    sigma(T) <= b cond(X2),
        sigma(KS) <= b sigma(M) |w1| sigma(X1) |w2| sigma(X2),    sigma(M) = (1 + sigma_min(Gs)^2)^-1/2,

    so that W is M^-1 / cond(X2), 1 / cond(X2) and M^-1 / (w1 w2 sigma(X1) sigma(X2)).

    Args:
        pre: W1; where it is not of that form nothing is returned of KS.
        post: W2; where it is not nothing is returned at all.
        factor: M^-1.

    McFarlane and Glover 1992, doi:10.1109/9.256330, theorem 4.1, where T has sigma(N) besides; that is left out here,
    for a weight 1 / N is improper.
    """
    after, before = even_weight(post), even_weight(pre)
    if after is None:
        return {}
    rate, ny = factor.rate_hz, factor.D.shape[0]
    uneven = float(np.linalg.cond(after.mix))
    found = {"S": series(factor, gain(np.eye(ny) / uneven, rate)), "T": gain([[1 / uneven]], rate)}
    if before is not None:
        size = float(np.linalg.norm(before.mix, 2) * np.linalg.norm(after.mix, 2))
        inverse = series(series(reciprocal(before.one), reciprocal(after.one)), gain([[1 / size]], rate))
        found["KS"] = series(factor, append(*[inverse] * ny))
    return found


def even_weight(weight: StateSpace) -> EvenWeight | None:
    """Return w and X of a weight X w, with the copies of w first; None where it is none or w has no feedthrough.

    >>> even_weight(gain([[2.0, 0.0], [0.0, 3.0]])).mix.tolist()
    [[2.0, 0.0], [0.0, 3.0]]
    """
    (rows, signals), n = weight.D.shape, weight.states
    if not n:
        return EvenWeight(gain([[1.0]], weight.rate_hz), np.asarray(weight.D))
    if n % signals or rows != signals:
        return None
    k, eye = n // signals, np.eye(signals)
    a, b = weight.A[:k, :k], weight.B[:k, :1]
    mix = weight.D
    if not mix.any() or not (np.array_equal(weight.A, np.kron(eye, a)) and np.array_equal(weight.B, np.kron(eye, b))):
        return None
    # X is known but for a factor, which w takes: its feedthrough is one
    row, column = np.unravel_index(np.argmax(np.abs(mix)), mix.shape)
    c = weight.C[row : row + 1, column * k : (column + 1) * k] / mix[row, column]
    if not np.allclose(weight.C, mix @ np.kron(eye, c), rtol=1e-9, atol=1e-12 * np.abs(weight.C).max()):
        return None
    return EvenWeight(StateSpace(a, b, c, [[1.0]], weight.rate_hz), np.asarray(mix))
