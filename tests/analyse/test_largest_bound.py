"""The largest bound of mu over frequency, found by scalings of neighbours, against close bounds at every line."""

import numpy as np
import pytest
from loops import estimated_feedback, lightly_damped

from ultraquiet.analyse import Block, mu_bounds, mu_peak
from ultraquiet.analyse.margins import default_grid, even_sensitivity
from ultraquiet.analyse.scalings import largest, levels, upper
from ultraquiet.analyse.scalings.largest import SAME, LargestBound, Scalings
from ultraquiet.analyse.structure import structure
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain

ACCURACY = 1e-7  # of both routes together
LINES = 13
REAL, REPEATED = Block(2, kind="real"), Block(2, kind="repeated")
# By name: outputs and inputs, modes, blocks as users write them.
CASES = {
    "one channel": ((1, 1), 2, [1]),
    "more outputs": ((4, 3), 3, [(2, 1), (1, 1), (1, 1)]),
    "more inputs": ((3, 5), 3, [(1, 2), (2, 3)]),
    "one block": ((3, 3), 3, [3]),
    "twelve channels": ((12, 12), 6, [1] * 12),
    "real": ((4, 4), 3, [REAL, 1, 1]),
    "mixed": ((12, 12), 4, [REPEATED, REAL, 3, (1, 2), (2, 1), 1, 1]),
}


def resonant(rng, shape, modes):
    """Return a stable system of light resonances with a direct term."""
    system = lightly_damped(rng, *shape, modes, zeta=10 ** rng.uniform(-3, -1))
    return StateSpace(system.A, system.B, system.C, 0.3 * rng.standard_normal(shape), system.rate_hz)


def stacked(system, f):
    return np.moveaxis(system.frequency_response(f), 2, 0)


@pytest.mark.parametrize("case", CASES)
def test_the_largest_bound_is_that_of_every_line(case, rng):
    shape, modes, blocks = CASES[case]
    system, blocks = resonant(rng, shape, modes), structure("test", blocks, shape)
    many = 4 if case in ("real", "mixed") else 60  # a close bound takes a tenth of a second a line there
    f = np.sort(np.concatenate([np.geomspace(5, 900, many), default_grid(system)[-many // 2 :]]))
    M = stacked(system, f)
    plain, bound = upper.upper_bound(M, blocks).value, LargestBound(blocks)
    found = bound(f, M)
    assert found.max() == pytest.approx(plain.max(), rel=ACCURACY)
    assert bound.highest == pytest.approx(plain.max(), rel=ACCURACY)
    assert np.all(found >= plain * (1 - ACCURACY))
    assert plain[np.argmax(found)] == pytest.approx(plain.max(), rel=ACCURACY)
    # asked again, and at lines between, it knows the largest already
    assert bound(f, M).max() == pytest.approx(plain.max(), rel=ACCURACY)
    between = np.sqrt(f[1:] * f[:-1])
    more = upper.upper_bound(stacked(system, between), blocks).value
    bound(between, stacked(system, between))
    assert bound.highest == pytest.approx(max(plain.max(), more.max()), rel=ACCURACY)


@pytest.mark.parametrize("case", CASES)
def test_scalings_of_neighbours_bound_every_line(case, rng):
    shape, modes, blocks = CASES[case]
    system, blocks = resonant(rng, shape, modes), structure("test", blocks, shape)
    f, known = np.geomspace(5, 900, LINES), Scalings(blocks)
    M = stacked(system, f)
    close = upper.upper_bound(M, blocks)
    known.learn(f[::-3], upper.Upper(*(part[::-3] for part in close)))
    low, high, share = known.beside(f)
    for part in (np.zeros(LINES), np.ones(LINES), share):
        assert np.all(known.bounds(M, low, high, part) >= close.value * (1 - 1e-8))
    own = np.arange(LINES) % 3 == 0
    np.testing.assert_allclose(known.bounds(M, low, high, share)[own], close.value[own], rtol=1e-7)


@pytest.mark.parametrize(("shape", "modes"), [((1, 1), 2), ((4, 4), 4), ((8, 8), 6)])
def test_peak_of_a_loop_is_that_of_close_bounds(shape, modes, rng):
    plant = lightly_damped(rng, *shape, modes)
    S = even_sensitivity(plant, estimated_feedback(plant), "output")
    f, blocks = default_grid(S)[::25], structure("test", None, shape)
    at_peak, at = mu_peak(S, f_hz=f)
    fine = np.unique(np.concatenate([f, at * (1 + np.linspace(-3e-3, 3e-3, 31)), [at]]))
    close = upper.upper_bound(stacked(S, fine), blocks).value
    assert at_peak == pytest.approx(float(close.max()), rel=ACCURACY)
    assert close[fine == at][0] == pytest.approx(at_peak, rel=ACCURACY)
    every = mu_bounds(S, f_hz=f)
    assert every.upper.max() <= every.peak[0] <= at_peak * (1 + ACCURACY)


def test_few_lines_are_bounded_closely(rng, monkeypatch):
    lines = []

    def counted(M, blocks, enough=0.0):
        lines.append(len(M))
        return upper.upper_bound(M, blocks, enough)

    monkeypatch.setattr(largest, "upper_bound", counted)
    plant = lightly_damped(rng, 6, 6, 8)
    S = even_sensitivity(plant, estimated_feedback(plant), "output")
    peak, _ = mu_peak(S, f_hz=default_grid(S))
    print(f"{sum(lines)} lines of {default_grid(S).size} and nine rounds of fans")
    assert peak > 0
    assert sum(lines) < 200


def test_a_bound_that_is_low_enough_is_lowered_no_further(rng):
    M = rng.standard_normal((20, 4, 4)) + 1j * rng.standard_normal((20, 4, 4))
    blocks = structure("test", [REPEATED, 1, 1], (4, 4))
    close = upper.upper_bound(M, blocks).value
    enough = float(np.median(close))
    found = upper.upper_bound(M, blocks, enough).value
    assert np.all(found >= close * (1 - 1e-8))
    assert np.all(found[close < enough * (1 - 1e-7)] <= enough)
    np.testing.assert_allclose(found[close > enough], close[close > enough], rtol=1e-7)


def test_edges_of_the_largest_bound(rng):
    """No line, one, nothing to bound, a matrix of rank one, and the ends of the axis."""
    blocks = structure("test", [1, 1, 1], (3, 3))
    bound = LargestBound(blocks)
    assert bound(np.zeros(0), np.zeros((0, 3, 3), complex)).shape == (0,)
    nothing = np.zeros((4, 3, 3), complex)
    np.testing.assert_array_equal(bound(np.arange(4.0), nothing), 0.0)
    assert bound.highest == 0
    u, v = rng.standard_normal((2, 3))
    one = np.outer(u, v)[None] + 0j
    assert bound(np.array([7.0]), one)[0] == pytest.approx(np.abs(u * v).sum(), rel=1e-8)
    far = np.array([0.0, 1e-3, 1e9, np.inf])
    assert bound(far, one * np.array([1.0, 2.0, 3.0, 4.0])[:, None, None]).max() == pytest.approx(
        4 * np.abs(u * v).sum(), rel=1e-8
    )
    one_way = np.triu(np.ones((3, 3)), 1)[None] + 0j
    assert LargestBound(blocks)(np.array([1.0]), one_way)[0] < 1e-8
    assert mu_peak(gain(np.zeros((3, 3))))[0] == 0
    assert mu_peak(gain(np.zeros((3, 3))), f_hz=[5.0]) == (0.0, 5.0)


def test_lines_alike_are_bounded_once(rng):
    """A response that does not change with frequency is settled by the scalings of one line."""
    M = rng.standard_normal((1, 5, 5)) + 1j * rng.standard_normal((1, 5, 5))
    blocks = structure("test", None, (5, 5))
    f = np.geomspace(0.1, 100, 300)
    found = LargestBound(blocks)(f, np.repeat(M, 300, axis=0))
    np.testing.assert_allclose(found, upper.upper_bound(M, blocks).value[0], rtol=2 * SAME)


def test_balance_is_the_same_alone_and_in_company(rng):
    """Lines that have settled leave the others to go on; no line's levels depend on what is beside it."""
    power = 10.0 ** rng.uniform(-6, 6, (30, 5, 5))
    together = levels.balanced_levels(power)
    alone = np.concatenate([levels.balanced_levels(one[None]) for one in power])
    np.testing.assert_allclose(together, alone, atol=1e-12)
