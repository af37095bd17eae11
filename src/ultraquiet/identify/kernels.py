"""The prediction-error loop, compiled: residual, gradient by filtering, Levenberg-Marquardt, all without the GIL.

The model is A y = sum_j B_j / F_j u_j + C / D e (+ a constant). Polynomials stand in one table `P`, a row each, in the
order a, c, d, b_1, f_1, b_2, f_2, ...; `degree` counts the free coefficients of each row, `lag` the power of q^-1 its
first free coefficient stands at (1 for monic rows, the delay for B). Gradient columns are taken in the delta basis
q^-lag (1 - q^-1)^k instead of bare shifts: at 3.5 kHz shifts of a 12 Hz mode are parallel to four digits, and a normal
matrix of their products would keep none (Jacobian condition 1e8, squared).
"""

from typing import Any

import numpy as np
from numba import njit

ROW_A, ROW_C, ROW_D, ROW_FIRST = 0, 1, 2, 3
# OpenBLAS starts threads above 2^18 multiplications; blocks stay below, for the threads belong to whole fits.
BLAS_SERIAL = 200_000
WITHIN = 1 - 1e-6  # roots nearer to the circle are beyond the recursion's own rounding, and any record's length
RIDGE = 1e-13  # on unit-diagonal normal matrices of nuisance columns: keeps elimination finite, moves no kept digit
FLUSH = 1e-140  # its square is still a normal number; denormal tails of decaying responses cost 20 times the work
INNER_TRIES = 14
STALLED_STEPS = 3

compiled: Any = njit(cache=True, nogil=True, fastmath=False)


@compiled
def all_pole(x, p, order, out):
    """Set out = x / p(q), p monic; the newest sample is used last, which keeps the chain of dependence short."""
    for t in range(x.size):
        s = x[t]
        for k in range(min(order, t), 0, -1):
            s -= p[k] * out[t - k]
        out[t] = s if abs(s) > FLUSH else 0.0


@compiled
def moving(x, p, count, lag, out):
    """Set out = q^-lag (p_0 + p_1 q^-1 + ...) x with `count` coefficients."""
    n = x.size
    out[:] = 0.0
    for k in range(count):
        at = lag + k
        c = p[k]
        for t in range(at, n):
            out[t] += c * x[t - at]


@compiled
def inside(p, order):
    """Return whether all roots of monic p (powers of q^-1) lie within WITHIN: the Schur-Cohn recursion."""
    a = p[: order + 1] / WITHIN ** np.arange(order + 1)
    b = np.empty(order + 1)
    for m in range(order, 0, -1):
        k = a[m]
        if not abs(k) < 1.0:
            return False
        scale = 1.0 - k * k
        for i in range(m):
            b[i] = (a[i] - k * a[m - i]) / scale
        a[:m] = b[:m]
    return True


@compiled
def gram(signals, lag, count):
    """Return the products of all columns: signal i shifted by lag[i] and differenced 0..count[i]-1 times."""
    m, n = signals.shape
    width = count.sum()
    out = np.zeros((width, width))
    size = max(16, min(n, BLAS_SERIAL // (width * width)))
    block = np.zeros((width, size))
    carry = np.zeros(width)
    for start in range(0, n, size):
        stop = min(n, start + size)
        used = stop - start
        block[:, used:] = 0.0
        at = 0
        for i in range(m):
            if count[i] == 0:
                continue
            first = min(used, max(0, lag[i] - start))
            block[at, :first] = 0.0
            block[at, first:used] = signals[i, start + first - lag[i] : stop - lag[i]]
            for k in range(at + 1, at + count[i]):
                block[k, 0] = block[k - 1, 0] - carry[k - 1]
                for t in range(1, used):
                    block[k, t] = block[k - 1, t] - block[k - 1, t - 1]
            for k in range(at, at + count[i]):
                carry[k] = block[k, used - 1]
            at += count[i]
        out += np.dot(block, block.T)
    return out


@compiled
def combine(x, lag, weights, out):
    """Add sum_k weights[k] (1 - q^-1)^k q^-lag x to out: the same basis as `gram`."""
    n = x.size
    column = np.zeros(n)
    column[lag:] = x[: n - lag]
    for k in range(weights.size):
        if k > 0:
            for t in range(n - 1, 0, -1):
                column[t] -= column[t - 1]
        for t in range(n):
            out[t] += weights[k] * column[t]


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
def nuisance(P, degree, states, n, signals, count):
    """Write the columns of initial conditions and constant; `states` counts them per row of the table, constant last.

    Past inputs reach the output as a free response x / F_j, the noise filter's past as x / C: both are linear, so they
    are eliminated exactly at every step instead of being taken as zero.
    """
    pulse, held = np.zeros(n), np.empty(n)
    pulse[0] = 1.0
    made = count_nuisance(states, count)
    for at in range(made - 2):
        row = ROW_FIRST + 1 + 2 * at
        if states[row] > 0:
            all_pole(pulse, P[row], degree[row], held)
            whiten(held, P, degree, signals[at])
    if states[ROW_C] > 0:
        all_pole(pulse, P[ROW_C], degree[ROW_C], signals[made - 2])
    if states[P.shape[0]] > 0:
        held[:] = 1.0
        whiten(held, P, degree, signals[made - 1])
    return made


@compiled
def count_nuisance(states, count):
    """Write how many columns each nuisance signal gives (every F, then C, then the constant); return the signals."""
    at = 0
    for row in range(ROW_FIRST + 1, states.size - 1, 2):
        count[at] = states[row]
        at += 1
    count[at], count[at + 1] = states[ROW_C], states[states.size - 1]
    return at + 2


@compiled
def whiten(x, P, degree, out):
    """Set out = (D / C) x."""
    held = np.empty(x.size)
    moving(x, P[ROW_D], degree[ROW_D] + 1, 0, held)
    all_pole(held, P[ROW_C], degree[ROW_C], out)


@compiled
def paths(u, P, degree, lag, driven, parts):
    """Write u_j / F_j into `driven` and B_j / F_j u_j into `parts`."""
    for j in range(u.shape[0]):
        b, f = ROW_FIRST + 2 * j, ROW_FIRST + 2 * j + 1
        all_pole(u[j], P[f], degree[f], driven[j])
        moving(driven[j], P[b], degree[b], lag[b], parts[j])


@compiled
def evaluate(u, y, P, degree, lag, states, signals, driven, parts, rest, e):
    """Fill paths, y's unexplained part `rest` and residual `e`, nuisance eliminated; return the loss.

    The first rows of `signals` are left holding the nuisance columns, which `normal_matrix` takes over.
    """
    nu, n = u.shape
    paths(u, P, degree, lag, driven, parts)
    moving(y, P[ROW_A], degree[ROW_A] + 1, 0, rest)
    for j in range(nu):
        rest -= parts[j]
    whiten(rest, P, degree, e)
    columns = nu + 3
    lags, counts = np.zeros(columns, np.int64), np.zeros(columns, np.int64)
    made = nuisance(P, degree, states, n, signals, counts)
    if counts.sum() > 0:
        signals[made] = e
        counts[made] = 1
        M, scale = unit_diagonal(gram(signals[: made + 1], lags[: made + 1], counts[: made + 1]))
        q = M.shape[0] - 1
        for i in range(q):
            M[i, i] += RIDGE
        eliminate(M, q)
        x = back_substitute(M, q, q)
        for i in range(q):
            x[i] *= scale[i] / scale[q]
        add_back(x, P, degree, signals, counts, made, parts, rest, e)
    return np.dot(e, e) / n


@compiled
def add_back(x, P, degree, signals, counts, made, parts, rest, e):
    """Take the fitted nuisance x out of residual, paths and rest."""
    n = e.size
    pulse, free, held = np.zeros(n), np.zeros(n), np.empty(n)
    pulse[0] = 1.0
    at = 0
    for i in range(made):
        part = x[at : at + counts[i]]
        at += counts[i]
        combine(signals[i], 0, -part, e)
        if counts[i] == 0:
            continue
        if i < parts.shape[0]:
            free[:] = 0.0
            combine(pulse, 0, part, free)
            row = ROW_FIRST + 2 * i + 1
            all_pole(free, P[row], degree[row], held)
            parts[i] += held
            rest -= held
        elif i == made - 1:
            rest -= part[0]


@compiled
def normal_matrix(y, P, degree, lag, free, states, signals, driven, parts, rest, e):
    """Return the products of nuisance, gradient and residual columns, in this order, and the nuisance count q."""
    total = signals.shape[0]
    lags, counts = np.zeros(total, np.int64), np.zeros(total, np.int64)
    at = count_nuisance(states, counts)
    q = counts[:at].sum()
    held = np.empty(y.size)
    for row in gradient_rows(P.shape[0]):
        if not free[row] or degree[row] == 0:
            continue
        if row == ROW_A:
            whiten(y, P, degree, signals[at])
        elif row == ROW_C:
            all_pole(-e, P[ROW_C], degree[ROW_C], signals[at])
        elif row == ROW_D:
            all_pole(rest, P[ROW_C], degree[ROW_C], signals[at])
        elif (row - ROW_FIRST) % 2 == 0:
            whiten(-driven[(row - ROW_FIRST) // 2], P, degree, signals[at])
        else:
            all_pole(parts[(row - ROW_FIRST) // 2], P[row], degree[row], held)
            whiten(held, P, degree, signals[at])
        lags[at], counts[at] = lag[row], degree[row]
        at += 1
    signals[at] = e
    counts[at] = 1
    return gram(signals[: at + 1], lags[: at + 1], counts[: at + 1]), q


@compiled
def gradient_rows(rows):
    """Return the order of the parameters: a, the b and f of each input, c, d."""
    order = np.empty(rows, np.int64)
    order[0] = ROW_A
    order[1 : rows - 2] = np.arange(ROW_FIRST, rows)
    order[rows - 2], order[rows - 1] = ROW_C, ROW_D
    return order


@compiled
def stepped(P, degree, free, step):
    """Return the table moved by a step in the delta basis, expanded to powers of q^-1."""
    out = P.copy()
    at = 0
    for row in gradient_rows(P.shape[0]):
        if not free[row]:
            continue
        first = 1 if row < ROW_FIRST or (row - ROW_FIRST) % 2 == 1 else 0
        for k in range(degree[row]):
            binomial = 1.0
            for m in range(k + 1):
                out[row, first + m] += step[at + k] * binomial
                binomial *= -(k - m) / (m + 1.0)
        at += degree[row]
    return out


@compiled
def admissible(P, degree):
    """Return whether C, D and every F have their roots inside the unit circle."""
    if not (inside(P[ROW_C], degree[ROW_C]) and inside(P[ROW_D], degree[ROW_D])):
        return False
    found = True
    for row in range(ROW_FIRST + 1, P.shape[0], 2):
        found = found and inside(P[row], degree[row])
    return found


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


@compiled
def search(u, y, start, degree, lag, free, states, max_iterations, tolerance):
    """Minimise mean e^2 from `start`; return table, loss, residual, normal matrix, iterations and the state reached.

    State 1: the next step would move the sum of squares by less than `tolerance` innovations' variances (that is, the
    estimate by less than sqrt(tolerance) of its own standard deviation), or STALLED_STEPS steps in a row gained less;
    0: iterations used up; -1: no admissible step gains anything although the gradient promises it.
    """
    nu, n = u.shape
    P = start.copy()
    driven, parts, rest, e = np.zeros((nu, n)), np.zeros((nu, n)), np.zeros(n), np.zeros(n)
    driven2, parts2, rest2, e2 = np.zeros((nu, n)), np.zeros((nu, n)), np.zeros(n), np.zeros(n)
    # Every F's, C's and the constant's column, every gradient row's, the residual's.
    signals = np.zeros((nu + 2 + P.shape[0] + 1, n))
    loss = evaluate(u, y, P, degree, lag, states, signals, driven, parts, rest, e)
    damping, state, small, iterations = 1e-3, 0, 0, 0
    S = np.zeros((1, 1))
    while True:
        G, q = normal_matrix(y, P, degree, lag, free, states, signals, driven, parts, rest, e)
        S = reduced(G, q)
        _, promised = damped_step(S, 0.0)
        if promised <= tolerance * loss or small >= STALLED_STEPS:
            state = 1
        if state != 0 or iterations >= max_iterations or not np.isfinite(loss):
            break
        state = -1
        for _ in range(INNER_TRIES):
            step, promised = damped_step(S, damping)
            trial = stepped(P, degree, free, step)
            better = np.inf
            if admissible(trial, degree):
                better = evaluate(u, y, trial, degree, lag, states, signals, driven2, parts2, rest2, e2)
            if better < loss:
                gain = n * (loss - better)
                factor = 0.1 if gain > 0.75 * promised else (0.5 if gain > 0.25 * promised else 2.0)
                damping = max(1e-12, damping * factor)
                small = small + 1 if gain <= tolerance * loss else 0
                P, loss, state = trial, better, 0
                driven, driven2, parts, parts2 = driven2, driven, parts2, parts
                rest, rest2, e, e2 = rest2, rest, e2, e
                break
            damping = max(damping, 1e-9) * 6.0
        iterations += 1
    return P, loss, e, S, iterations, state
