"""The products inside the sampled loop against NumPy's, of every small shape; a sum is added up in order."""

import numpy as np
import pytest

from ultraquiet.bench import kernels
from ultraquiet.bench.columns import spanned, turned


def in_order(A, x, out):
    """Return out + A x, a column after the other: the plain twin of both products."""
    out = out.copy()
    for j, value in enumerate(x):
        out += A[:, j] * value
    return out


@pytest.mark.parametrize("rows", range(11))
@pytest.mark.parametrize("columns", [0, 1, 2, 7])
def test_products_are_sums_in_order_to_the_bit(rows, columns, rng):
    A, x, out = rng.standard_normal((rows, columns)), rng.standard_normal(columns), rng.standard_normal(rows)
    A[rng.random(A.shape) < 0.3] = 0.0
    expected, wide, tall = in_order(A, x, out), out.copy(), out.copy()
    kernels.add_wide_product(turned(A), x, wide)
    kernels.add_product(*spanned(A), x, tall)
    np.testing.assert_array_equal(wide, expected)
    np.testing.assert_array_equal(tall, expected)
