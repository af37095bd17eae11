"""Verdicts of loops whose truth is known: growth however slow is seen, decay however slow is not feared."""

import functools
from pathlib import Path

import numpy as np
import pytest
from drawn_loops import RATE_HZ, LinearBench, drawn_loop, modal, wrapped

import ultraquiet as uq
from ultraquiet._base.errors import InputError, InterlockError
from ultraquiet.simulate.free_response import CERTAIN
from ultraquiet.simulate.growth.verdict import CLIPPED_SHARE

LAW = Path(__file__).parents[1] / "data" / "slow_growth_law.npz"
LOOPS, HUMMING = 200, 40


@pytest.fixture(scope="module")
def slow_growth_law():
    with np.load(LAW) as held:
        return uq.StateSpace(held["A"], held["B"], held["C"], held["D"], float(held["rate_hz"]))


@pytest.mark.slow
def test_growth_within_half_a_minute_is_seen_in_a_minute(slow_growth_law):
    bench = uq.bench.Hexapod(unit="flight", linear=True)
    check = uq.simulate.check_stability(bench, slow_growth_law, model=bench.linear_model())
    print(f"{check.status}; {check.growth_per_s:.5f} +- {check.growth_std_per_s:.1g} at {check.growth_hz:.3f} Hz")
    assert check.status.word == "unstable"
    assert check.growth_per_s == pytest.approx(0.0271, abs=0.0005)
    assert check.growth_hz == pytest.approx(5.71, abs=0.01)
    assert check.model_growth_per_s == pytest.approx(0.0271, abs=0.0005)
    assert check.model_growth_hz == pytest.approx(5.71, abs=0.01)
    assert check.duration_s == 60.0


def test_a_limit_cycle_is_not_called_stable(slow_growth_law):
    check = uq.simulate.check_stability(uq.bench.Hexapod(unit="flight", seed=1, hysteresis=True), slow_growth_law)
    print(check.status)
    assert check.status.word in ("unstable", "not known")


@pytest.mark.slow
def test_the_noise_of_the_bench_hides_no_growth(slow_growth_law):
    check = uq.simulate.check_stability(uq.bench.Hexapod(unit="flight", seed=1), slow_growth_law)
    print(check.status)
    assert check.status.word == "unstable"
    assert check.growth_per_s == pytest.approx(0.0271, abs=4 * check.growth_std_per_s)


@pytest.mark.gate("-0.0003-1e-09")
@pytest.mark.parametrize(("apart", "unit"), [(3e-4, 1e9), (-3e-4, 1e-9)])
def test_growth_and_decay_are_measured_in_any_unit(apart, unit, rng):
    loop = drawn_loop(rng, 1 + apart, unit=unit)
    check = uq.simulate.check_stability(loop.bench, loop.law)
    print(f"{check.status}; true {loop.growth_per_s:.5f} at {loop.f_hz:.4f} Hz")
    assert check.status.word == ("unstable" if apart > 0 else "ok")
    assert check.growth_per_s == pytest.approx(loop.growth_per_s, rel=1e-3)
    assert check.growth_hz == pytest.approx(loop.f_hz, abs=0.01)


# Of 300 draws 5 are ok, four of them for a mode that noise of a tenth hides in so short a record, and 3 unstable.
@pytest.mark.draws(false_alarm=0.05)
def test_what_one_record_cannot_tell_is_not_known(rng):
    loop = drawn_loop(rng, 1 - 1e-7, noise=0.1)
    check = uq.simulate.check_stability(loop.bench, loop.law, 4.0)
    print(check.status)
    assert check.status.word == "not known"
    driven = "Noise alone drives" in check.status.sentence  # then not even a mode is told
    assert driven or CERTAIN * check.growth_std_per_s > abs(loop.growth_per_s)


@pytest.mark.slow
@pytest.mark.parametrize("apart", [3e-5, 6e-5])
def test_growth_that_reaches_the_limits_within_the_record_is_known(rng, apart):
    """Three records, whose readings are noisy and whose last one ends at the limits of the commands.

    Of a loop that noise alone drives there within each nothing is known, and that is said.
    """
    loop = drawn_loop(rng, 1 + apart, noise=0.03)
    check = uq.simulate.check_stability(loop.bench, loop.law)
    print(f"{check.status}; true {loop.growth_per_s:.4g} at {loop.f_hz:.4g} Hz")
    driven = check.status.word == "not known" and "Noise alone drives" in check.status.sentence
    assert check.status.word == "unstable" or driven


def test_growth_that_stands_among_what_noise_rings_is_not_called_settled():
    """A pair of 1 + 2.7e-5 whose tone no burst allowed is heard above, beside others that noise rings."""
    rng = np.random.default_rng(424243)
    apart = 10 ** rng.uniform(-6, -3) * rng.choice([-1, 1])
    loop = drawn_loop(rng, 1 + apart, rng.choice([0.0, 0.003, 0.03]), rng.random() < 0.7, rng.choice([1.0, 1e-9, 1e9]))
    check = uq.simulate.check_stability(loop.bench, loop.law)
    print(f"{check.status}; true {loop.growth_per_s:.4g} at {loop.f_hz:.4g} Hz")
    assert apart > 0
    assert check.status.word == "unstable"


# Of 640 such loops at the larger noise 13 are not known, most of them for noise alone, and of four then one in twelve
# draws; at the smaller none of 240.
@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.003, pytest.param(0.03, marks=pytest.mark.draws(false_alarm=0.08))])
def test_further_records_throw_no_slow_pair_into_its_limits(rng, noise):
    """A pair that needs two minutes to decay: bursts of other phases reach it otherwise than the first."""
    for _ in range(4):
        loop = drawn_loop(rng, 1 - 8e-6, noise=noise)
        check = uq.simulate.check_stability(loop.bench, loop.law)
        print(f"{check.status}; true {loop.growth_per_s:.4g} at {loop.f_hz:.4g} Hz")
        assert check.status.word == "ok"


@pytest.mark.slow
def test_growth_that_noise_drives_to_the_limits_within_every_record_is_known():
    """A pair of 1 + 9.4e-4: whatever burst or none, commands stand at their limits before four seconds are over."""
    rng = np.random.default_rng(8)
    for _ in range(192):
        apart = 10 ** rng.uniform(-6, -3) * rng.choice([-1, 1])
        drawn = rng.choice([0.0, 0.003, 0.03]), rng.random() < 0.7, rng.choice([1.0, 1e-9, 1e9])
        loop = drawn_loop(rng, 1 + apart, *drawn)
    check = uq.simulate.check_stability(loop.bench, loop.law)
    print(f"{check.status}; true {loop.growth_per_s:.4g} at {loop.f_hz:.4g} Hz")
    assert check.status.word == "unstable"
    assert check.growth_per_s == pytest.approx(loop.growth_per_s, abs=4 * check.growth_std_per_s)


@pytest.mark.parametrize("hz", ["mains", "the mode's"])
@pytest.mark.parametrize("apart", [-1e-3, 1e-4])
def test_what_hums_without_the_law_too_is_no_mode_of_the_loop(rng, apart, hz):
    """Mains of any phase and offsets, also at the very frequency of the slowest mode, which may hide what that does."""
    loop = drawn_loop(rng, 1 + apart, 0.003, limited=False)
    loop.bench.hum = (0.05, 50.0 if hz == "mains" else loop.f_hz, 0.1)
    check = uq.simulate.check_stability(loop.bench, loop.law)
    print(f"{check.status}; true {loop.growth_per_s:.4g} at {loop.f_hz:.4g} Hz")
    hidden = {"not known"} if hz != "mains" else set()
    assert check.status.word in {"unstable" if apart > 0 else "ok"} | hidden
    if apart > 0:
        assert check.growth_hz == pytest.approx(loop.f_hz, rel=0.01)


@pytest.mark.slow
def test_a_slow_pair_at_the_very_frequency_of_a_hum_is_not_left_out_with_it():
    """Pairs of 1 + 2e-6, which a burst rings and which go on ringing: the hum is from outside, they are not."""
    rng = np.random.default_rng(2)
    words = []
    for _ in range(4):
        loop = drawn_loop(rng, 1 + 2e-6)
        loop.bench.hum = (0.05, loop.f_hz, 0.2)
        words.append(str(uq.simulate.check_stability(loop.bench, loop.law, 16.0).status.word))
    print(words)
    assert "ok" not in words


@pytest.mark.slow
@pytest.mark.parametrize("hum", [(0.05, 50.0, 0.0), (0.0, 0.0, 0.2), (0.05, None, 0.2)])
def test_loops_that_hum_are_never_judged_wrongly(rng, hum, cases):
    """40 loops with mains, offsets, and a hum at the slowest mode, as those above."""
    false, unknown, loops = 0, 0, cases(HUMMING)
    for _ in range(loops):
        apart = 10 ** rng.uniform(-6, -3) * rng.choice([-1, 1])
        loop = drawn_loop(rng, 1 + apart, rng.choice([0.0, 0.003, 0.03]), rng.random() < 0.7, 1.0)
        loop.bench.hum = (hum[0], loop.f_hz if hum[1] is None else hum[1], hum[2])
        check = uq.simulate.check_stability(loop.bench, loop.law)
        word = check.status.word
        false += word in ("ok", "unstable") and (word == "unstable") != (apart > 0)
        unknown += word == "not known"
        if word == "not known" or (word == "unstable") != (apart > 0):
            print(f"1 {apart:+.1e}, {loop.f_hz:.3g} Hz at {RATE_HZ:g} Hz: {check.status}")
    print(f"{loops} loops, hum {hum}: {false} false, {unknown} not known")
    assert false == 0


def test_refusals(slow_growth_law):
    bench = uq.bench.Hexapod()
    with pytest.raises(InputError, match="holds 35 samples; it takes 128"):
        uq.simulate.check_stability(bench, slow_growth_law, 0.01)
    with pytest.raises(InputError, match="must take 6 readings"):
        uq.simulate.check_stability(bench, uq.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 3500.0))


@functools.lru_cache
def judged_wrongly(seed, loops):
    """Return how many loops with pairs of modulus 1 +- 1e-6 to 1e-3 are falsely ok, unstable, and not known.

    The latter where an e-fold takes less than ten records, and noise alone holds a loop at its limits for no more than
    the hundredth of the time up to which it is taken for the linear one: to say that a loop settles would be false
    beyond, what it does by itself is not seen, and it is printed.
    """
    rng = np.random.default_rng(seed)
    false_ok = false_unstable = unknown = wrongly_unknown = 0
    for _ in range(loops):
        apart = 10 ** rng.uniform(-6, -3) * rng.choice([-1, 1])
        loop = drawn_loop(
            rng, 1 + apart, rng.choice([0.0, 0.003, 0.03]), rng.random() < 0.7, rng.choice([1.0, 1e-9, 1e9])
        )
        check = uq.simulate.check_stability(loop.bench, loop.law)
        word = check.status.word
        records = 1 / abs(loop.growth_per_s) / check.duration_s
        false_ok += word == "ok" and apart > 0
        false_unstable += word == "unstable" and apart < 0
        unknown += word == "not known"
        wrongly_unknown += word == "not known" and records < 10 and not loop.clipped > CLIPPED_SHARE
        if word == "not known" or (word == "unstable") != (apart > 0):
            print(
                f"1 {apart:+.1e}, {loop.f_hz:.3g} Hz at {RATE_HZ:g} Hz, {records:.3g} records an e-fold, "
                f"{loop.clipped:.2g} of the time at its limits: {check.status}"
            )
    print(f"{loops} loops: {false_ok} false ok, {false_unstable} false unstable, {unknown} not known")
    return false_ok, false_unstable, wrongly_unknown


@pytest.mark.slow
def test_drawn_loops_are_never_judged_wrongly(seed, cases):
    assert judged_wrongly(seed, cases(LOOPS))[:2] == (0, 0)


# One of 800 loops rings by its noise alone so loudly that no burst allowed is heard above, or decays within three
# deviations: of 40, the loops of a fresh draw, one in twenty times.
@pytest.mark.slow
@pytest.mark.draws(false_alarm=0.05)
def test_what_is_not_known_of_drawn_loops_takes_ten_records_or_their_limits(seed, cases):
    assert judged_wrongly(seed, cases(LOOPS))[2] == 0


LEAST = 0.02  # V of a command, which every draw meets


def test_the_compiled_bench_is_the_stepped_one(rng):
    """Commands at their limits, noise on: both draw the same."""
    A, B, C = modal(rng, 3, 5)
    law = uq.StateSpace(
        np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((5, 0)), 0.1 * rng.standard_normal((5, 3)), RATE_HZ
    )
    d, seed = rng.standard_normal((5, 500)), rng.integers(2**32)
    slow, fast = (
        bench(A, B, C, 0.1, np.random.default_rng(seed), (LEAST, 10.0)).run(
            np.zeros_like(d), disturbance=d, controller=law
        )
        for bench in (wrapped, LinearBench)
    )
    assert np.abs(fast.inputs).max() == LEAST
    assert fast.inputs == pytest.approx(slow.inputs, abs=1e-12)
    assert fast.outputs == pytest.approx(slow.outputs, abs=1e-12)


def test_a_machine_that_comes_too_late_is_no_law_that_runs_away():
    reading = [0.0]
    push, speed = uq.Channel("push", "N", -1.0, 1.0), uq.Channel("speed", "m/s")

    def write(u):
        reading[0] = 0.1 * float(u[0])

    bench = uq.bench.Hardware(write, lambda: reading, 500.0, [push], [speed], wait=lambda: 1)
    law = uq.StateSpace([[0.5]], [[1.0]], [[-0.1]], [[0.0]], rate_hz=500.0)
    with pytest.raises(InterlockError, match="late frames"):
        uq.simulate.check_stability(bench, law)
