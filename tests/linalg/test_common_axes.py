"""Common axes of several matrices: the finest blocks, and the same axes whatever rounding does."""

import numpy as np
import pytest

from ultraquiet.linalg.common_axes import common_axes

SAME = 1e-9  # rounding of 1e-14 over the smallest gap between eigenvalues here, with room


def orthonormal(rng, n):
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def shaken(rng, family):
    """The family as another order of the same sums would give it."""
    return family + 1e-14 * rng.standard_normal(family.shape)


def copies(rng, count, size, members=8):
    """Symmetric matrices of `count` equal blocks, seen in turned axes."""
    blocks = rng.standard_normal((members, size, size))
    turn = orthonormal(rng, count * size)
    return turn @ np.kron(np.eye(count), blocks + np.swapaxes(blocks, 1, 2)) @ turn.T


@pytest.mark.parametrize(("count", "size"), [(2, 2), (3, 2), (2, 3), (4, 1)])
def test_equal_blocks_come_apart_and_are_equal(rng, count, size):
    family = copies(rng, count, size)
    T = common_axes(family[0], family)
    # a space after another, in each the copies in one order: the identity is now the right factor
    left = T.T @ family @ T
    wanted = np.kron(left[:, ::count, ::count], np.eye(count))
    np.testing.assert_allclose(T.T @ T, np.eye(count * size), atol=1e-12)
    np.testing.assert_allclose(left, wanted, atol=1e-8 * np.abs(family).max())


@pytest.mark.parametrize(("count", "size"), [(1, 5), (2, 2), (3, 2)])
def test_rounding_does_not_choose_the_axes(rng, count, size):
    family = copies(rng, count, size)
    T = common_axes(family[0], family)
    for _ in range(5):
        other = shaken(rng, family)
        assert np.abs(common_axes(other[0], other) - T).max() < SAME


def test_members_split_what_the_mean_does_not(rng):
    """Four loops that the mean does not tell apart: two members together do."""
    turn = orthonormal(rng, 4)
    family = np.array([turn @ np.diag(d) @ turn.T for d in ((1, 1, 1, 1), (2, 2, 1, 1), (0, 1, 0, 1))], dtype=float)
    T = common_axes(family[0], family)
    outside = (T.T @ family @ T)[:, ~np.eye(4, dtype=bool)]
    assert np.abs(outside).max() < 1e-12
    other = shaken(rng, family)
    assert np.abs(common_axes(other[0], other) - T).max() < SAME


def test_a_weak_coupling_splits_a_space_too(rng):
    """Two alike loops, one of which a third loop is coupled to by 1e-4: the free one stays free."""
    weak = np.diag([1.0, 1.0, 0.5])
    weak[0, 2] = weak[2, 0] = 1e-4
    turn = orthonormal(rng, 3)
    family = np.array([turn @ m @ turn.T for m in (np.diag([1.0, 1.0, 0.5]), weak)])
    left = common_axes(family[0], family).T @ turn
    assert np.sum(np.abs(left) > 1e-6) == 3


def test_nothing_to_tell_apart_leaves_the_channels():
    np.testing.assert_array_equal(common_axes(np.eye(3), np.eye(3)[None]), np.eye(3))
    np.testing.assert_array_equal(common_axes(np.zeros((2, 2)), np.zeros((1, 2, 2))), np.eye(2))
