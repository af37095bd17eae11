"""The search of one record in memory, compiled: two threads that search need the interpreter's lock only in between.

A compiler makes what a function calls once more for each function that calls it. So both halves of a point and all
points of a search are one loop that calls the filters in one place and the products in another.
"""

import numpy as np

from ultraquiet._base.compiled import compiled
from ultraquiet.identify.prediction_error import damping_policy
from ultraquiet.identify.prediction_error.damping_policy import CONVERGED, INNER_TRIES, RUNNING, STUCK
from ultraquiet.identify.prediction_error.kernels.filters import filtered
from ultraquiet.identify.prediction_error.kernels.normal_equations import add_products, damped_step, reduced
from ultraquiet.identify.prediction_error.kernels.table import add_expanded, admissible
from ultraquiet.identify.prediction_error.structure import GRADIENT, PAST, RESIDUAL

BLOCK = 512  # samples summed before the sums are: rounding grows with the root of either, not of the record
at_minimum, after_gain, after_loss = (
    compiled(policy) for policy in (damping_policy.at_minimum, damping_policy.after_gain, damping_policy.after_loss)
)


@compiled
def searched(stage, steps, columns, places, degree, plain, rows, known, work, e, span, table, so_far, most, tolerance):
    """Search from a table: `levenberg_marquardt.minimise`, of at most `most` steps; of fewer than none, its loss alone.

    `steps` and `columns` hold each stage's filters and columns, `places` where past and parameters stand, `plain` the
    coefficients without table and past. The residual's stage fits past and constant, writes them into `rows` and their
    products into `known`, `(q, q)`; where the gradient's is the first, these and `work` are those of the table.
    `so_far` is the search's loss, its damping and how many steps in a row gained little.

    `table` becomes the last point's. Returns the same three of it, its normal matrix in the delta basis, the
    iterations, the state, and the stage reached: GRADIENT where `work` is the last point's, not that of a step tried.
    """
    first, stop = span
    loss, damping, small = so_far
    q, samples = known.shape[0], stop - first
    G, S, trial = known, known, table.copy()
    promised, state, iterations, tries = 0.0, RUNNING, 0, -1
    while True:
        if stage == RESIDUAL:
            copied(plain, rows)
            copied(trial, rows)
        filtered(steps[stage], rows, work, first, stop)
        if stage != PAST:
            G = products(work, columns[stage], known, q if stage == GRADIENT else 0, first, stop)
        if stage == RESIDUAL:
            copied(G, known)
            add_expanded(damped_step(G, 0.0)[0], 1.0, places[0], rows)
            stage = PAST
            continue
        if stage == GRADIENT:
            S = reduced(G, q)
            state = state_at(S, loss, small, tolerance)
            if state != RUNNING or iterations >= most:
                break
            iterations, tries = iterations + 1, 0
        else:
            found = sum_of_squares(work[e], first, stop) / samples
            gain = samples * (loss - found)
            if tries < 0 or gain > 0.0:
                if tries >= 0:
                    small = small + 1 if gain <= tolerance * loss else 0
                    damping = after_gain(damping, gain, promised)
                    copied(trial, table)
                loss, stage = found, GRADIENT
                if most < 0:
                    break
                continue
            damping, tries = after_loss(damping), tries + 1
        promised, damping, tries = tried(table, S, damping, tries, places[1], degree, trial)
        if tries == INNER_TRIES:
            state = STUCK
            break
        stage = RESIDUAL
    return (loss, damping, small), S, iterations, state, stage


@compiled
def state_at(S, loss, small, tolerance):
    """Return whether a search goes on from a point."""
    if not np.isfinite(loss):
        return STUCK
    return CONVERGED if at_minimum(damped_step(S, 0.0)[1], small, tolerance * loss) else RUNNING


@compiled
def tried(table, S, damping, tries, moves, degree, trial):
    """Set `trial` to the admissible table a step leads to; return what that promises, its damping, the tries so far."""
    promised = 0.0
    while tries < INNER_TRIES:
        step, promised = damped_step(S, damping)
        copied(table, trial)
        add_expanded(step, 1.0, moves, trial)
        if admissible(trial, degree):
            break
        damping, tries = after_loss(damping), tries + 1
    return promised, damping, tries


@compiled
def products(work, columns, known, have, first, stop):
    """Return the products of all columns, those of the first `have` among themselves known."""
    width = 0
    for i in range(columns.shape[0]):
        width += columns[i, 2]
    G = np.zeros((width, width))
    copied(known[:have, :have], G)
    add_products(work, columns, have, first, stop, G)
    return G


@compiled
def copied(source, out):
    """Copy what has room; as slices it would compile five seconds of sentences about their shapes."""
    for i in range(min(source.shape[0], out.shape[0])):
        for j in range(min(source.shape[1], out.shape[1])):
            out[i, j] = source[i, j]


@compiled
def sum_of_squares(x, first, stop):
    """Return the sum of x^2 over samples first..stop, the same on every machine."""
    total = 0.0
    for start in range(first, stop, BLOCK):
        part = 0.0
        for t in range(start, min(stop, start + BLOCK)):
            part += x[t] * x[t]
        total += part
    return total
