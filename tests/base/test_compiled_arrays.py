"""Compiled copies and the positive solver beside numpy's."""

import numpy as np
import pytest

from ultraquiet._base.compiled_arrays import copy_matrix, copy_vector, solve_positive


@pytest.mark.parametrize(("size", "columns"), [(1, 1), (1, 4), (3, 1), (6, 5)])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_positive_systems_are_solved_as_numpy_does(rng, size, columns, unit):
    root = rng.standard_normal((size, size + 2))
    S, B = unit * root @ root.T, rng.standard_normal((size, columns))
    factor, X = S.copy(), B.copy()
    solve_positive(factor, X)
    assert np.allclose(X, np.linalg.solve(S, B), rtol=1e-9, atol=0.0)
    assert np.allclose(np.tril(factor), np.linalg.cholesky(S), rtol=1e-12, atol=0.0)


def test_copies_are_bit_for_bit_and_leave_the_rest(rng):
    values, held = rng.standard_normal((3, 7)), np.zeros((5, 9))
    copy_matrix(values[:, ::2], held[1:4, 2:6])
    assert np.array_equal(held[1:4, 2:6], values[:, ::2])
    assert np.count_nonzero(held) == 12
    line = np.zeros(7)
    copy_vector(values[1], line)
    assert np.array_equal(line, values[1])
