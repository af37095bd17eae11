"""Normal equations, compiled: products of filtered columns, elimination, the damped step."""

import numpy as np

from ultraquiet._base.compiled import brief, compiled

# OpenBLAS starts threads above 2^18 multiplications; blocks stay below, for the threads belong to whole fits.
BLAS_SERIAL = 200_000
RIDGE = 1e-13  # on unit-diagonal normal matrices of nuisance columns: keeps elimination finite, moves no kept digit


@compiled
def add_products(work, columns, q, first, stop, out):
    """Add to `out` the products over samples first..stop of all columns, those of the first q among themselves left.

    Each row of `columns` is (row of the workspace, lag, count, sign): the signal shifted by the lag and differenced
    0..count-1 times. Products beyond two blocks' lower half are mirrored, not formed.
    """
    width, n = out.shape[0], stop - first
    half = q + (width - q + 1) // 2
    size = max(16, min(n, BLAS_SERIAL // max(1, (width - q) * q, (half - q) ** 2)))
    block = np.empty((width, size))
    carry = np.zeros(width)  # each column's last sample before the block
    last_differences(work, columns, first, carry)
    for start in range(first, stop, size):
        used = min(stop - start, size)
        fill(block, carry, work, columns, start, used)
        # Those of the first q with the rest, the rest in two halves.
        for part in range(4):
            r0, r1, c0, c1 = q, width, 0, q
            if part == 1:
                r1, c0, c1 = half, q, half
            elif part == 2:
                r0, c0, c1 = half, q, half
            elif part == 3:
                r0, c0, c1 = half, half, width
            if r1 > r0 and c1 > c0:
                S = np.dot(block[r0:r1], block[c0:c1].T)
                for a in range(r1 - r0):
                    for b in range(c1 - c0):
                        out[r0 + a, c0 + b] += S[a, b]
    for i in range(width):
        for j in range(i):
            out[j, i] = out[i, j]


@compiled
def last_differences(work, columns, first, carry):
    """Write the value of each column just before sample `first`."""
    at = 0
    for i in range(columns.shape[0]):
        row, lag, count, sign = columns[i, 0], columns[i, 1], columns[i, 2], columns[i, 3]
        for k in range(count):
            carry[at + k] = sign * work[row, first - 1 - lag - k]
        for k in range(1, count):
            for m in range(count - 1, k - 1, -1):
                carry[at + m] = carry[at + m - 1] - carry[at + m]
        at += count


@compiled
def fill(block, carry, work, columns, start, used):
    """Write `used` samples from `start` of all columns into the block, zeros behind them."""
    at = 0
    for i in range(columns.shape[0]):
        lag, count, sign = columns[i, 1], columns[i, 2], float(columns[i, 3])
        if count == 0:
            continue
        source, first = work[columns[i, 0], start - lag : start - lag + used], block[at]
        for t in range(used):
            first[t] = sign * source[t]
        for k in range(at + 1, at + count):
            now, before, later = block[k, 1:], block[k - 1], block[k - 1, 1:]
            block[k, 0] = before[0] - carry[k - 1]
            for t in range(used - 1):
                now[t] = later[t] - before[t]
        for k in range(at, at + count):
            carry[k] = block[k, used - 1]
            for t in range(used, block.shape[1]):
                block[k, t] = 0.0
        at += count


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
def eliminated(G, q, damping):
    """Return G scaled to unit diagonal with its first q unknowns eliminated under damping, and the scale."""
    size = G.shape[0]
    scale = np.empty(size)
    for i in range(size):
        scale[i] = 1.0 / np.sqrt(G[i, i]) if G[i, i] > 0.0 else 1.0
    M = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            M[i, j] = G[i, j] * scale[i] * scale[j]
    for i in range(q):
        M[i, i] += damping + RIDGE
    eliminate(M, q)
    return M, scale


@brief
def reduced(G, q):
    """Return the normal matrix [J e]'[J e] after the q nuisance columns are eliminated."""
    M, scale = eliminated(G, q, 0.0)
    p = G.shape[0] - q
    S = np.empty((p, p))
    for i in range(p):
        for j in range(p):
            S[i, j] = M[q + i, q + j] / (scale[q + i] * scale[q + j])
    return S


@brief
def damped_step(S, damping):
    """Return the step for S = [J e]'[J e] under relative damping, and the decrease of e'e the linear model promises."""
    p = S.shape[0] - 1
    M, scale = eliminated(S, p, damping)
    x = np.zeros(p)
    promised = 0.0
    for i in range(p - 1, -1, -1):
        s = M[i, p]
        for j in range(i + 1, p):
            s -= M[i, j] * x[j]
        x[i] = s / M[i, i]
    for i in range(p):
        promised += M[i, p] * M[i, p] + damping * x[i] * x[i]
        x[i] *= -scale[i] / scale[p]
    return x, promised / (scale[p] * scale[p])
