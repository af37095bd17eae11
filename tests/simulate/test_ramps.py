"""Laws that integrate what their loop does not feel: their commands ramp, and nobody calls that settled."""

import pytest
from one_mode import RATE_HZ, one_mode

import ultraquiet as uq
from ultraquiet.values import StateSpace


def law(pole, gain):
    return StateSpace([[pole]], [[1.0]], [[gain]], [[-0.5 if gain < 0 else 0.0]], RATE_HZ)


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "gain"), [(1e-1, -1e-2), (1e-2, -1e-3)])
def test_an_offset_that_a_law_integrates_and_the_plant_blocks_ramps(offset, gain):
    check = uq.simulate.check_stability(one_mode("rate", "mm/s", offset=offset, blocks_rest=True), law(1.0, gain), 8.0)
    print(check.status)
    assert check.status.word == "not known"
    slope = float(check.status.sentence.split("ramps by ")[1].split(" N a second")[0])
    assert slope == pytest.approx(offset * abs(gain) * RATE_HZ, rel=0.1)


@pytest.mark.slow
def test_a_law_that_leaks_comes_to_rest():
    check = uq.simulate.check_stability(one_mode("rate", "mm/s", offset=1e-1, blocks_rest=True), law(0.99, -1e-2), 8.0)
    print(check.status)
    assert check.status.word == "ok"


@pytest.mark.slow
def test_an_integrator_that_the_loop_feels_is_ok():
    """Its command goes where the offset sends it, and stays."""
    check = uq.simulate.check_stability(one_mode("rate", "mm/s", offset=1e-1, blocks_rest=False), law(1.0, -2e-3), 8.0)
    print(check.status)
    assert check.status.word == "ok"


@pytest.mark.slow
def test_an_integrator_whose_command_stands_still_is_ok():
    idle = StateSpace([[1.0]], [[1.0]], [[0.0]], [[0.0]], RATE_HZ)
    check = uq.simulate.check_stability(one_mode("rate", "mm/s", offset=1e-1, blocks_rest=True), idle, 8.0)
    print(check.status)
    assert check.status.word == "ok"
