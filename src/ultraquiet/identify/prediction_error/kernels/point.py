"""One point of a search in memory, compiled: a call is long enough to be worth handing the lock to another thread.

A compiler makes what a function calls once more for each function that calls it. So both halves of a point are one
function that calls the filters in one place and the products in another.
"""

import numpy as np

from ultraquiet._base.compiled import compiled
from ultraquiet.identify.prediction_error.kernels.filters import filtered
from ultraquiet.identify.prediction_error.kernels.normal_equations import add_products, damped_step, reduced
from ultraquiet.identify.prediction_error.kernels.table import add_expanded
from ultraquiet.identify.prediction_error.structure import GRADIENT, PAST

BLOCK = 512  # samples summed before the sums are: rounding grows with the root of either, not of the record


@compiled
def evaluated(stages, steps, columns, states, coefficients, known, work, e, first, stop):
    """Run stages of a point, first to last: its residual, the past taken out of that, its gradient.

    `steps` and `columns` hold each stage's filters and columns. The residual's stage fits past and constant, writes
    them into `coefficients` and their products into `known`, `(q, q)`. Returns the sum of squares of row `e` and, after
    the gradient's stage, [J e]'[J e] of the delta basis with past and constant eliminated.
    """
    q = known.shape[0]
    G = np.zeros((q, q))
    for stage in range(stages[0], stages[1]):
        filtered(steps[stage], coefficients, work, first, stop)
        if stage == PAST or columns[stage].shape[0] == 0:
            continue
        have = q if stage == GRADIENT else 0
        width = 0
        for i in range(columns[stage].shape[0]):
            width += columns[stage][i, 2]
        G = np.zeros((width, width))
        copied(known, have, G)
        add_products(work, columns[stage], have, first, stop, G)
        if stage == GRADIENT:
            G = reduced(G, q)
        else:
            copied(G, q, known)
            x, _ = damped_step(G, 0.0)
            add_expanded(x, 1.0, states, coefficients)
    return sum_of_squares(work[e], first, stop), G


@compiled
def copied(source, size, out):
    """Copy the leading block; as slices it would compile five seconds of sentences about their shapes."""
    for i in range(size):
        for j in range(size):
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
