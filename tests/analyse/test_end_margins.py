"""Margins at one end of a plant, held against the poles of the loop that they speak of."""

import numpy as np
import pytest
from loops import alone, estimated_feedback, in_other_units, lightly_damped, radius, slow_loop, stiff

from ultraquiet._base.errors import InputError
from ultraquiet.analyse import disk_margins, end_margins, loop_margins
from ultraquiet.analyse.margins import even_sensitivity
from ultraquiet.analyse.peaks import response_at
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain

SHAPES = [(1, 1), (4, 3), (3, 5)]
SIDES = ["input", "output"]
SHARE = 1e-3  # of a change, by which it is passed or not reached


def factors_of(found, channel):
    """Yield the factors of a channel at which it says that the loop is on the verge."""
    changes = (found.gain_up_db[channel], -found.gain_down_db[channel])
    yield from (10 ** (db / 20) for db in changes if np.isfinite(db))
    if np.isfinite(found.phase_deg[channel]):
        yield np.exp(1j * np.radians(found.phase_deg[channel]))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("shape", SHAPES)
def test_each_change_of_one_channel_is_where_a_pole_passes_the_unit_circle(seed, shape, side):
    plant = lightly_damped(np.random.default_rng(seed), *shape)
    law = estimated_feedback(plant, 1e-4)
    found = loop_margins(plant, law, side)
    count = found.disk.size
    assert np.isfinite(found.gain_up_db).any()
    for channel in range(count):
        if not np.isfinite(found.phase_deg[channel]):  # of a channel that hardly acts, no phase upsets the loop
            turns = np.exp(1j * np.radians(np.arange(15, 360, 15)))
            assert max(radius(plant, law, side, alone(count, channel, turn)) for turn in turns) < 1
        for factor in factors_of(found, channel):
            assert radius(plant, law, side, alone(count, channel, factor ** (1 - SHARE))) < 1
            assert radius(plant, law, side, alone(count, channel, factor ** (1 + SHARE))) > 1


@pytest.mark.parametrize(("shape", "side"), [((1, 1), "output"), ((4, 3), "input"), ((3, 5), "output")])
def test_nothing_smaller_than_the_least_change_upsets_the_loop_and_it_does(seed, shape, side):
    plant = lightly_damped(np.random.default_rng(seed + 10), *shape)
    law = estimated_feedback(plant, 1e-4)
    found = end_margins(plant, law, side)
    least, count = found.least_change, found.disk.size
    factor = 10 ** (least.amount / 20) if least.kind == "gain" else np.exp(1j * np.radians(least.amount))
    assert radius(plant, law, side, alone(count, least.channel, factor ** (1 + SHARE))) > 1
    assert least.disk * (1 + 1e-12) >= found.disk.min() >= found.disk_all
    for size in (0.25 * least.disk, 0.5 * least.disk, (1 - SHARE) * least.disk):
        for smaller in ((2 + size) / (2 - size), (2 - size) / (2 + size), np.exp(2j * np.arctan(size / 2))):
            for channel in range(count):
                assert radius(plant, law, side, alone(count, channel, smaller)) < 1


@pytest.mark.parametrize("side", SIDES)
def test_a_loop_stands_every_draw_from_its_disk_and_falls_to_the_worst_beyond(seed, side):
    rng = np.random.default_rng(seed)
    plant = lightly_damped(rng, 4, 3)
    law = estimated_feedback(plant, 1e-3)
    found, worst = end_margins(plant, law, side), disk_margins(plant, law, side)
    assert found.disk_all == pytest.approx(worst.alpha, rel=1e-6)
    count = found.disk.size
    for _ in range(100):
        d = 0.999 * found.disk_all * np.exp(2j * np.pi * rng.random(count)) * rng.random(count) ** 0.1
        assert radius(plant, law, side, (2 + d) / (2 - d)) < 1
    d = 2 * (worst.factors - 1) / (worst.factors + 1) * (1 + SHARE)
    assert radius(plant, law, side, (2 + d) / (2 - d)) > 1


@pytest.mark.parametrize("zeta", [1e-3, 1e-5, 1e-7])
def test_a_needle_far_narrower_than_the_grid_is_met(zeta):
    """A mode beside a loop of modest gain, with a residue that takes its Nyquist curve round -1.2."""
    rate, w = 2000.0, 2 * np.pi * 123.4 / 2000.0
    z = np.exp(w * (-zeta + 1j * np.sqrt(1 - zeta**2)))
    A = np.array([[z.real, z.imag], [-z.imag, z.real]])
    B = np.array([[1 - abs(z)], [0.0]])
    peak = abs((np.array([[1.0, 0.0]]) @ np.linalg.solve(np.exp(1j * w) * np.eye(2) - A, B)).item())
    plant = StateSpace(A, B, [[1.0, 0.0]], [[0.0]], rate)
    law = gain([[1 / peak * 0.9]], rate)
    found = end_margins(plant, law)
    up = 10 ** (found.gain_up_db[0] / 20)
    assert 1.0 < up < 1.25
    assert radius(plant, law, "output", [up * 0.9999]) < 1 < radius(plant, law, "output", [up * 1.0001])


def test_units_and_states_change_no_margin(seed):
    plant = lightly_damped(np.random.default_rng(seed), 3, 2)
    law = estimated_feedback(plant)
    du, dy = np.array([1e9, 1e-9]), np.array([1e-9, 1.0, 1e9])
    dx = 10.0 ** np.linspace(-9, 9, plant.states)
    other = StateSpace(
        plant.A * dx[:, None] / dx, plant.B * dx[:, None] * du, plant.C / dx * dy[:, None], plant.D, plant.rate_hz
    )
    turned = StateSpace(law.A, law.B / dy, law.C / du[:, None], law.D, law.rate_hz)
    for side in SIDES:
        one, two = end_margins(plant, law, side), end_margins(other, turned, side)
        assert two.disk_all == pytest.approx(one.disk_all, rel=1e-5)
        assert two.gain_up_db == pytest.approx(one.gain_up_db, rel=1e-5)
        assert two.phase_deg == pytest.approx(one.phase_deg, rel=1e-5)
        assert two.least_change.channel == one.least_change.channel


def test_an_unstable_loop_has_no_margin_and_a_side_has_a_name():
    plant = StateSpace([[1.1]], [[1.0]], [[1.0]], [[0.0]], 100.0)
    found = end_margins(plant, gain([[0.0]], 100.0))
    assert found.disk_all == 0.0
    assert found.least_change is None
    with pytest.raises(InputError, match="side"):
        end_margins(plant, gain([[0.0]], 100.0), "both")


def test_a_loop_that_does_nothing_stands_everything():
    found = end_margins(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 100.0), gain([[0.0]], 100.0))
    assert found.disk_all == pytest.approx(2.0)
    assert found.least_change is None


def test_a_response_keeps_its_digits_when_states_come_in_units_decades_apart(seed):
    plant = lightly_damped(np.random.default_rng(seed), 2, 2, modes=6)
    f = np.geomspace(1.0, 900.0, 50)
    dx = 10.0 ** np.random.default_rng(seed).uniform(-9, 9, plant.states)
    other = StateSpace(plant.A * dx[:, None] / dx, plant.B * dx[:, None], plant.C / dx, plant.D, plant.rate_hz)
    assert np.allclose(other.frequency_response(f), plant.frequency_response(f), rtol=1e-8, atol=0)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("zeros", "poles"),
    [
        ((1.6330, 1.6472, -0.1772), (-0.6815, -1.0831, -0.5097)),
        ((1.5378, 3.0315, -0.1914), (-0.5254, -0.6025, -1.5836)),
        ((1.3690, 2.8041, -0.1953), (-0.5688, -0.6297, -1.5171)),
    ],
)
def test_a_crossing_between_an_end_of_the_axis_and_the_poles_next_to_it_is_met(zeros, poles, shape, mirrored):
    """Of poles five decades below the sampling rate, where the grid's own lines are not."""
    plant, law = slow_loop(zeros, poles, 5e4, shape, mirrored)
    for loop in ((plant, law), in_other_units(plant, law)):
        for side in SIDES:
            found = end_margins(*loop, side)
            for factor in factors_of(found, 0):
                assert radius(plant, law, side, alone(found.disk.size, 0, factor ** (1 - SHARE))) < 1
                assert radius(plant, law, side, alone(found.disk.size, 0, factor ** (1 + SHARE))) > 1
            assert found.least_change.disk >= found.disk.min() - 1e-9


@pytest.mark.parametrize(("shape", "draw"), [((1, 1), 0), ((4, 3), 1), ((3, 5), 2), ((3, 5), 44)])
def test_a_response_counts_as_real_at_the_ends_of_the_axis_whatever_rounding_leaves(shape, draw):
    plant, law = stiff(np.random.default_rng(draw), *shape)
    for loop in ((plant, law), in_other_units(plant, law)):
        found = loop_margins(*loop)
        for channel, db in enumerate(found.gain_up_db):
            up = 10 ** (min(db, 80.0) * (1 - SHARE) / 20)
            assert radius(plant, law, "output", alone(shape[0], channel, up)) < 1
            if np.isfinite(db):
                up = 10 ** (db * (1 + SHARE) / 20)
                assert radius(plant, law, "output", alone(shape[0], channel, up)) > 1


def test_a_crossing_is_met_in_continuous_time_far_below_a_fast_mode():
    """The slow loop of above at 1e-4 rad/s, and a fast pair whose poles and zeros differ by a little."""
    fast = np.exp(1j * np.pi * np.array([[0.502, -0.502], [0.501, -0.501]])) * 3e4
    poles, zeros = (
        np.r_[-1e-4 * np.array([0.6815, 1.0831, 0.5097]), fast[0]],
        np.r_[1e-4 * np.array([1.6330, 1.6472, -0.1772]), fast[1]],
    )
    numerator, denominator = np.poly(zeros).real, np.poly(poles).real
    A = np.vstack([-numerator[1:], np.eye(4, 5)])
    plant = StateSpace(A, np.eye(5, 1), (numerator - denominator)[None, 1:], [[0.0]])
    found = loop_margins(plant, gain([[1.0]]))

    def growth(db):
        return np.roots(numerator - 10 ** (db / 20) * (numerator - denominator)).real.max()

    for db in (found.gain_up_db[0], -found.gain_down_db[0]):
        assert all(growth(share * db) < 0 for share in (0.25, 0.5, 0.75, 1 - SHARE) if np.isfinite(db))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("side", SIDES)
def test_margins_of_a_loop_whose_poles_are_nearly_alike_are_those_of_its_poles(shape, side):
    """Modes alone put a crossing of 5.9 degrees at 1.5."""
    plant, law = slow_loop((0.60889889, 1.49418956, 0.33639568), (-0.30485982, -0.30528791, -0.30160304), 5e4, shape)
    for loop in ((plant, law), in_other_units(plant, law)):
        found = end_margins(*loop, side)
        for factor in factors_of(found, 0):
            assert radius(plant, law, side, alone(found.disk.size, 0, factor ** (1 - SHARE))) < 1
            assert radius(plant, law, side, alone(found.disk.size, 0, factor ** (1 + SHARE))) > 1
        f = np.geomspace(1e-3, 1e4, 200)
        S = even_sensitivity(*loop, side)
        expected = np.linalg.solve(np.exp(2j * np.pi * f / 5e4)[:, None, None] * np.eye(S.states) - S.A, S.B + 0j)
        expected = np.moveaxis(S.C @ expected + S.D, 0, 2)
        assert np.abs(response_at(S)(f) - expected).max() < 1e-7 * np.abs(expected).max()
