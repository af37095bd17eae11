"""The prediction-error loop, compiled: residual, gradient by filtering, Levenberg-Marquardt, all without the GIL.

The model is A y = sum_j B_j / F_j u_j + C / D e (+ a constant). Polynomials stand in one table `P`, a row each, in the
order a, c, d, b_1, f_1, b_2, f_2, ...; `degree` counts the free coefficients of each row, `lag` the power of q^-1 its
first free coefficient stands at (1 for monic rows, the delay for B). Gradient columns are taken in the delta basis
q^-lag (1 - q^-1)^k instead of bare shifts: at 3.5 kHz shifts of a 12 Hz mode are parallel to four digits, and a normal
matrix of their products would keep none (Jacobian condition 1e8, squared).
"""

import numpy as np

from ultraquiet.identify.compiled import compiled
from ultraquiet.identify.prediction_error.filter_kernels import all_pole, combine, expanded, moving, whiten
from ultraquiet.identify.prediction_error.normal_kernels import (
    BLAS_SERIAL,
    RIDGE,
    back_substitute,
    damped_step,
    eliminate,
    gram,
    reduced,
    unit_diagonal,
)

__all__ = [
    "BLAS_SERIAL",
    "RIDGE",
    "all_pole",
    "damped_step",
    "evaluate",
    "expanded",
    "gram",
    "normal_matrix",
    "reduced",
    "search",
    "unit_diagonal",
]

ROW_A, ROW_C, ROW_D, ROW_FIRST = 0, 1, 2, 3
WITHIN = 1 - 1e-6  # roots nearer to the circle are beyond the recursion's own rounding, and any record's length
INNER_TRIES = 14
STALLED_STEPS = 3


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
def paths(u, P, degree, lag, driven, parts):
    """Write u_j / F_j into `driven` and B_j / F_j u_j into `parts`."""
    for j in range(u.shape[0]):
        b, f = ROW_FIRST + 2 * j, ROW_FIRST + 2 * j + 1
        all_pole(u[j], P[f], degree[f], driven[j])
        moving(driven[j], P[b], degree[b], lag[b], parts[j])


@compiled
def evaluate(u, y, P, degree, lag, states, signals, driven, parts, rest, e, known=None):
    """Fill paths, y's unexplained part `rest` and residual `e`, nuisance eliminated; return the loss.

    The first rows of `signals` are left holding the nuisance columns and `known` their products, which `normal_matrix`
    takes over.
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
        G = gram(signals[: made + 1], lags[: made + 1], counts[: made + 1], np.zeros((0, 0)))
        q = G.shape[0] - 1
        if known is not None:
            known[:] = G[:q, :q]
        M, scale = unit_diagonal(G)
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
def normal_matrix(y, P, degree, lag, free, states, signals, driven, parts, rest, e, known=None):
    """Return the products of nuisance, gradient and residual columns, in this order, and the nuisance count q."""
    total = signals.shape[0]
    lags, counts = np.zeros(total, np.int64), np.zeros(total, np.int64)
    at = count_nuisance(states, counts)
    q = counts[:at].sum()
    inner = np.empty(y.size)
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
            all_pole(parts[(row - ROW_FIRST) // 2], P[row], degree[row], inner)
            whiten(inner, P, degree, signals[at])
        lags[at], counts[at] = lag[row], degree[row]
        at += 1
    signals[at] = e
    counts[at] = 1
    held = np.zeros((0, 0)) if known is None else known
    return gram(signals[: at + 1], lags[: at + 1], counts[: at + 1], held), q


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
        out[row, first : first + degree[row]] += expanded(step[at : at + degree[row]])
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
def search(u, y, start, degree, lag, free, states, max_iterations, tolerance, damping=1e-3):
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
    known, known2 = np.zeros((states.sum(), states.sum())), np.zeros((states.sum(), states.sum()))
    loss = evaluate(u, y, P, degree, lag, states, signals, driven, parts, rest, e, known)
    state, small, iterations = 0, 0, 0
    S = np.zeros((1, 1))
    while state == 0:
        G, q = normal_matrix(y, P, degree, lag, free, states, signals, driven, parts, rest, e, known)
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
                better = evaluate(u, y, trial, degree, lag, states, signals, driven2, parts2, rest2, e2, known2)
            if better < loss:
                gain = n * (loss - better)
                factor = 0.1 if gain > 0.75 * promised else (0.5 if gain > 0.25 * promised else 2.0)
                damping = max(1e-12, damping * factor)
                small = small + 1 if gain <= tolerance * loss else 0
                P, loss, state = trial, better, 0
                driven, driven2, parts, parts2 = driven2, driven, parts2, parts
                rest, rest2, e, e2, known, known2 = rest2, rest, e2, e, known2, known
                break
            damping = max(damping, 1e-9) * 6.0
        iterations += 1
    return P, loss, e, S, iterations, state
