"""One step of the recursive prediction-error method, compiled: predict, differentiate, rotate, solve, stay stable.

Table, rows and delta basis are those of `kernels`. The information of all samples stands in a triangular R and a right
side z, R theta = z, brought up to date by Givens rotations: its condition is that of the gradient, not its square, and
no covariance is ever subtracted from, so that none can turn indefinite.
"""

import numpy as np

from ultraquiet._base.compiled import compiled
from ultraquiet._base.compiled_arrays import copy_matrix, copy_vector
from ultraquiet.identify.prediction_error.kernels.table import ROW_A, ROW_C, ROW_D, ROW_FIRST, admissible, gradient_rows

EXPONENTIAL, DIRECTIONAL = 0, 1
HALVINGS = 6  # of a step that would leave the stable region, before it is dropped
# Forgetting alone leaves no less than this share of the most information there ever was: the standard deviations of a
# plant at rest grow tenfold and no further, however long it rests.
FLOOR = 1e-2
# Of a column of R, what the columns before it leave; less is rounding, and a step along it would be as well.
TOLD = 1e-14
LOOK = 64  # samples between looks at how much information there is


@compiled
def past(x, p, order, i):
    """Return sum_{k=1}^{order} p_k x(i - k)."""
    s = 0.0
    for k in range(1, order + 1):
        s += p[k] * x[i - k]
    return s


@compiled
def predict(P, degree, lag, work, nu, i):
    """Write paths, rest and residual of sample i."""
    rest, e = 2 * nu + 1, 2 * nu + 2
    constant = work[work.shape[0] - 1, 0]
    work[rest, i] = work[nu, i] + past(work[nu], P[ROW_A], degree[ROW_A], i) - constant
    for j in range(nu):
        b, f = ROW_FIRST + 2 * j, ROW_FIRST + 2 * j + 1
        w = -past(work[nu + 1 + j], P[f], degree[f], i)
        for k in range(degree[b]):
            w += P[b, k] * work[j, i - lag[b] - k]
        work[nu + 1 + j, i] = w
        work[rest, i] -= w
    autoregressed = work[rest, i] + past(work[rest], P[ROW_D], degree[ROW_D], i)
    work[e, i] = autoregressed - past(work[e], P[ROW_C], degree[ROW_C], i)


@compiled
def whitened(x, P, degree, out, i):
    """Write sample i of out = (D / C) x."""
    out[i] = x[i] + past(x, P[ROW_D], degree[ROW_D], i) - past(out, P[ROW_C], degree[ROW_C], i)


@compiled
def filtered(P, degree, work, nu, i):
    """Write sample i of the signals whose shifts are the gradient: a row for each of the table, then the one's."""
    rest, e, one = 2 * nu + 1, 2 * nu + 2, 2 * nu + 3
    first = 2 * nu + 4
    inner = first + degree.size + 1
    whitened(work[nu], P, degree, work[first + ROW_A], i)
    c, d = work[first + ROW_C], work[first + ROW_D]
    c[i] = -work[e, i] - past(c, P[ROW_C], degree[ROW_C], i)
    d[i] = work[rest, i] - past(d, P[ROW_C], degree[ROW_C], i)
    for j in range(nu):
        b, f = ROW_FIRST + 2 * j, ROW_FIRST + 2 * j + 1
        driven, parts = work[inner + 2 * j], work[inner + 2 * j + 1]
        driven[i] = -work[j, i] - past(driven, P[f], degree[f], i)
        parts[i] = work[nu + 1 + j, i] - past(parts, P[f], degree[f], i)
        whitened(driven, P, degree, work[first + b], i)
        whitened(parts, P, degree, work[first + f], i)
    work[one, i] = 1.0
    whitened(work[one], P, degree, work[first + degree.size], i)


@compiled
def gradient(degree, lag, work, nu, i, offset, g):
    """Write de / dtheta of sample i in the delta basis, the constant's last."""
    first = 2 * nu + 4
    at = 0
    for row in gradient_rows(degree.size):
        n = degree[row]
        x = work[first + row]
        for m in range(n):
            g[at + m] = x[i - lag[row] - m]
        for k in range(1, n):
            for m in range(n - 1, k - 1, -1):
                g[at + m] = g[at + m - 1] - g[at + m]
        at += n
    if offset:
        g[at] = -work[first + degree.size, i]


@compiled
def table_of(theta, base, degree, P):
    """Write the table whose rows are `base` plus theta, expanded from the delta basis to powers of q^-1."""
    at = 0
    copy_matrix(base, P)
    for row in gradient_rows(degree.size):
        first = 1 if row < ROW_FIRST or (row - ROW_FIRST) % 2 == 1 else 0
        for k in range(degree[row]):
            binomial = 1.0
            for m in range(k + 1):
                P[row, first + m] += theta[at + k] * binomial
                binomial *= -(k - m) / (m + 1.0)
        at += degree[row]
    return at


@compiled
def rotate_in(R, z, row, target, first):
    """Take one equation row theta = target into R theta = z; `row` is used up, zero before `first`."""
    p = row.size
    for i in range(first, p):
        if row[i] == 0.0:
            continue
        size = np.hypot(R[i, i], row[i])
        c, s = R[i, i] / size, row[i] / size
        for j in range(i, p):
            old = R[i, j]
            R[i, j] = c * old + s * row[j]
            row[j] = c * row[j] - s * old
        old = z[i]
        z[i] = c * old + s * target
        target = c * target - s * old


@compiled
def untold(R, i):
    """Return whether coefficient i has done nothing yet that others before it could not have done."""
    size = 0.0
    for k in range(i + 1):
        size += R[k, i] * R[k, i]
    return R[i, i] * R[i, i] <= TOLD * TOLD * size


@compiled
def solve(R, z, theta):
    """Write theta of R theta = z; what no sample has told yet keeps its value."""
    for i in range(z.size - 1, -1, -1):
        if untold(R, i):
            continue
        s = z[i]
        for j in range(i + 1, z.size):
            s -= R[i, j] * theta[j]
        theta[i] = s / R[i, i]


@compiled
def forget_along(R, z, g, keep):
    """Forget along the new gradient alone: R'R less (1 - keep^2) of what it knows in that direction.

    R'R - (1 - keep^2) R'w w'R / w'w with w = R g: rotations bring w to its first entry, that row is shrunk, and
    rotations make R triangular again. Directions that are not excited keep all they know.
    """
    p = z.size
    w = np.zeros(p)
    for i in range(p):
        for j in range(i, p):
            w[i] += R[i, j] * g[j]
    for i in range(p - 1, 0, -1):
        size = np.hypot(w[i - 1], w[i])
        if size == 0.0:
            continue
        c, s = w[i - 1] / size, w[i] / size
        w[i - 1], w[i] = size, 0.0
        turn(R, z, i - 1, i, c, s, i - 1)
    for j in range(p):
        R[0, j] *= keep
    z[0] *= keep
    for i in range(p - 1):
        size = np.hypot(R[i, i], R[i + 1, i])
        if size > 0.0:
            turn(R, z, i, i + 1, R[i, i] / size, R[i + 1, i] / size, i)
        R[i + 1, i] = 0.0


@compiled
def turn(R, z, a, b, c, s, first):
    """Rotate rows a and b from column `first`."""
    for j in range(first, z.size):
        x, y = R[a, j], R[b, j]
        R[a, j], R[b, j] = c * x + s * y, c * y - s * x
    x, y = z[a], z[b]
    z[a], z[b] = c * x + s * y, c * y - s * x


@compiled
def informed(R):
    """Return the logarithm of the determinant of R, minus infinity while a direction is unknown."""
    s = 0.0
    for i in range(R.shape[0]):
        if R[i, i] == 0.0:
            return -np.inf
        s += np.log(abs(R[i, i]))
    return s


@compiled
def forget(R, z, theta, best, g, turn_of, keep, mode):
    """Let the past count `keep` times as much, no further down than the floor."""
    p = z.size
    if mode == DIRECTIONAL:
        forget_along(R, z, g, keep)
        return
    for i in range(p):
        for j in range(i, p):
            R[i, j] *= keep
        z[i] *= keep
    # A row of the best information there was, in turn, about the present estimate: it pulls nowhere, but it stays.
    k = turn_of % p
    weight = np.sqrt((1.0 - keep * keep) * p * FLOOR)
    row, target = np.zeros(p), 0.0
    for j in range(k, p):
        row[j] = weight * best[k, j]
        target += row[j] * theta[j]
    rotate_in(R, z, row, target, k)


@compiled
def moved(R, z, theta, base, degree, P, work):
    """Solve, and go as far towards the solution as the polynomials stay stable; R theta = z holds afterwards."""
    p = z.size
    wanted = theta.copy()
    solve(R, z, wanted)
    step = wanted - theta
    share = 1.0
    for _ in range(HALVINGS):
        used = table_of(theta + share * step, base, degree, P)
        if admissible(P, degree):
            break
        share *= 0.5
    else:
        share = 0.0
        used = table_of(theta, base, degree, P)
    if share == 1.0:
        copy_vector(wanted, theta)
    else:
        theta += share * step
        for i in range(p):
            z[i] = 0.0
            for j in range(i, p):
                z[i] += R[i, j] * theta[j]
    work[work.shape[0] - 1, 0] = theta[used] if used < p else 0.0
    return share


@compiled
def recurse(u, y, P, base, degree, lag, offset, theta, R, z, best, work, head, count, options, e):
    """Take in the samples of one block; `count` holds samples seen, steps cut short, next free column, last step.

    `options`: samples during which nothing is learned, those during which theta stays, keep (square root of the
    forgetting factor), mode, samples between resets (0: never), samples between steps, samples behind that are filtered
    again after one.
    """
    nu = u.shape[0]
    quiet, frozen_until, keep, mode, reset, stride, behind = options
    g = np.zeros(theta.size)
    for t in range(y.size):
        if count[2] == work.shape[1]:
            shift(work, head + int(behind), count)
        i = count[2]
        count[2] += 1
        copy_vector(u[:, t], work[:nu, i])
        work[nu, i] = y[t]
        predict(P, degree, lag, work, nu, i)
        filtered(P, degree, work, nu, i)
        e[t] = work[2 * nu + 2, i]
        count[0] += 1
        if count[0] <= quiet:
            continue
        gradient(degree, lag, work, nu, i, offset, g)
        if keep < 1.0 and count[0] > frozen_until:
            forget(R, z, theta, best, g, count[0], keep, int(mode))
        target = -e[t]
        for k in range(theta.size):
            target += g[k] * theta[k]
        rotate_in(R, z, g, target, 0)
        if count[0] <= frozen_until:
            stand(R, z, theta)
            count[3] = count[0]
        elif count[0] - count[3] >= min(stride, 1 + count[0] // LOOK):
            count[3] = count[0]
            if moved(R, z, theta, base, degree, P, work) < 1.0:
                count[1] += 1
            for k in range(max(head, i + 1 - int(behind)), i + 1):
                predict(P, degree, lag, work, nu, k)
                filtered(P, degree, work, nu, k)
        if (keep < 1.0 or reset > 0) and count[0] % LOOK == 0 and informed(R) > informed(best):
            copy_matrix(R, best)
        if reset > 0 and count[0] % int(reset) == 0:
            copy_matrix(best, R)
            R *= np.sqrt(FLOOR)
            stand(R, z, theta)


@compiled
def shift(work, kept, count):
    """Make room: the last `kept` columns move to the front."""
    gap = count[2] - kept
    for r in range(work.shape[0] - 1):
        for t in range(kept):
            work[r, t] = work[r, t + gap]
    count[2] = kept


@compiled
def stand(R, z, theta):
    """Set z so that theta is the solution."""
    for i in range(z.size):
        z[i] = 0.0
        for j in range(i, z.size):
            z[i] += R[i, j] * theta[j]


@compiled
def deviations(R, T):
    """Return the roots of the diagonal of T (R'R)^-1 T'."""
    p = R.shape[0]
    inverse = np.zeros((p, p))
    for k in range(p):
        column = np.zeros(p)
        column[k] = 1.0
        for i in range(k, -1, -1):
            if untold(R, i):
                inverse[i, k] = np.inf
                continue
            s = column[i]
            for j in range(i + 1, k + 1):
                s -= R[i, j] * inverse[j, k]
            inverse[i, k] = s / R[i, i]
    out = np.empty(T.shape[0])
    for i in range(T.shape[0]):
        s = 0.0
        for k in range(p):
            x = 0.0
            for j in range(p):
                if T[i, j] != 0.0:
                    x += T[i, j] * inverse[j, k]
            s += x * x
        out[i] = np.sqrt(s)
    return out
