"""Sensors with an offset: it hides no mode, and is named where it drives a command to its limit."""

import numpy as np
import pytest
from one_mode import POLE, RATE_HZ, difference, one_mode

import ultraquiet as uq
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback


def gap_bench(offset, noise):
    """One mode, newtons in, a gap in micrometres out, far from the middle of its sensor."""
    return one_mode(of="µm", offset=offset, noise=noise)


def proportional(gain):
    return StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[gain]], RATE_HZ)


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.0, 1e-3, 10.0, -60.0])
def test_a_loop_behind_an_offset_is_known_as_well_as_without(offset):
    check = uq.simulate.check_stability(gap_bench(offset, 1e-3), difference(0.5), 8.0)
    print(f"offset {offset:g} µm: {check.status}, {check.growth_per_s:.3f} per s after {check.duration_s:.3g} s")
    assert check.status.word == "ok"


@pytest.mark.slow
def test_an_offset_hides_no_growth():
    check = uq.simulate.check_stability(gap_bench(10.0, 1e-3), difference(-1.75), 8.0)
    print(check.status)
    assert check.status.word == "unstable"


def test_an_offset_that_drives_a_command_to_its_limit_is_named():
    check = uq.simulate.check_stability(gap_bench(60.0, 1e-3), proportional(-0.3), 2.0)
    print(check.status)
    assert check.status.word != "ok"
    assert "The offset of 'gap', 60 µm, alone drives a command to its limit" in check.status.sentence


@pytest.mark.slow
def test_what_an_offset_heaps_up_is_no_growth():
    """A law that follows an offset slowly: commands grow from next to nothing, in a loop that decays all the time."""
    lagging = StateSpace([[0.9995]], [[1.0]], [[-0.0003]], [[0.0]], RATE_HZ)
    check = uq.simulate.check_stability(gap_bench(60.0, 1e-3), lagging, 8.0)
    print(check.status)
    assert check.status.word == "not known"
    assert "The offset of 'gap', 60 µm, alone drives a command to its limit" in check.status.sentence


@pytest.mark.slow
def test_a_law_that_follows_an_offset_within_its_limits_is_ok():
    lagging = StateSpace([[0.9995]], [[1.0]], [[-0.0003]], [[0.0]], RATE_HZ)
    within = uq.simulate.check_stability(gap_bench(6.0, 1e-3), lagging, 30.0)
    assert within.status.word == "ok"


@pytest.mark.slow
def test_what_a_law_of_two_lags_heaps_up_is_no_growth():
    """Behind two slow lags what an offset drives grows as time squared, far below half of it half the time before."""
    a = 0.9995
    twice = StateSpace([[a, 0.0], [1.0, a]], [[1.0], [0.0]], [[0.0, -1.5e-7]], [[0.0]], RATE_HZ)
    check = uq.simulate.check_stability(gap_bench(60.0, 1e-3), twice, 8.0)
    print(check.status)
    assert check.status.word == "not known"


@pytest.mark.gate("0.5")
@pytest.mark.parametrize("offset", [0.05, 0.5])
def test_growth_that_an_offset_drives_to_its_limits_is_known(offset):
    """However weak the burst, the step of the offset grows until a command stands at its limit: that is the growth."""
    law, later = proportional(-0.95), StateSpace([[0.0]], [[1.0]], [[-0.95]], [[0.0]], RATE_HZ)  # this bench is late
    p = POLE
    plant = StateSpace([[p.real, -p.imag], [p.imag, p.real]], [[0.1], [0.0]], [[0.0, 1.0]], [[0.0]], RATE_HZ)
    truth = RATE_HZ * np.log(np.abs(feedback(plant, later).poles()).max())
    check = uq.simulate.check_stability(gap_bench(offset, 1e-3), law, 8.0)
    print(f"{check.status} Truth: {truth:.3f} per s")
    assert check.status.word == "unstable"
    assert abs(check.growth_per_s - truth) < 4 * check.growth_std_per_s


@pytest.mark.slow
def test_an_offset_hides_no_line_of_the_sensitivity():
    """The same loop with and without an offset of a thousand deviations of its noise."""
    found = [uq.simulate.measure_sensitivity(gap_bench(offset, 1e-2), difference(0.5)) for offset in (0.0, 10.0)]
    peaks = [each.peak_amplification_db() for each in found]
    hidden = [int(each.hidden.sum()) for each in found]
    print(f"peaks {peaks[0]:.2f} and {peaks[1]:.2f} dB, lines hidden {hidden}")
    assert abs(peaks[1] - peaks[0]) < 0.3
    assert hidden[1] <= hidden[0] + 0.05 * found[1].f_hz.size
