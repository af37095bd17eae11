"""Normal equations, compiled: products of filtered columns, elimination, the damped step."""

import numpy as np

from ultraquiet.identify.compiled import compiled

# OpenBLAS starts threads above 2^18 multiplications; blocks stay below, for the threads belong to whole fits.
BLAS_SERIAL = 200_000
RIDGE = 1e-13  # on unit-diagonal normal matrices of nuisance columns: keeps elimination finite, moves no kept digit


@compiled
def gram(signals, lag, count, known):
    """Return the products of all columns: signal i shifted by lag[i] and differenced 0..count[i]-1 times.

    `known` holds the products of the first columns among themselves; they are not formed again, nor is the lower half
    of the rest beyond two blocks.
    """
    n = signals.shape[1]
    width, q = count.sum(), known.shape[0]
    half = q + (width - q + 1) // 2
    out = np.zeros((width, width))
    out[:q, :q] = known
    size = max(16, min(n, BLAS_SERIAL // max(1, (width - q) * q, (half - q) ** 2)))
    block = np.zeros((width, size))
    carry = np.zeros(width)
    for start in range(0, n, size):
        stop = min(n, start + size)
        block[:, stop - start :] = 0.0
        fill(block, carry, signals, lag, count, start, stop)
        if q > 0:
            out[q:, :q] += np.dot(block[q:], block[:q].T)
        out[q:half, q:half] += np.dot(block[q:half], block[q:half].T)
        if half < width:
            out[half:, q:half] += np.dot(block[half:], block[q:half].T)
            out[half:, half:] += np.dot(block[half:], block[half:].T)
    for i in range(width):
        for j in range(i):
            out[j, i] = out[i, j]
    return out


@compiled
def fill(block, carry, signals, lag, count, start, stop):
    """Write samples start..stop of all columns into the block; `carry` is each column's last sample before."""
    used, at = stop - start, 0
    for i in range(signals.shape[0]):
        if count[i] == 0:
            continue
        first = min(used, max(0, lag[i] - start))
        block[at, :first] = 0.0
        block[at, first:used] = signals[i, start + first - lag[i] : stop - lag[i]]
        for k in range(at + 1, at + count[i]):
            now, before = block[k], block[k - 1]
            now[0] = before[0] - carry[k - 1]
            for t in range(1, used):
                now[t] = before[t] - before[t - 1]
        for k in range(at, at + count[i]):
            carry[k] = block[k, used - 1]
        at += count[i]


@compiled
def eliminate(M, q):
    """Eliminate the first q unknowns of a symmetric matrix in place (Cholesky); row k keeps its factor."""
    size = M.shape[0]
    for k in range(q):
        pivot = np.sqrt(max(M[k, k], RIDGE))
        for j in range(k, size):
            M[k, j] /= pivot
        M[k, k] = pivot
        for i in range(k + 1, size):
            f = M[k, i]
            for j in range(i, size):
                M[i, j] -= f * M[k, j]
    for i in range(q, size):
        for j in range(i):
            M[i, j] = M[j, i]


@compiled
def unit_diagonal(G):
    """Return the matrix scaled to unit diagonal and the scale (one over the size of each column)."""
    size = G.shape[0]
    scale = np.empty(size)
    for i in range(size):
        scale[i] = 1.0 / np.sqrt(G[i, i]) if G[i, i] > 0.0 else 1.0
    M = np.empty_like(G)
    for i in range(size):
        for j in range(size):
            M[i, j] = G[i, j] * scale[i] * scale[j]
    return M, scale


@compiled
def back_substitute(M, q, column):
    """Return x of R x = M[:q, column] for the factor R in the first q rows of M."""
    x = np.zeros(q)
    for i in range(q - 1, -1, -1):
        s = M[i, column]
        for j in range(i + 1, q):
            s -= M[i, j] * x[j]
        x[i] = s / M[i, i]
    return x


@compiled
def reduced(G, q):
    """Return the normal matrix [J e]'[J e] after the q nuisance columns are eliminated."""
    M, scale = unit_diagonal(G)
    for i in range(q):
        M[i, i] += RIDGE
    eliminate(M, q)
    S = M[q:, q:].copy()
    for i in range(S.shape[0]):
        for j in range(S.shape[0]):
            S[i, j] /= scale[q + i] * scale[q + j]
    return S


@compiled
def damped_step(S, damping):
    """Return the step for S = [J e]'[J e] under relative damping, and the decrease of e'e the linear model promises."""
    M, scale = unit_diagonal(S)
    p = M.shape[0] - 1
    for i in range(p):
        M[i, i] += damping + RIDGE
    eliminate(M, p)
    x = back_substitute(M, p, p)
    promised = 0.0
    for i in range(p):
        promised += M[i, p] * M[i, p] + damping * x[i] * x[i]
        x[i] *= -scale[i] / scale[p]
    return x, promised / (scale[p] * scale[p])
