"""Loops behind a dead zone: one that grows once it moves is not called settled because it rests below that."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.bench import Wrapped
from ultraquiet.simulate import disturb
from ultraquiet.values import Channel, StateSpace

RATE_HZ = 500.0
RADIUS, ANGLE = 0.98, 0.4
RANGE_N = 10.0


def bench(dead_n, unit=1.0, noise=1e-3):
    """One mode behind an actuator that does nothing below `dead_n`."""
    x, rng, pole = np.zeros(1, dtype=complex), [np.random.default_rng(0)], RADIUS * np.exp(1j * ANGLE)

    def reset(run_index):
        x[:], rng[0] = 0.0, np.random.default_rng(run_index)

    def step(u, d):
        y = unit * (x.imag + noise * rng[0].standard_normal(1))
        force = u + d
        x[:] = pole * x + 0.1 * np.sign(force) * np.maximum(np.abs(force) - dead_n, 0.0)
        return y

    coil, gap = Channel("coil", "N", -RANGE_N, RANGE_N), Channel("gap", "mm", -100.0 * unit, 100.0 * unit)
    return Wrapped(step, reset, RATE_HZ, [coil], [gap])


def law(gain, unit=1.0):
    """A difference of two readings."""
    return StateSpace([[0.0]], [[1.0]], [[gain / unit]], [[-gain / unit]], RATE_HZ)


def stays_at_its_limits(dead_n, gain):
    """Return whether a burst of half the range, at the mode, leaves commands at their limits for good."""
    d = np.zeros((1, 8000))
    d[0, :100] = RANGE_N / 2 * np.sin(ANGLE * np.arange(100))
    late = disturb(bench(dead_n), d, law(gain)).inputs[:, -2000:]
    return bool((np.abs(late) >= RANGE_N).any())


@pytest.mark.gate("-2.5-0.1", "0.5-1.0")
@pytest.mark.parametrize("dead_n", [0.0, 0.01, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("gain", [-2.5, -1.9, 0.5])
def test_what_a_loud_burst_throws_into_its_limits_is_not_called_settled(dead_n, gain):
    check = uq.simulate.check_stability(bench(dead_n), law(gain), 4.0)
    truth = stays_at_its_limits(dead_n, gain)
    print(f"dead zone {dead_n} N, gain {gain}: {truth}; {check.status}")
    assert check.status.word == ("unstable" if truth else "ok")


@pytest.mark.slow
def test_growth_that_is_slow_beside_the_dead_zone_is_seen_in_any_unit():
    words = []
    for unit in (1.0, 1e9, 1e-9):
        check = uq.simulate.check_stability(bench(0.01, unit), law(-1.75, unit), 8.0)
        words.append(check.status.word)
        assert check.growth_per_s == pytest.approx(0.186, abs=4 * check.growth_std_per_s)
    assert words == ["unstable"] * 3
