"""Filters of the prediction-error methods, compiled: recursive and moving sums whose taps stay in registers.

A recursive filter waits for its own last sample, seven cycles at least; all else must hide behind that wait. With a
fixed number of taps, missing ones zero, states and coefficients never leave the registers and the wait is all that is
left: a third of the time of a loop over taps, for any order up to REGISTERS.

Each signal is a row of one workspace and begins behind a head: zeros, or the end of the samples before. What a filter
reaches back for stands there, so that a record in one piece and one in blocks are the same work. All filtering goes
through `filtered`, which takes its filters as a list: a compiler that meets each loop once is done ten times sooner.
"""

from ultraquiet._base.compiled import FLUSH, compiled

REGISTERS = 8
LEAST_HEAD = REGISTERS  # samples before the first that the filters read whatever their order
CHECKED = 64  # samples between two looks for such a tail
# What a step does, added up: sets `out` to a moving sum of the source, or adds that to it, then divides it.
MOVING, ADDED, ALL_POLE = 1, 2, 4


@compiled
def filtered(steps, coefficients, work, first, stop):
    """Run filters over samples first..stop of the workspace `(signals, samples)`, one after the other.

    A step is (what, source row, output row, numerator row, count, lag, denominator row, order): what is a sum of
    MOVING, ADDED and ALL_POLE, numerator and denominator are rows of `coefficients`.
    """
    for i in range(steps.shape[0]):
        what, x, out = steps[i, 0], work[steps[i, 1]], work[steps[i, 2]]
        if what & (MOVING | ADDED):
            moving(x, coefficients[steps[i, 3]], steps[i, 4], steps[i, 5], what & ADDED, out, first, stop)
            x = out
        if what & ALL_POLE:
            all_pole(x, coefficients[steps[i, 6]], steps[i, 7], out, first, stop)


@compiled
def all_pole(x, p, order, out, first, stop):
    """Set out = x / p(q), p monic; the newest sample is used last, which keeps the chain of dependence short."""
    if order > REGISTERS:
        for t in range(first, stop):
            s = x[t]
            for k in range(order, 0, -1):
                s -= p[k] * out[t - k]
            out[t] = s if abs(s) > FLUSH else 0.0
        return
    c1 = p[1] if order > 0 else 0.0
    c2 = p[2] if order > 1 else 0.0
    c3 = p[3] if order > 2 else 0.0
    c4 = p[4] if order > 3 else 0.0
    c5 = p[5] if order > 4 else 0.0
    c6 = p[6] if order > 5 else 0.0
    c7 = p[7] if order > 6 else 0.0
    c8 = p[8] if order > 7 else 0.0
    y1, y2, y3, y4 = out[first - 1], out[first - 2], out[first - 3], out[first - 4]
    y5, y6, y7, y8 = out[first - 5], out[first - 6], out[first - 7], out[first - 8]
    for start in range(first, stop, CHECKED):
        for t in range(start, min(stop, start + CHECKED)):
            s = x[t] - c8 * y8 - c7 * y7 - c6 * y6 - c5 * y5 - c4 * y4 - c3 * y3 - c2 * y2 - c1 * y1
            y8, y7, y6, y5, y4, y3, y2, y1 = y7, y6, y5, y4, y3, y2, y1, s
            out[t] = s
        largest = max(abs(y1), abs(y2), abs(y3), abs(y4), abs(y5), abs(y6), abs(y7), abs(y8))
        if largest < FLUSH:
            y1 = y2 = y3 = y4 = y5 = y6 = y7 = y8 = 0.0


@compiled
def moving(x, p, count, lag, added, out, first, stop):
    """Set out = q^-lag (p_0 + p_1 q^-1 + ...) x with `count` coefficients, or add it: REGISTERS taps in one pass."""
    n = stop - first
    y = out[first:stop]
    if not added:
        for t in range(n):
            y[t] = 0.0
    for k in range(0, count, REGISTERS):
        c0 = p[k]
        c1 = p[k + 1] if k + 1 < count else 0.0
        c2 = p[k + 2] if k + 2 < count else 0.0
        c3 = p[k + 3] if k + 3 < count else 0.0
        c4 = p[k + 4] if k + 4 < count else 0.0
        c5 = p[k + 5] if k + 5 < count else 0.0
        c6 = p[k + 6] if k + 6 < count else 0.0
        c7 = p[k + 7] if k + 7 < count else 0.0
        at = first - lag - k
        x0, x1, x2, x3 = x[at : at + n], x[at - 1 : at - 1 + n], x[at - 2 : at - 2 + n], x[at - 3 : at - 3 + n]
        x4, x5, x6, x7 = x[at - 4 : at - 4 + n], x[at - 5 : at - 5 + n], x[at - 6 : at - 6 + n], x[at - 7 : at - 7 + n]
        if k + 1 == count:
            for t in range(n):
                y[t] += c0 * x0[t]
        else:
            for t in range(n):
                y[t] += (c0 * x0[t] + c1 * x1[t] + c2 * x2[t] + c3 * x3[t]) + (
                    c4 * x4[t] + c5 * x5[t] + c6 * x6[t] + c7 * x7[t]
                )
