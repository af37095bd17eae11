"""Invariant zeros do not depend on the units of states, inputs, outputs or time."""

import numpy as np
import pytest

from ultraquiet.linalg.zeros import invariant_zeros


def matched(found, true, rtol):
    """Return whether both hold the same values, each near one of the other's."""
    return found.size == true.size and all(np.abs(found - z).min() < rtol * (1 + abs(z)) for z in true)


@pytest.mark.parametrize("decades", [12, 20])
@pytest.mark.parametrize("proper", [True, False])
def test_units_move_no_zero(decades, proper, rng):
    for n, m in ((1, 1), (5, 2), (8, 3)):
        A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((m, n))
        D = rng.standard_normal((m, m)) * proper
        if proper:
            true = np.linalg.eigvals(A - B @ np.linalg.solve(D, C))
        else:
            # where C B is invertible, n - m zeros: A on the kernel of C, along the image of B
            kernel = np.linalg.svd(C)[2][m:].T
            true = np.linalg.eigvals(kernel.T @ (A - B @ np.linalg.solve(C @ B, C @ A)) @ kernel)
        x, u, y = (10 ** rng.uniform(-decades, decades, k) for k in (n, m, m))
        found = invariant_zeros(A * x / x[:, None], B / x[:, None] * u, C * x * y[:, None], D * u * y[:, None])
        assert matched(found, true, 1e-6 * max(1.0, np.linalg.cond(D if proper else C @ B)))


@pytest.mark.parametrize("tiny", [1e-20, 1e-9, 1.0, 1e20])
def test_a_chain_of_integrators_with_tiny_couplings(tiny):
    """(s + 2) / s^2 with the second state in any unit, and 1 / s^2, which has no zero."""
    A, C, D = np.array([[0.0, tiny], [0.0, 0.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))
    np.testing.assert_allclose(invariant_zeros(A, np.array([[1.0], [2 / tiny]]), C, D), [-2.0], rtol=1e-9)
    assert not invariant_zeros(A, np.array([[0.0], [1.0]]), C, D).size


@pytest.mark.parametrize("step", [1.0, 1e-4, 1e-8])
def test_a_sampled_double_integrator_has_its_zero_at_minus_one(step):
    A, B = np.array([[1.0, step], [0.0, 1.0]]), np.array([[step**2 / 2], [step]])
    np.testing.assert_allclose(invariant_zeros(A, B, np.eye(2)[:1], np.zeros((1, 1))), [-1.0], rtol=1e-6)
