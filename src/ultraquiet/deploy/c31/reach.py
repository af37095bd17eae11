"""How far measurements within their range can bring the commands of a law in 2x2 blocks, proven from above."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.deploy.law.law import Law

FRAMES = 4096  # answers summed one by one; what comes later is bounded
STRETCHES = 64  # of so many frames, whose norms that bound sums: 75 s at 3500 Hz


def largest_commands(law: Law, range_v: float) -> FloatArray:
    """Return for each command what no measurement within +-range_v takes it beyond from rest, without limits, `(nu,)`.

    u_i = sum_t h_i(t) y(t), so |u_i| <= range sum_t sum_j |h_ij(t)|. Of the answers after K frames, each block's
    C A^r P^m B with P = A^K is at most |C A^r|_1 |P^m| max|B|, with the largest row sum for |P^m|; infinite where the
    norms of so many P^m do not fall below one.
    """
    rows, blocks = law.C.astype(np.float64), blocks_of(law)
    B = law.B.astype(np.float64)
    answered = np.abs(law.D.astype(np.float64)).sum(axis=1)
    sizes, power = np.zeros((len(rows), len(blocks))), np.repeat(np.eye(2)[None], len(blocks), axis=0)
    for _ in range(FRAMES):
        answered = answered + np.abs(rows @ B).sum(axis=1)
        sizes = sizes + np.abs(rows).reshape(len(rows), -1, 2).sum(axis=2)
        rows, power = turned_by(rows, blocks), power @ blocks
    largest = np.abs(B).reshape(len(blocks), 2, -1).max(axis=1).sum(axis=1)
    start = sizes * largest
    # A block that a command does not see, or that no measurement moves, adds nothing, whatever its norms.
    with np.errstate(invalid="ignore"):
        later = np.where(start > 0, start * _norms(power), 0.0).sum(axis=1)
    return range_v * (answered + later)


def _norms(power: FloatArray) -> FloatArray:
    """Return for each block P a bound on the sum of |P^m|, m from 1 on, infinite where there is none."""
    total, now, norm = np.zeros(len(power)), power, np.ones(len(power))
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(STRETCHES):
            norm = np.abs(now).sum(axis=2).max(axis=1)
            total, now = total + norm, now @ power
    bound = np.full(len(power), np.inf)
    np.divide(total, 1 - norm, out=bound, where=norm < 1)
    return bound


def blocks_of(law: Law) -> FloatArray:
    """Return A in 2x2 blocks, `(blocks, 2, 2)`; in delta form I is added to them."""
    own = np.array(law.blocks, dtype=np.float64).reshape(-1, 2, 2)
    return own + np.eye(2) if law.delta else own


def turned_by(rows: FloatArray, blocks: FloatArray) -> FloatArray:
    """Return rows @ A for A in blocks; each number is a sum of two products, the same with every BLAS.

    >>> turned_by(np.array([1.0, 2.0]), np.array([[[1.0, 2.0], [3.0, 4.0]]])).tolist()
    [7.0, 10.0]
    """
    first, second = rows[..., 0::2, None], rows[..., 1::2, None]
    return (first * blocks[:, 0] + second * blocks[:, 1]).reshape(rows.shape)
