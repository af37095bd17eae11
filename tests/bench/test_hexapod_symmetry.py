"""The constant transform that takes the symmetric hexapod apart into two scalar loops and one 2 x 2 used twice."""

import numpy as np
import pytest

from ultraquiet.bench import Hexapod
from ultraquiet.bench.hexapod.physics.geometry import decoupling

WIDE = np.geomspace(1.0, 1500.0, 160)


def apart(g):
    """Return T' G T per frequency and what is left of it outside diag(g1, g2, H, H), relative to |G|."""
    T = decoupling()
    turned = np.einsum("ji,jkf,kl->ilf", T, g, T)
    blocks = turned.copy()
    blocks[0, 0] = blocks[1, 1] = 0.0
    blocks[2:4, 2:4] = blocks[4:6, 4:6] = 0.0
    size = np.linalg.norm(g, axis=(0, 1))
    outside = np.abs(blocks).max(axis=(0, 1)) / size
    unequal = np.abs(turned[2:4, 2:4] - turned[4:6, 4:6]).max(axis=(0, 1)) / size
    return turned, outside.max(), unequal.max()


@pytest.mark.parametrize("unit", ["ground", "flight", "rigid"])
def test_two_scalar_loops_and_one_2x2_used_twice(unit):
    turned, outside, unequal = apart(Hexapod(unit=unit).linear_response(WIDE))
    print(f"{unit}: {outside:.1e} of |G| outside the blocks, the two 2 x 2 alike to {unequal:.1e}")
    assert outside < 1e-10
    assert unequal < 1e-10
    # The pieces are really different, and the 2 x 2 really coupled.
    assert np.abs(turned[0, 0] - turned[1, 1]).max() > 0.1
    assert np.abs(turned[2, 3]).max() > 1e-3


def test_the_transform_is_orthonormal():
    T = decoupling()
    assert np.abs(T.T @ T - np.eye(6)).max() < 1e-15


@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_proof_masses_off_the_axis_and_spread_break_it_as_stated(unit, seed):
    """Proof masses by less than their share of mass allows, a unit's spread by some per cent."""
    for settings, low, high in (
        ({"instruments": "all"}, 1e-6, 2e-2),
        ({"spread": 1.0, "unit_seed": seed}, 1e-3, 1.0),
    ):
        _, outside, _ = apart(Hexapod(unit=unit, **settings).linear_response(WIDE)[:6, :6])
        print(f"{unit}, {settings}: {outside:.1e} of |G| outside the blocks")
        assert low < outside < high


def test_the_sampled_bench_is_taken_apart_too(rng):
    """In time: what is sent along one column of T comes back in its own block only."""
    T, bench = decoupling(), Hexapod(unit="flight", linear=True)
    s = rng.normal(size=500)
    for column, own in ((0, [0]), (1, [1]), (2, [2, 3]), (5, [4, 5])):
        back = T.T @ bench.run(np.outer(T[:, column], s)).outputs
        rest = np.delete(back, own, axis=0)
        assert np.abs(rest).max() < 1e-10 * np.abs(back).max()
