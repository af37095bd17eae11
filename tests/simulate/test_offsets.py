"""Sensors with an offset: it hides no mode, and is named where it drives a command to its limit."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.bench import Wrapped
from ultraquiet.values import Channel, StateSpace

RATE_HZ = 500.0
POLE = 0.98 * np.exp(0.4j)


def gap_bench(offset, noise, limit=10.0):
    """One mode, newtons in, a gap in micrometres out, far from the middle of its sensor."""
    x, rng = np.zeros(1, dtype=complex), [np.random.default_rng(0)]

    def reset(run_index):
        x[:], rng[0] = 0.0, np.random.default_rng(run_index)

    def step(u, d):
        y = x.imag + offset + noise * rng[0].standard_normal(1)
        x[:] = POLE * x + 0.1 * (u + d)
        return y

    force, gap = Channel("coil", "N", -limit, limit), Channel("gap", "µm", -100.0, 100.0)
    return Wrapped(step, reset, RATE_HZ, [force], [gap])


def law(gain):
    """A damping law: the difference of two readings, and a share of the reading itself."""
    return StateSpace([[0.0]], [[1.0]], [[gain]], [[-gain]], RATE_HZ)


@pytest.mark.gate("10.0")
@pytest.mark.parametrize("offset", [0.0, 1e-3, 10.0, -60.0])
def test_a_loop_behind_an_offset_is_known_as_well_as_without(offset):
    check = uq.simulate.check_stability(gap_bench(offset, 1e-3), law(0.5), 8.0)
    print(f"offset {offset:g} µm: {check.status}, {check.growth_per_s:.3f} per s after {check.duration_s:.3g} s")
    assert check.status.word == "ok"


@pytest.mark.slow
def test_an_offset_hides_no_growth():
    check = uq.simulate.check_stability(gap_bench(10.0, 1e-3), law(-1.75), 8.0)
    print(check.status)
    assert check.status.word == "unstable"


def test_an_offset_that_drives_a_command_to_its_limit_is_named():
    proportional = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-0.3]], RATE_HZ)
    check = uq.simulate.check_stability(gap_bench(60.0, 1e-3), proportional, 2.0)
    print(check.status)
    assert check.status.word != "ok"
    assert "The offset of 'gap', 60 µm, alone drives a command to its limit" in check.status.sentence


@pytest.mark.slow
def test_an_offset_hides_no_line_of_the_sensitivity():
    """The same loop with and without an offset of a thousand deviations of its noise."""
    found = [uq.simulate.measure_sensitivity(gap_bench(offset, 1e-2), law(0.5)) for offset in (0.0, 10.0)]
    peaks = [each.peak_amplification_db() for each in found]
    hidden = [int(each.hidden.sum()) for each in found]
    print(f"peaks {peaks[0]:.2f} and {peaks[1]:.2f} dB, lines hidden {hidden}")
    assert abs(peaks[1] - peaks[0]) < 0.3
    assert hidden[1] <= hidden[0] + 0.05 * found[1].f_hz.size
