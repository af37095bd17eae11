"""Modes that are alike: the largest of their growths is believed as rarely by mistake as that of one by itself."""

import numpy as np
import pytest
from scipy.special import ndtr
from test_wandering_readings import slow_loop

import ultraquiet as uq
from ultraquiet.simulate.free_response import CERTAIN, Mode
from ultraquiet.simulate.growth.coincident import _complex_passed, _real_passed, farthest_of, widened

DRAWN = 200_000


@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_largest_eigenvalue_passes_a_level_as_often_as_is_said(count, real):
    """200 000 matrices of fixed draws, at three deviations, against the counts' own deviation."""
    rng = np.random.default_rng(count)
    E = rng.standard_normal((DRAWN, count, count)) + (0 if real else 1j * rng.standard_normal((DRAWN, count, count)))
    largest = np.linalg.eigvalsh((E + E.conj().swapaxes(1, 2)) / 2)[:, -1]
    said = (_real_passed if real else _complex_passed)(count, 3.0)
    seen = np.mean(largest > 3.0)
    print(f"{count} modes: {seen:.5f} seen, {said:.5f} said")
    assert abs(seen - said) < 5 * np.sqrt(said / DRAWN)


@pytest.mark.parametrize("real", [True, False])
def test_the_level_of_many_is_as_rare_as_that_of_one(real):
    counts = [*range(1, 7), 16, 64, 99]
    levels = [farthest_of(count, real) for count in counts]
    print(np.round(levels, 3))
    assert levels[0] == CERTAIN
    assert np.all(np.diff(levels) > 0)
    passed = _real_passed if real else _complex_passed
    for count, level in zip(counts[1:], levels[1:], strict=True):
        assert passed(count, level) == pytest.approx(ndtr(-CERTAIN), rel=1e-9)
    assert levels[-1] < farthest_of(100, real) < farthest_of(1000, real)


def test_only_modes_that_are_alike_are_known_less_well():
    modes = [Mode(growth, 0.1, f_hz, 30.0) for growth, f_hz in ((0.2, 0.0), (0.0, 0.0), (-9.0, 0.0), (0.1, 5.0))]
    rates = np.array([m.growth_per_s + 2j * np.pi * m.f_hz for m in modes])
    shares = [m.growth_std / 0.1 for m in widened(modes, rates, 3, real=True)]
    assert shares == pytest.approx([farthest_of(2, True) / CERTAIN] * 2 + [1.0, 1.0])


@pytest.mark.parametrize("real", [True, False])
def test_of_a_faint_mode_at_rest_all_channels_count(real):
    (mode,) = widened([Mode(0.2, 0.1, 0.0, 3.0)], np.array([0.2 + 0.0j]), 3, real)
    assert mode.growth_std == pytest.approx(0.1 * farthest_of(3 if real else 1, real) / CERTAIN)


@pytest.mark.gate("1208")
@pytest.mark.parametrize("draw", [1039, 1072, 1130, 1198, 1208, 1246])
def test_walks_of_several_channels_are_no_growth(draw):
    """Six of 250 draws, each of three or four channels, that were called unstable by 4.0 to 4.5 deviations."""
    check = uq.simulate.check_stability(*slow_loop(np.random.default_rng(draw), None, 0.01), 4.0)
    print(check.status)
    assert check.status.word != "unstable"
