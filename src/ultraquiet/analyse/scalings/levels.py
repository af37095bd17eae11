"""Balancing of blocks: levels that make what enters each block as large as what leaves it."""

import numpy as np

from ultraquiet.linalg.ordered import Array

SWEEPS = 30
SETTLED = 1e-3  # change of a level at which balancing may stop: it only prepares
NEGLIGIBLE = 1e-10  # what one-way paths are scaled down to, relative to paths that return


def balanced_levels(power: Array) -> Array:
    """Return log d `(nf, blocks)` such that d_b / d_c weighs the path from block c to b.

    Osborne's iteration. Where some paths never return (a matrix that is triangular after reordering) no balance
    exists: such paths are scaled down until they count for nothing, which is the limit that D approaches.

    Args:
        power: `(nf, blocks, blocks)` squared Frobenius norms of the paths, from column to row.
    """
    count = power.shape[1]
    power = power * (1 - np.eye(count))
    if np.all((power > 0) | np.eye(count, dtype=bool)):
        return _osborne(power)  # as almost always: every path is there, and returns
    x = np.zeros(power.shape[:2])
    patterns, kind = np.unique((power > 0).reshape(power.shape[0], -1), axis=0, return_inverse=True)
    for k, pattern in enumerate(patterns):
        here = np.flatnonzero(kind.reshape(-1) == k)
        returns, order = _components(pattern.reshape(count, count))
        x[here] = _osborne(power[here] * returns) + _apart(power[here], returns, order)
    return x


def _osborne(power: Array) -> Array:
    x = np.zeros(power.shape[:2])
    left = np.arange(len(power))
    for _ in range(SWEEPS):
        rows, columns = power.sum(axis=2), power.sum(axis=1)
        safe = (rows > 0) & (columns > 0)
        change = np.where(safe, 0.125 * np.log(np.where(safe, columns, 1) / np.where(safe, rows, 1)), 0.0)
        x[left] += change
        moving = np.abs(change).max(axis=1, initial=0.0) >= SETTLED
        if not moving.any():
            break
        left, factor = left[moving], np.exp(2 * change[moving])
        power = power[moving] * factor[:, :, None] / factor[:, None, :]
    return x


def _components(pattern: Array) -> tuple[Array, Array]:
    """Return which paths return `(blocks, blocks)`, and how far down its one-way chain each block stands."""
    reach = pattern | np.eye(len(pattern), dtype=bool)
    for _ in range(len(pattern)):
        further = (reach.astype(int) @ reach.astype(int)) > 0
        if np.array_equal(further, reach):
            break
        reach = further
    returns = reach & reach.T
    # the number of blocks that can be reached into a block grows along every one-way path
    return returns.astype(float), reach.sum(axis=1).astype(float)


def _apart(power: Array, returns: Array, order: Array) -> Array:
    """Return levels that fall along one-way paths, steeply enough to make them negligible."""
    if returns.all():
        return np.zeros(power.shape[:2])
    steps = np.unique(order, return_inverse=True)[1].astype(float)
    balanced = _osborne(power * returns)
    size = np.exp(2 * (balanced[:, :, None] - balanced[:, None, :])) * power
    one_way = np.maximum((size * (1 - returns)).max(axis=(1, 2)), np.finfo(float).tiny)
    returning = (size * returns).max(axis=(1, 2))
    scale = np.where(returning > 0, returning, one_way)
    gap = 0.5 * np.log(np.maximum(one_way / scale, 1.0)) - np.log(NEGLIGIBLE)
    return -gap[:, None] * steps
