"""The quadratic programme of a step: its two forms say the same, and keep its bounds."""

import numpy as np
import pytest

from ultraquiet.design.peak_bounded.programme import by_bounds, by_unknowns, shortest

# Its solver keeps bounds to a share of the programme's size, there of 1e6: 18 of 1000 draws pass by more than asked.
LARGE = pytest.param(1e3, marks=pytest.mark.draws(false_alarm=0.1))


@pytest.mark.parametrize("scale", [1.0, 1e-3, LARGE])
@pytest.mark.parametrize(("unknowns", "bounds"), [(1, 3), (30, 8), (8, 30), (200, 50), (40, 41)])
def test_both_forms_find_the_same_step(unknowns, bounds, scale, seed):
    """Levels to lower, excesses to keep below zero and parameters that may not fall, as a search asks for them."""
    rng = np.random.default_rng(100 * seed + unknowns + bounds)
    sought = rng.random(bounds) < 0.5
    sought[0] = True
    rows = np.hstack([scale * rng.standard_normal((bounds, unknowns)), -1.0 * sought[:, None], -1.0 * ~sought[:, None]])
    last = np.append(np.zeros(unknowns + 1), -1.0)  # no excess is below zero
    least = np.hstack([-np.eye(unknowns)[:1], np.zeros((1, 2))])
    A, b = np.vstack([rows, last, least]), np.concatenate([rng.standard_normal(bounds), [0.0], [0.1]])
    price = np.array([1.0, 10.0])
    one, other = by_unknowns(A, b, price), by_bounds(A, b, price)
    cost = [x[:unknowns] @ x[:unknowns] / 2 + price @ x[unknowns:] for x in (one, other)]
    over = [(A @ x - b).max() for x in (one, other)]
    print(f"costs {cost[0]:.9g}, {cost[1]:.9g}; bounds exceeded by {over[0]:.1g}, {over[1]:.1g}")
    assert cost[1] == pytest.approx(cost[0], abs=1e-5 * (1 + abs(cost[0])))
    assert np.allclose(one[:unknowns], other[:unknowns], atol=1e-3 * (1 + np.abs(one[:unknowns]).max()))
    assert max(over) < 1e-5
    assert np.array_equal(shortest(A, b, price), other if len(A) < unknowns else one)
