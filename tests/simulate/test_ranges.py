"""Verdicts where ranges do not lie about zero, where readings are cut, and where a bench fails."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from ultraquiet._base.errors import BenchError, InputError, InterlockError
from ultraquiet.bench import LinearBench, Wrapped
from ultraquiet.simulate import check_stability, commission, measure_sensitivity
from ultraquiet.values import Channel, StateSpace
from ultraquiet.values.interconnect import gain

RATE_HZ = 1000.0
# Velocity-like feedback without gain at rest: where a sensor rests says nothing to it.
AT_REST_NOTHING = StateSpace([[0.99]], [[1.0]], [[0.005]], [[-0.5]], RATE_HZ)


def rig(low, high, rest, unit=1.0):
    """A lag whose reading stands at `rest` and is cut at its limits."""
    x = [0.0]

    def step(u, d):
        y = min(max(unit * (x[0] + rest), low), high)
        x[0] = 0.9 * x[0] + u[0] + d[0]
        return [y]

    def reset():
        x[0] = 0.0

    return Wrapped(step, reset, RATE_HZ, [Channel("coil", "V", -10.0, 10.0)], [Channel("gap", "nm", low, high)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("low", "high", "rest", "unit"), [(0.0, 10.0, 5.0, 1.0), (4.0, 20.0, 12.0, 1.0), (0.0, 1e-8, 5.0, 1e-9)]
)
def test_a_range_that_begins_at_zero_is_counted_from_where_a_reading_rests(low, high, rest, unit):
    law = StateSpace(AT_REST_NOTHING.A, AT_REST_NOTHING.B, AT_REST_NOTHING.C / unit, AT_REST_NOTHING.D / unit, RATE_HZ)
    bench = rig(low, high, rest, unit)
    assert check_stability(bench, law, 2.0).status.ok
    found = commission(bench, law, (5.0, 30.0), gains=(0.1, 0.3), seconds=0.5, settle_s=1.0, watched_s=0)
    print(found.status)
    assert found.status.ok


@pytest.mark.slow
def test_what_a_slow_law_makes_of_an_offset_is_no_noise():
    """It dies with 1.6 a second, long after the middle of a run of the faster band; the loop is the same."""
    benches = rig(-np.inf, np.inf, 0.0), rig(0.0, 10.0, 5.0)
    both = [measure_sensitivity(bench, AT_REST_NOTHING).worst_in_band_db(5.0, 30.0) for bench in benches]
    print(both)
    assert both[1] == pytest.approx(both[0], abs=0.05)


@pytest.mark.parametrize(("low", "high"), [(0.0, 10.0), (4.0, 20.0), (-5.0, 0.0)])
def test_commands_need_room_about_zero(low, high):
    plant = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ, [Channel("piezo", "V", low, high)], ["gap"])
    bench, law = LinearBench(plant), gain([[-0.5]], RATE_HZ)
    for ask in (check_stability, measure_sensitivity, lambda b, k: commission(b, k, (5.0, 30.0))):
        with pytest.raises(InputError, match="no room about zero"):
            ask(bench, law)


@pytest.mark.parametrize(("command", "reading"), [(100.0, np.inf), (np.inf, 100.0), (100.0, 100.0)])
def test_a_mode_is_told_from_what_came_before_any_limit(command, reading):
    """What a limit makes of a growing mode, its overtones and their images, is none of the loop's."""

    def block(f_hz, damping):
        p = np.exp(2 * np.pi * f_hz / RATE_HZ * complex(-damping, np.sqrt(1 - damping**2)))
        return np.array([[p.real, p.imag], [-p.imag, p.real]])

    plant = StateSpace(
        block_diag(block(10.0, 0.05), block(203.0, 5e-4)),
        [[0.0], [0.05], [0.0], [0.01]],
        [[1.0, 0.0, 1.0, 0.0]],
        [[0.0]],
        RATE_HZ,
        [Channel("coil", "V", -command, command)],
        [Channel("gap", "nm", -reading, reading)],
    )
    found = check_stability(LinearBench(plant), StateSpace([[0.0]], [[1.0]], [[-0.3]], [[0.0]], RATE_HZ))
    print(found.status)
    assert found.status.word == "unstable"
    assert found.growth_hz == pytest.approx(202.80, abs=0.01)
    assert found.growth_per_s == pytest.approx(0.1997, abs=1e-3)


STOPPED = InterlockError("Rig: the emergency stop was pressed.", "stop", 3000, 1.0)


@pytest.mark.parametrize("error", [BenchError("Rig: the cable was pulled."), STOPPED])
def test_a_bench_that_fails_says_nothing_of_the_law(error):
    calls, x = [], [0.0]

    def step(u, d):
        calls.append(u)
        if len(calls) > 3000:
            raise error
        x[0] = 0.9 * x[0] + u[0] + d[0]
        return list(x)

    bench = Wrapped(step, lambda: None, RATE_HZ, ["coil"], ["gap"])
    with pytest.raises(BenchError, match="Rig: the"):
        check_stability(bench, gain([[-0.5]], RATE_HZ), 2.0)
