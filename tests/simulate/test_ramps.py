"""Laws that integrate what their loop does not feel: their commands ramp, and nobody calls that settled."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.bench import Wrapped
from ultraquiet.values import Channel, StateSpace

RATE_HZ = 500.0


def bench(offset, blocks_rest, noise=1e-3):
    """One mode, newtons in, millimetres a second out where it `blocks_rest`, else what it is."""
    x, before, rng = np.zeros(1, dtype=complex), [0.0], [np.random.default_rng(0)]

    def reset(run_index):
        x[:], before[0], rng[0] = 0.0, 0.0, np.random.default_rng(run_index)

    def step(u, d):
        now = x.imag.copy()
        y = now - before[0] * blocks_rest + offset + noise * rng[0].standard_normal(1)
        before[0] = now
        x[:] = 0.98 * np.exp(0.4j) * x + 0.1 * (u + d)
        return y

    return Wrapped(step, reset, RATE_HZ, [Channel("coil", "N", -10.0, 10.0)], [Channel("rate", "mm/s", -100.0, 100.0)])


def law(pole, gain):
    return StateSpace([[pole]], [[1.0]], [[gain]], [[-0.5 if gain < 0 else 0.0]], RATE_HZ)


@pytest.mark.parametrize(("offset", "gain"), [(1e-1, -1e-2), (1e-2, -1e-3)])
def test_an_offset_that_a_law_integrates_and_the_plant_blocks_ramps(offset, gain):
    check = uq.simulate.check_stability(bench(offset, blocks_rest=True), law(1.0, gain), 8.0)
    print(check.status)
    assert check.status.word == "not known"
    slope = float(check.status.sentence.split("ramps by ")[1].split(" N a second")[0])
    assert slope == pytest.approx(offset * abs(gain) * RATE_HZ, rel=0.1)


def test_a_law_that_leaks_comes_to_rest():
    check = uq.simulate.check_stability(bench(1e-1, blocks_rest=True), law(0.99, -1e-2), 8.0)
    print(check.status)
    assert check.status.word == "ok"


def test_an_integrator_that_the_loop_feels_is_ok():
    """Its command goes where the offset sends it, and stays."""
    check = uq.simulate.check_stability(bench(1e-1, blocks_rest=False), law(1.0, -2e-3), 8.0)
    print(check.status)
    assert check.status.word == "ok"
