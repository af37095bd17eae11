"""Models and the kernels' tables: one pair of functions for every structure and every way to accumulate."""

from math import comb

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation, delta
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, b_rows, f_rows, reduced
from ultraquiet.linalg import realize
from ultraquiet.values import PolynomialModel

# Distance from the unit circle that a finished model's roots keep: no record is long enough to tell it from zero.
NEAREST = 1e-6
SETTLING_STEPS = 20


def table_of(parameterisation: Parameterisation, model: PolynomialModel, gain: FloatArray) -> FloatArray:
    """Return the table of a model, inputs and output scaled so that one output unit by input unit becomes `gain`.

    Coefficients the model lacks are zero; those the parameterisation has no place for are left out.
    """
    nu, degree = parameterisation.inputs, parameterisation.degree()
    table = parameterisation.empty(gain)
    for row, p in [(ROW_A, model.a), (ROW_C, model.c), (ROW_D, model.d), *zip(f_rows(nu), model.f, strict=True)]:
        kept = p[: degree[row] + 1]
        table[row, : kept.size] = kept
    for j, row in enumerate(b_rows(nu)):
        b = model.b[j][parameterisation.delay[j] : parameterisation.delay[j] + parameterisation.b[j]] / gain[j]
        table[row, : b.size] = b
    return table


def modelled(
    parameterisation: Parameterisation, table: FloatArray, gain: FloatArray, rate_hz: float, variance: float
) -> PolynomialModel:
    """Return the table's model in the units of the record, its known factors exact."""
    nu = parameterisation.inputs
    numerators = [
        np.concatenate(
            [
                np.zeros(parameterisation.delay[j]),
                gain[j] * _with_zeros(table[r, : parameterisation.b[j]], parameterisation),
            ]
        )
        for j, r in enumerate(b_rows(nu))
    ]

    def denominator(row: int, degree: int) -> FloatArray:
        p = reduced(table[row], degree)
        return p if parameterisation.free(row) is None else settled(p)

    return PolynomialModel(
        numerators,
        [denominator(r, parameterisation.f[j]) for j, r in enumerate(f_rows(nu))],
        rate_hz,
        reduced(table[ROW_A], parameterisation.a),
        denominator(ROW_C, parameterisation.c),
        denominator(ROW_D, parameterisation.d),
        noise_variance=variance,
    )


def _with_zeros(b: FloatArray, parameterisation: Parameterisation) -> FloatArray:
    """Return B with its known zeros restored to the last digit."""
    k = parameterisation.zeros_at_dc
    if k == 0 or "b" in parameterisation.fixed:
        return b
    rest = delta(b.size - k) @ (delta(b.size) @ b)[k:]
    return np.convolve(rest, [(-1.0) ** m * comb(k, m) for m in range(k + 1)])


def settled(p: FloatArray) -> FloatArray:
    """Return monic p with those roots moved inside the unit circle that stand on it or a hair outside.

    The search keeps them inside by the Schur-Cohn recursion, whose rounding lets a crowded root past by a hair.
    """
    for step in range(SETTLING_STEPS):
        roots = realize.roots(p)
        size = np.abs(roots)
        if np.all(size <= 1.0 - NEAREST / 2):
            break
        limit = 1.0 - NEAREST * 2.0**step
        inside = np.where(size > limit, roots / np.maximum(size, limit) * limit, roots)
        product = np.ones(1, dtype=np.clongdouble)
        for root in inside:
            product = np.convolve(product, np.array([1.0, -root], dtype=np.clongdouble))
        p = product.real.astype(np.float64)
    return p
