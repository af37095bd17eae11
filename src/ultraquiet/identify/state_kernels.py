"""Compiled sums for state-space models: Gram matrices of Hankel data and of filter banks, in one pass."""

import numpy as np

from ultraquiet.identify.kernels import FLUSH, compiled

MODAL_BLOCK = 2048  # samples of a filter bank held at once


@compiled
def hankel_gram(z, rows):
    """Return the Gram matrix of the block Hankel matrix of z `(m, n)` with `rows` block rows.

    Shifting both factors by one sample changes a product by its two end terms, so only the first block row is summed.
    """
    m, n = z.shape
    columns = n - rows + 1
    G = np.empty((rows * m, rows * m))
    for j in range(rows):
        for a in range(m):
            for b in range(m):
                s = np.dot(z[a, :columns], z[b, j : j + columns])
                G[a, j * m + b], G[j * m + b, a] = s, s
    for i in range(1, rows):
        for j in range(i, rows):
            for a in range(m):
                for b in range(m):
                    s = G[(i - 1) * m + a, (j - 1) * m + b]
                    s += z[a, columns + i - 1] * z[b, columns + j - 1] - z[a, i - 1] * z[b, j - 1]
                    G[i * m + a, j * m + b], G[j * m + b, i * m + a] = s, s
    return G


@compiled
def modal_gram(poles, u, tail):
    """Return the products of Re, Im of u_j / (1 - p_k q^-1), for all k and j, and of the rows of `tail`, by blocks."""
    inputs, n = u.shape
    first = 2 * poles.size * inputs
    width = first + tail.shape[0]
    out = np.zeros((width, width))
    size = min(n, MODAL_BLOCK)
    block = np.zeros((width, size))
    state = np.zeros((poles.size, inputs), np.complex128)
    for start in range(0, n, size):
        stop = min(n, start + size)
        block[:, stop - start :] = 0.0
        for k in range(poles.size):
            for j in range(inputs):
                at = 2 * (k * inputs + j)
                x = state[k, j]
                for t in range(start, stop):
                    x = poles[k] * x + u[j, t]
                    if abs(x.real) + abs(x.imag) < FLUSH:
                        x = 0.0 + 0.0j
                    block[at, t - start] = x.real
                    block[at + 1, t - start] = x.imag
                state[k, j] = x
        block[first:, : stop - start] = tail[:, start:stop]
        out += np.dot(block, block.T)
    return out
