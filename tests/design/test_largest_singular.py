"""The largest singular values that a search asks for without decomposing every matrix."""

import numpy as np
import pytest

from ultraquiet.design.peak_bounded.loops.largest import largest_within, slack_db, upper_db


@pytest.mark.parametrize("shape", [(1, 1), (4, 3), (3, 5), (6, 6)])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_the_largest_is_found_and_the_bound_is_one(seed, shape, scale):
    rng = np.random.default_rng(seed)
    M = scale * (rng.standard_normal((50, *shape)) + 1j * rng.standard_normal((50, *shape)))
    M[7] = scale * 1e-3 * np.eye(*shape)  # all singular values alike: the bound is furthest off
    M[8] = 0.0
    bound = rng.uniform(-10, 10, 50)
    with np.errstate(divide="ignore"):
        exact = 20 * np.log10(np.linalg.norm(M, 2, axis=(1, 2)))
    upper = upper_db(M)
    heard = exact > -np.inf
    assert np.all(upper[heard] >= exact[heard] - 1e-9)
    assert np.all(upper[heard] <= exact[heard] + slack_db(M.shape))
    assert largest_within(M, bound) == pytest.approx((exact - bound).max(), abs=1e-9)
    assert largest_within(M[:0], bound[:0]) == -np.inf
