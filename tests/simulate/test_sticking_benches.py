"""Loops behind a dead zone: one that grows once it moves is not called settled because it rests below that."""

import numpy as np
import pytest
from one_mode import ANGLE, difference, one_mode

import ultraquiet as uq
from ultraquiet.simulate import disturb

RANGE_N = 10.0


def stays_at_its_limits(dead_n, gain):
    """Return whether a burst of half the range, at the mode, leaves commands at their limits for good."""
    d = np.zeros((1, 8000))
    d[0, :100] = RANGE_N / 2 * np.sin(ANGLE * np.arange(100))
    late = disturb(one_mode(limit_n=RANGE_N, dead_n=dead_n), d, difference(gain)).inputs[:, -2000:]
    return bool((np.abs(late) >= RANGE_N).any())


@pytest.mark.gate("-2.5-0.1", "0.5-1.0")
@pytest.mark.parametrize("dead_n", [0.0, 0.01, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("gain", [-2.5, -1.9, 0.5])
def test_what_a_loud_burst_throws_into_its_limits_is_not_called_settled(dead_n, gain):
    check = uq.simulate.check_stability(one_mode(limit_n=RANGE_N, dead_n=dead_n), difference(gain), 4.0)
    truth = stays_at_its_limits(dead_n, gain)
    print(f"dead zone {dead_n} N, gain {gain}: {truth}; {check.status}")
    assert check.status.word == ("unstable" if truth else "ok")


@pytest.mark.slow
def test_growth_that_is_slow_beside_the_dead_zone_is_seen_in_any_unit():
    words = []
    for unit in (1.0, 1e9, 1e-9):
        check = uq.simulate.check_stability(one_mode(dead_n=0.01, unit=unit), difference(-1.75, unit), 8.0)
        words.append(check.status.word)
        assert check.growth_per_s == pytest.approx(0.186, abs=4 * check.growth_std_per_s)
    assert words == ["unstable"] * 3
