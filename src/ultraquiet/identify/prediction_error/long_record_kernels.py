"""One pass of the prediction-error loop over a record in blocks: filters keep their past from cell to cell.

Same model, table and delta basis as `kernels`. Every signal stands in a row of the workspace behind a head that holds
the end of the cell before; a filter that reaches back finds its own past there. The past before the record is not
projected out of each signal, which would need the record twice: it is a vector x of unknowns whose columns enter the
normal matrix beside the gradient's, and whose free responses are driven by pulses at the first sample.
"""

import numpy as np

from ultraquiet.identify.compiled import FLUSH, compiled
from ultraquiet.identify.prediction_error.kernels import (
    BLAS_SERIAL,
    RIDGE,
    ROW_A,
    ROW_C,
    ROW_D,
    ROW_FIRST,
    gradient_rows,
    unit_diagonal,
)

GONE = 1e-18  # a free response that has decayed to this share of its peak adds nothing more to any sum
LONGEST_CELL = 1024


@compiled
def all_pole(x, p, order, out, first, stop):
    """Set out = x / p(q) from `first`; what stands before it is the filter's past."""
    for t in range(first, stop):
        s = x[t]
        for k in range(order, 0, -1):
            s -= p[k] * out[t - k]
        out[t] = s if abs(s) > FLUSH else 0.0


@compiled
def moving(x, p, count, lag, out, first, stop):
    """Set out = q^-lag (p_0 + p_1 q^-1 + ...) x from `first`."""
    for t in range(first, stop):
        out[t] = 0.0
    for k in range(count):
        c, at = p[k], lag + k
        for t in range(first, stop):
            out[t] += c * x[t - at]


@compiled
def whiten(x, P, degree, held, out, first, stop):
    """Set out = (D / C) x from `first`."""
    moving(x, P[ROW_D], degree[ROW_D] + 1, 0, held, first, stop)
    all_pole(held, P[ROW_C], degree[ROW_C], out, first, stop)


@compiled
def pulses(x, at, count, out, offset, first, stop):
    """Add to out the pulses at the record's first samples whose delta basis holds x[at : at + count]."""
    for k in range(count):
        binomial = 1.0
        for m in range(k + 1):
            t = first + m - offset
            if first <= t < stop:
                out[t] += x[at + k] * binomial
            binomial *= -(k - m) / (m + 1.0)


@compiled
def plan(degree, lag, free, states):
    """Return row, lag and count of each signal that gives columns: nuisance (F, C, constant), gradient, residual.

    Rows of the workspace: u, y, u/F, B u/F, free responses, rest, e, one, then a pair (x/F, whitened) per F, x/C and
    the constant whitened, then one row for each row of the table, one held and one for F's inner filter.
    """
    nu = (degree.size - ROW_FIRST) // 2
    total = nu + 2 + degree.size + 1
    row, lags, counts = np.zeros(total, np.int64), np.zeros(total, np.int64), np.zeros(total, np.int64)
    base = 4 * nu + 4
    at = 0
    for j in range(nu):
        row[at], counts[at] = base + 2 * j + 1, states[ROW_FIRST + 1 + 2 * j]
        at += 1
    row[at], counts[at] = base + 2 * nu, states[ROW_C]
    row[at + 1], counts[at + 1] = base + 2 * nu + 1, states[states.size - 1]
    at += 2
    gradient = base + 2 * nu + 2
    for r in gradient_rows(degree.size):
        row[at], lags[at] = gradient + r, lag[r]
        counts[at] = degree[r] if free[r] else 0
        at += 1
    row[at], counts[at] = 4 * nu + 2, 1
    return row, lags, counts


@compiled
def rows_needed(table_rows):
    """Return the rows of the workspace."""
    nu = (table_rows - ROW_FIRST) // 2
    return 4 * nu + 4 + 2 * nu + 2 + table_rows + 1 + nu


@compiled
def advance(u, y, P, degree, lag, free, states, x, head, work, alive, peak, done, G, e):
    """Filter one block, add its products to G and write its residual to e.

    `done` holds the samples before this block, and how many of them the workspace still has behind its head.
    """
    row, lags, counts = plan(degree, lag, free, states)
    cell = work.shape[1] - head
    for start in range(0, y.size, cell):
        used = min(cell, y.size - start)
        for r in range(work.shape[0]):
            for t in range(head):
                work[r, t] = work[r, t + done[1]]
        stop, nu = head + used, u.shape[0]
        work[:nu, head:stop] = u[:, start : start + used]
        work[nu, head:stop] = y[start : start + used]
        _model(P, degree, lag, states, x, work, alive, peak, done[0], head, stop)
        _gradient(P, degree, free, work, nu, head, stop)
        e[start : start + used] = work[4 * nu + 2, head:stop]
        _products(work, row, lags, counts, alive, head, stop, G)
        done[0] += used
        done[1] = used


@compiled
def _model(P, degree, lag, states, x, work, alive, peak, begun, head, stop):
    """Fill paths, rest, residual and the columns of the past for one cell."""
    nu = (degree.size - ROW_FIRST) // 2
    driven, parts, free = nu + 1, 2 * nu + 1, 3 * nu + 1
    rest, e, one, base = 4 * nu + 1, 4 * nu + 2, 4 * nu + 3, 4 * nu + 4
    held = work.shape[0] - nu - 1
    at = 0
    moving(work[nu], P[ROW_A], degree[ROW_A] + 1, 0, work[rest], head, stop)
    for j in range(nu):
        b, f = ROW_FIRST + 2 * j, ROW_FIRST + 2 * j + 1
        all_pole(work[j], P[f], degree[f], work[driven + j], head, stop)
        moving(work[driven + j], P[b], degree[b], lag[b], work[parts + j], head, stop)
        if alive[j]:
            work[held, head:stop] = 0.0
            pulses(x, at, states[f], work[held], begun, head, stop)
            all_pole(work[held], P[f], degree[f], work[free + j], head, stop)
            work[parts + j, head:stop] += work[free + j, head:stop]
            _impulse(work[held], begun, head, stop)
            all_pole(work[held], P[f], degree[f], work[base + 2 * j], head, stop)
            whiten(work[base + 2 * j], P, degree, work[held], work[base + 2 * j + 1], head, stop)
            _fade(work, base + 2 * j, base + 2 * j + 1, free + j, alive, peak, j, head, stop)
        work[rest, head:stop] -= work[parts + j, head:stop]
        at += states[f]
    constant = states[states.size - 1] > 0
    if constant:
        work[rest, head:stop] -= x[at + states[ROW_C]]
        work[one, head:stop] = 1.0
        whiten(work[one], P, degree, work[held], work[base + 2 * nu + 1], head, stop)
    moving(work[rest], P[ROW_D], degree[ROW_D] + 1, 0, work[held], head, stop)
    if alive[nu]:
        pulses(-x, at, states[ROW_C], work[held], begun, head, stop)
    all_pole(work[held], P[ROW_C], degree[ROW_C], work[e], head, stop)
    if alive[nu]:
        _impulse(work[held], begun, head, stop)
        all_pole(work[held], P[ROW_C], degree[ROW_C], work[base + 2 * nu], head, stop)
        _fade(work, base + 2 * nu, base + 2 * nu, base + 2 * nu, alive, peak, nu, head, stop)


@compiled
def _impulse(out, begun, head, stop):
    out[head:stop] = 0.0
    if begun == 0:
        out[head] = 1.0


@compiled
def _fade(work, first, second, third, alive, peak, k, head, stop):
    """Drop free responses once they have decayed: their rows become zero for good."""
    size = max(np.abs(work[first, head:stop]).max(), np.abs(work[second, head:stop]).max())
    peak[k] = max(peak[k], size)
    if size < GONE * peak[k]:
        alive[k] = False
        work[first] = 0.0
        work[second] = 0.0
        work[third] = 0.0


@compiled
def _gradient(P, degree, free, work, nu, head, stop):
    """Fill the filtered signals whose shifts are minus the gradient, as `kernels.normal_matrix`."""
    driven, parts, rest, e = nu + 1, 2 * nu + 1, 4 * nu + 1, 4 * nu + 2
    first = 4 * nu + 4 + 2 * nu + 2
    held = work.shape[0] - nu - 1
    for r in range(degree.size):
        if not free[r] or degree[r] == 0:
            continue
        out = work[first + r]
        if r == ROW_A:
            whiten(work[nu], P, degree, work[held], out, head, stop)
        elif r == ROW_C:
            for t in range(head, stop):
                work[held, t] = -work[e, t]
            all_pole(work[held], P[ROW_C], degree[ROW_C], out, head, stop)
        elif r == ROW_D:
            all_pole(work[rest], P[ROW_C], degree[ROW_C], out, head, stop)
        elif (r - ROW_FIRST) % 2 == 0:
            j = (r - ROW_FIRST) // 2
            whiten(work[driven + j], P, degree, work[held], out, head, stop)
            # The sign is put on in `_products`: a filter's own past must keep it.
        else:
            j = (r - ROW_FIRST) // 2
            inner = work[held + 1 + j]
            all_pole(work[parts + j], P[r], degree[r], inner, head, stop)
            whiten(inner, P, degree, work[held], out, head, stop)


@compiled
def _products(work, row, lags, counts, alive, head, stop, G):
    """Add the products of all columns of one cell to G, those that have died away left out."""
    nu = alive.size - 1
    deepest = counts.max()
    used = stop - head
    width = counts.sum()
    block = np.zeros((width, deepest + used))
    slot = np.zeros(width, np.int64)
    made, at = 0, 0
    for i in range(row.size):
        if i <= nu and not alive[i]:
            at += counts[i]
            continue
        sign = -1.0 if nu + 2 < i < row.size - 3 and (i - nu - 3) % 2 == 0 else 1.0
        if counts[i] > 0:
            source = work[row[i], head - lags[i] - deepest : stop - lags[i]]
            for t in range(source.size):
                block[made, t] = sign * source[t]
            slot[made] = at
        for k in range(1, counts[i]):
            for t in range(k, deepest + used):
                block[made + k, t] = block[made + k - 1, t] - block[made + k - 1, t - 1]
            slot[made + k] = at + k
        made += counts[i]
        at += counts[i]
    block[:, :deepest] = 0.0
    S = np.dot(block[:made], block[:made].T)
    for a in range(made):
        for b in range(made):
            G[slot[a], slot[b]] += S[a, b]


@compiled
def past(G, q, step):
    """Return the change of the q unknowns of the past that goes with a step of the parameters."""
    M, scale = unit_diagonal(G)
    p = G.shape[0] - q - 1
    right = np.empty(q)
    for i in range(q):
        right[i] = M[i, q + p]
        for k in range(p):
            right[i] += M[i, q + k] * step[k] * scale[q + p] / scale[q + k]
    N = M[:q, :q].copy()
    for i in range(q):
        N[i, i] += np.sqrt(RIDGE)
    found = np.linalg.solve(N, right)
    return found * scale[:q] / scale[q + p]


@compiled
def cell_length(width):
    """Return how many samples are filtered at once: what products stay within the cache and one BLAS thread."""
    return min(LONGEST_CELL, max(64, BLAS_SERIAL // (width * width)))
