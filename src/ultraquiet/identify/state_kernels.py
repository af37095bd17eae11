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


@compiled
def sensitivity_gram(poles, b, c, direct, u, tail, y):
    """Return the products of all that a modal model depends on, and of its errors, in one pass by blocks.

    The model is y_i = Re(sum_k c_ik x_k) + sum_d direct_id tail_d + e_i, x_k = sum_j b_kj s_kj, s_kj = u_j / (1 - p_k
    q^-1). The rows are, for each mode, Re, Im of s_k1, ..., s_kJ and of r_k = q^-1 x_k / (1 - p_k q^-1), the derivative
    of x_k by p_k; then `tail`; then e.
    """
    inputs, n = u.shape
    ny, modes = c.shape
    high = 2 * (inputs + 1)
    first = modes * high
    errors = first + tail.shape[0]
    width = errors + ny
    out = np.zeros((width, width))
    size = min(n, MODAL_BLOCK)
    block = np.zeros((width, size))
    real, imaginary = np.ascontiguousarray(c.real), np.ascontiguousarray(c.imag)
    x, ix = np.zeros((modes, size)), np.zeros((modes, size))
    state = np.zeros((modes, inputs), np.complex128)
    slope = np.zeros(modes, np.complex128)
    last = np.zeros(modes, np.complex128)
    for start in range(0, n, size):
        length = min(n, start + size) - start
        block[:, length:] = 0.0
        for k in range(modes):
            p = poles[k]
            x[k], ix[k] = 0.0, 0.0
            for j in range(inputs):
                at = k * high + 2 * j
                s, gain = state[k, j], b[k, j]
                for t in range(length):
                    s = p * s + u[j, start + t]
                    if abs(s.real) + abs(s.imag) < FLUSH:
                        s = 0.0 + 0.0j
                    block[at, t] = s.real
                    block[at + 1, t] = s.imag
                    x[k, t] += gain.real * s.real - gain.imag * s.imag
                    ix[k, t] += gain.real * s.imag + gain.imag * s.real
                state[k, j] = s
            at = k * high + 2 * inputs
            r, before = slope[k], last[k]
            for t in range(length):
                r = p * r + before
                if abs(r.real) + abs(r.imag) < FLUSH:
                    r = 0.0 + 0.0j
                before = complex(x[k, t], ix[k, t])
                block[at, t] = r.real
                block[at + 1, t] = r.imag
            slope[k], last[k] = r, before
        block[first:errors, :length] = tail[:, start : start + length]
        said = np.dot(real, x) - np.dot(imaginary, ix)
        known = np.dot(direct, block[first:errors])
        block[errors:, :length] = y[:, start : start + length] - said[:, :length] - known[:, :length]
        out += np.dot(block, block.T)
    return out
