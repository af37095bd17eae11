"""Compiled sums for state-space models: Gram matrices of Hankel data and of filter banks, in one pass."""

import numpy as np

from ultraquiet._base.compiled import FLUSH, compiled
from ultraquiet._base.compiled_arrays import copy_matrix

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
        copy_matrix(tail[:, start:stop], block[first:, : stop - start])
        out += np.dot(block, block.T)
    return out


@compiled
def sensitivity_gram(tau, sigma, kappa, b, c, direct, u, tail, y):
    """Return the products of all that a model of second-order blocks depends on, and of its errors, in one pass.

    Block k has A = [[tau, sigma], [kappa sigma, tau]], input rows b[k] `(2, J)` and output columns c[:, k] `(ny, 2)`;
    y = sum_k c_k x_k + direct tail + e. Rows of the result, for each block: g_1, h_1, ..., g_J, h_J with
    x_k = sum_j (b1 g + b2 h, b2 g + kappa b1 h), then the derivatives of x_k by tau and by kappa, two each; then
    `tail`; then e. `u` enters one sample late.
    """
    inputs, n = u.shape
    ny, blocks = c.shape[0], c.shape[1]
    high = 2 * inputs + 4
    first = blocks * high
    errors = first + tail.shape[0]
    width = errors + ny
    out = np.zeros((width, width))
    size = min(n, MODAL_BLOCK)
    rows = np.zeros((width, size))
    flat = np.ascontiguousarray(c).reshape(ny, 2 * blocks)
    x = np.zeros((2 * blocks, size))
    state = np.zeros((blocks, inputs, 2))
    slope = np.zeros((blocks, 4))
    last = np.zeros((blocks, 2))
    for start in range(0, n, size):
        length = min(n, start + size) - start
        rows[:, length:] = 0.0
        for k in range(blocks):
            t0, s0, k0 = tau[k], sigma[k], kappa[k]
            x[2 * k], x[2 * k + 1] = 0.0, 0.0
            for j in range(inputs):
                at = k * high + 2 * j
                g, h = state[k, j, 0], state[k, j, 1]
                b1, b2 = b[k, 0, j], b[k, 1, j]
                for t in range(length):
                    g, h = t0 * g + k0 * s0 * h + u[j, start + t], t0 * h + s0 * g
                    if abs(g) + abs(h) < FLUSH:
                        g, h = 0.0, 0.0
                    rows[at, t] = g
                    rows[at + 1, t] = h
                    x[2 * k, t] += b1 * g + b2 * h
                    x[2 * k + 1, t] += b2 * g + k0 * b1 * h
                state[k, j, 0], state[k, j, 1] = g, h
            at = k * high + 2 * inputs
            q1, q2, v1, v2 = slope[k]
            x1, x2 = last[k]
            for t in range(length):
                q1, q2 = t0 * q1 + s0 * q2 + x1, k0 * s0 * q1 + t0 * q2 + x2
                v1, v2 = t0 * v1 + s0 * v2, k0 * s0 * v1 + t0 * v2 + s0 * x1
                if abs(q1) + abs(q2) + abs(v1) + abs(v2) < FLUSH:
                    q1, q2, v1, v2 = 0.0, 0.0, 0.0, 0.0
                x1, x2 = x[2 * k, t], x[2 * k + 1, t]
                rows[at, t], rows[at + 1, t] = q1, q2
                rows[at + 2, t], rows[at + 3, t] = v1, v2
            slope[k, 0], slope[k, 1], slope[k, 2], slope[k, 3] = q1, q2, v1, v2
            last[k, 0], last[k, 1] = x1, x2
        copy_matrix(tail[:, start : start + length], rows[first:errors, :length])
        said = np.dot(flat, x) + np.dot(direct, rows[first:errors])
        for i in range(ny):
            for t in range(length):
                rows[errors + i, t] = y[i, start + t] - said[i, t]
        out += np.dot(rows, rows.T)
    return out
