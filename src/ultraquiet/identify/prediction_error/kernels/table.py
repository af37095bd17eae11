"""Steps of the prediction-error table, compiled.

The model is A y = sum_j B_j / F_j u_j + C / D e (+ a constant). Polynomials stand in one table `P`, a row each, in the
order a, c, d, b_1, f_1, b_2, f_2, ...; `degree` counts the free coefficients of each row, `lag` the power of q^-1 its
first free coefficient stands at (1 for monic rows, the delay for B). Gradient columns are taken in the delta basis
q^-lag (1 - q^-1)^k instead of bare shifts: at 3.5 kHz shifts of a 12 Hz mode are parallel to four digits, and a normal
matrix of their products would keep none (Jacobian condition 1e8, squared).
"""

import numpy as np

from ultraquiet._base.compiled import brief, compiled

ROW_A, ROW_C, ROW_D, ROW_FIRST = 0, 1, 2, 3
WITHIN = 1 - 1e-6  # roots nearer to the circle are beyond the recursion's own rounding, and any record's length


@compiled
def inside(p, order):
    """Return whether all roots of monic p (powers of q^-1) lie within WITHIN: the Schur-Cohn recursion."""
    a, b = np.empty(order + 1), np.empty(order + 1)
    for i in range(order + 1):
        a[i] = p[i] / WITHIN**i
    for m in range(order, 0, -1):
        k = a[m]
        if not abs(k) < 1.0:
            return False
        scale = 1.0 - k * k
        for i in range(m):
            b[i] = (a[i] - k * a[m - i]) / scale
        for i in range(m):
            a[i] = b[i]
    return True


@brief
def admissible(P, degree):
    """Return whether C, D and every F have their roots inside the unit circle."""
    for row in range(ROW_C, P.shape[0]):
        numerator = row >= ROW_FIRST and (row - ROW_FIRST) % 2 == 0
        if not numerator and not inside(P[row], degree[row]):
            return False
    return True


@compiled
def gradient_rows(rows):
    """Return the order of the parameters: a, the b and f of each input, c, d."""
    order = np.empty(rows, np.int64)
    order[0], order[rows - 2], order[rows - 1] = ROW_A, ROW_C, ROW_D
    for row in range(ROW_FIRST, rows):
        order[row - 2] = row
    return order


@brief
def add_expanded(weights, scale, places, table):
    """Add scale sum_k weights[k] (1 - q^-1)^k to rows of the table in powers of q^-1: the basis of the normal matrix.

    Each of `places` is (row, first column, count) and takes the next `count` weights.
    """
    at = 0
    for i in range(places.shape[0]):
        row, first, count = places[i, 0], places[i, 1], places[i, 2]
        taps = np.zeros(count)
        for k in range(count):
            binomial = 1.0
            for m in range(k + 1):
                taps[m] += weights[at + k] * binomial
                binomial *= -(k - m) / (m + 1.0)
        for m in range(count):
            table[row, first + m] += scale * taps[m]
        at += count
