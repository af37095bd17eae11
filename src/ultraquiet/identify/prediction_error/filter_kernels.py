"""Filters of the prediction-error loop, compiled: recursive and moving sums whose taps stay in registers.

A recursive filter waits for its own last sample, seven cycles at least; all else must hide behind that wait. With a
fixed number of taps, missing ones zero, states and coefficients never leave the registers and the wait is all that is
left: a third of the time of a loop over taps, for any order up to REGISTERS.
"""

import numpy as np

from ultraquiet.identify.compiled import FLUSH, compiled

ROW_C, ROW_D = 1, 2
REGISTERS = 8
CHECKED = 64  # samples between two looks for such a tail


@compiled
def all_pole(x, p, order, out):
    """Set out = x / p(q), p monic; the newest sample is used last, which keeps the chain of dependence short."""
    if order == 0:
        out[:] = x
    elif order <= REGISTERS:
        _all_pole_in_registers(x, p, order, out)
    else:
        for t in range(x.size):
            s = x[t]
            for k in range(min(order, t), 0, -1):
                s -= p[k] * out[t - k]
            out[t] = s if abs(s) > FLUSH else 0.0


@compiled
def _all_pole_in_registers(x, p, order, out):
    c = np.zeros(REGISTERS + 1)
    c[1 : order + 1] = p[1 : order + 1]
    c1, c2, c3, c4, c5, c6, c7, c8 = c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]
    y1 = y2 = y3 = y4 = y5 = y6 = y7 = y8 = 0.0
    n = x.size
    for start in range(0, n, CHECKED):
        for t in range(start, min(n, start + CHECKED)):
            s = x[t] - c8 * y8 - c7 * y7 - c6 * y6 - c5 * y5 - c4 * y4 - c3 * y3 - c2 * y2 - c1 * y1
            y8, y7, y6, y5, y4, y3, y2, y1 = y7, y6, y5, y4, y3, y2, y1, s
            out[t] = s
        largest = max(abs(y1), abs(y2), abs(y3), abs(y4), abs(y5), abs(y6), abs(y7), abs(y8))
        if largest < FLUSH:
            y1 = y2 = y3 = y4 = y5 = y6 = y7 = y8 = 0.0


@compiled
def moving(x, p, count, lag, out):
    """Set out = q^-lag (p_0 + p_1 q^-1 + ...) x with `count` coefficients."""
    out[:] = 0.0
    add_moving(x, p, count, lag, 1.0, out)


@compiled
def add_moving(x, p, count, lag, scale, out):
    """Add scale q^-lag (p_0 + p_1 q^-1 + ...) x to out, REGISTERS taps in one pass over the samples."""
    n = x.size
    if lag >= n or count == 0:
        return
    past = np.zeros(n + REGISTERS)
    c = np.empty(REGISTERS)
    for first in range(0, count, REGISTERS):
        used = min(REGISTERS, count - first)
        c[:] = 0.0
        c[:used] = p[first : first + used] * scale
        at = lag + first
        if at >= n:
            return
        past[REGISTERS : REGISTERS + n - at] = x[: n - at]
        _add_taps(past, c, out[at:])


@compiled
def _add_taps(past, c, out):
    """Add sum_k c_k past(t - k) to out; `past` begins REGISTERS samples earlier."""
    c0, c1, c2, c3, c4, c5, c6, c7 = c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7]
    n = out.size
    x0, x1, x2, x3, x4 = past[8 : 8 + n], past[7 : 7 + n], past[6 : 6 + n], past[5 : 5 + n], past[4 : 4 + n]
    x5, x6, x7 = past[3 : 3 + n], past[2 : 2 + n], past[1 : 1 + n]
    for t in range(n):
        out[t] += (c0 * x0[t] + c1 * x1[t] + c2 * x2[t] + c3 * x3[t]) + (
            c4 * x4[t] + c5 * x5[t] + c6 * x6[t] + c7 * x7[t]
        )


@compiled
def expanded(weights):
    """Return the coefficients of sum_k weights[k] (1 - q^-1)^k in powers of q^-1."""
    taps = np.zeros(weights.size)
    for k in range(weights.size):
        binomial = 1.0
        for m in range(k + 1):
            taps[m] += weights[k] * binomial
            binomial *= -(k - m) / (m + 1.0)
    return taps


@compiled
def combine(x, lag, weights, out):
    """Add sum_k weights[k] (1 - q^-1)^k q^-lag x to out: the basis of `normal_kernels.gram`."""
    add_moving(x, expanded(weights), weights.size, lag, 1.0, out)


@compiled
def whiten(x, P, degree, out):
    """Set out = (D / C) x."""
    held = np.empty(x.size)
    moving(x, P[ROW_D], degree[ROW_D] + 1, 0, held)
    all_pole(held, P[ROW_C], degree[ROW_C], out)
