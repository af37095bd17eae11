"""Loops behind a dead zone: one that grows once it moves is not called settled because it rests below that."""

import numpy as np
import pytest
from drawn_loops import RATE_HZ, drawn_loop
from one_mode import ANGLE, difference, one_mode

import ultraquiet as uq
from ultraquiet.simulate import disturb
from ultraquiet.simulate.growth.sticking import sticking
from ultraquiet.simulate.growth.verdict import judged
from ultraquiet.simulate.kick import AT_MOST, Burst, Bursts, ended_early, kicked, used

RANGE_N = 10.0
THROWS = 10  # of each kind: none leaves a loop at its limits that is called unstable and is not
THROWN = 2000  # samples for which a loop is thrown, of a minute
LOWERED = 40  # times that tones are lowered: a loop that is beyond its ranges then is so by its noise alone


def stays_at_its_limits(dead_n, gain):
    """Return whether a burst of half the range, at the mode, leaves commands at their limits for good."""
    d = np.zeros((1, 8000))
    d[0, :100] = RANGE_N / 2 * np.sin(ANGLE * np.arange(100))
    late = disturb(one_mode(limit_n=RANGE_N, dead_n=dead_n), d, difference(gain)).inputs[:, -2000:]
    return bool((np.abs(late) >= RANGE_N).any())


@pytest.mark.gate("0.5-1.0")
@pytest.mark.parametrize("dead_n", [0.0, 0.01, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("gain", [-2.5, -1.9, 0.5])
def test_what_a_loud_burst_throws_into_its_limits_is_not_called_settled(dead_n, gain):
    check = uq.simulate.check_stability(one_mode(limit_n=RANGE_N, dead_n=dead_n), difference(gain), 4.0)
    truth = stays_at_its_limits(dead_n, gain)
    print(f"dead zone {dead_n} N, gain {gain}: {truth}; {check.status}")
    assert check.status.word == ("unstable" if truth else "ok")


@pytest.mark.slow
def test_what_a_tone_just_above_its_dead_zone_drives_into_the_limits_of_a_stable_loop_is_no_growth():
    """A little less does nothing at all: out of proportion to it is what any loop makes of a little more."""
    drawn_from = np.random.default_rng(307)
    loop = drawn_loop(drawn_from, 0.997, noise=1e-3)
    loop.bench.dead = 0.1 * loop.bench.actuators[0].high
    check = uq.simulate.check_stability(loop.bench, loop.law)
    print(check.status)
    assert check.status.word == "ok"
    assert largest_left(loop, tones(loop, drawn_from)) < loop.bench.dead


def test_a_burst_that_ends_early_is_silent_from_where_a_channel_uses_half_of_its_range():
    bench, law = one_mode(limit_n=RANGE_N), difference(0.5)
    burst = Burst(
        np.array([100 * RANGE_N]), 400, 400, bench.rate_hz, modes_hz=(10.0,), random_share=0.0, tone_share=1.0
    )
    whole = kicked(bench, law, burst)
    early = ended_early(burst, whole.runs)
    shares = np.max([used(run) for run in whole.runs], axis=(0, 1))
    assert early.ends == np.argmax(shares > AT_MOST) > 0
    assert (early.signal()[:, early.ends :] == 0).all()
    assert (early.signal()[:, : early.ends] == burst.signal()[:, : early.ends]).all()
    assert ended_early(early, kicked(bench, law, early).runs) == early


@pytest.mark.slow
def test_what_grows_to_its_limits_after_every_burst_is_not_blamed_on_what_sticks():
    """It does so from bursts within half of its ranges, and from less: there is nothing to end early."""
    bench, law = one_mode(limit_n=RANGE_N), difference(-2.5)
    burst = Burst(np.array([RANGE_N / 1000]), 100, 4000, bench.rate_hz)
    heard = kicked(bench, law, burst)
    assert heard.limited > 0.5
    assert ended_early(burst, heard.runs) is burst
    assert sticking(bench, law, Bursts(burst, burst), judged(bench, heard)) is None


@pytest.mark.slow
def test_growth_that_is_slow_beside_the_dead_zone_is_seen_in_any_unit():
    words = []
    for unit in (1.0, 1e9, 1e-9):
        check = uq.simulate.check_stability(one_mode(dead_n=0.01, unit=unit), difference(-1.75, unit), 8.0)
        words.append(check.status.word)
        assert check.growth_per_s == pytest.approx(0.186, abs=4 * check.growth_std_per_s)
    assert words == ["unstable"] * 3


# `ok` is promised from a third of the ranges: of these loops, thrown to half, 1 of 102 that stay at their limits had
# it, and none of 75 that a third throws there. Of eight campaigns of forty that grow more quickly two had one, a mode
# that one tone of a third reaches and that decays too quickly behind its dead zone to be given one of its own. Stable
# loops are held to the promise itself: saturation holds some of them at their limits after a throw of half. A rate is
# that of one fresh draw, of a fifth of the loops.
TWO_SLOW = pytest.param(0.003, 2, marks=pytest.mark.draws(false_alarm=0.02))
FORTY_SLOW = pytest.param(0.003, 40, marks=pytest.mark.draws(false_alarm=0.06))
FORTY_QUICK = pytest.param(0.01, 40, marks=pytest.mark.draws(false_alarm=0.06))


@pytest.mark.gate("-0.003-2")
@pytest.mark.parametrize(("apart", "loops"), [TWO_SLOW, (-0.003, 2), FORTY_QUICK, FORTY_SLOW, (-0.003, 40)])
def test_drawn_loops_behind_dead_zones_are_judged_by_what_loud_tones_leave(apart, loops, rng, cases):
    loops = cases(loops)
    false_ok = false_unstable = at_limits = unknown = drawn = 0
    while drawn < loops or (at_limits == 0 and apart > 0):  # of two loops there may be none that is thrown so far
        drawn += 1
        loop = drawn_loop(rng, 1 + apart, noise=10.0 ** rng.integers(-5, -1))
        limit = loop.bench.actuators[0].high
        loop.bench.dead = rng.choice([0.01, 0.03, 0.05, 0.1]) * limit
        left = largest_left(loop, tones(loop, rng), 1 / 2 if apart > 0 else 1 / 3)
        word = uq.simulate.check_stability(loop.bench, loop.law).status.word
        at_limits += left >= limit
        false_ok += left >= limit and word == "ok"
        false_unstable += apart < 0 and word == "unstable" and comes_to_rest(loop, rng)
        unknown += word == "not known"
    print(
        f"{drawn} loops, {at_limits} thrown to their limits: {false_ok} false ok, {false_unstable} false unstable, "
        f"{unknown} not known"
    )
    assert false_ok == false_unstable == 0
    assert at_limits > 0 or apart < 0  # saturation holds a stable loop there as well


def comes_to_rest(loop, rng):
    """Return whether a loop does so after tones of other phases and noise as well: some alone hold it at its limits."""
    kinds = [tones(loop, rng) for _ in range(THROWS)] + [noise(loop, rng) for _ in range(THROWS)]
    return all(largest_left(loop, kind) < loop.bench.dead for kind in kinds)


def tones(loop, rng):
    """Yield what throws every mode, of phases drawn as they are asked for."""
    for f_hz in (loop.f_hz, *loop.bench.modes_hz):
        turned = 2 * np.pi * f_hz / RATE_HZ * np.arange(THROWN) + rng.uniform(0, 2 * np.pi, (nu_of(loop), 1))
        yield np.sin(turned)


def noise(loop, rng):
    """Yield random signs that last for two samples or longer."""
    for samples in (2, 20, 200, THROWN):
        yield rng.choice([-1.0, 1.0], (nu_of(loop), samples))


def nu_of(loop):
    return len(loop.bench.actuators)


def largest_left(loop, throws, share=1 / 2):
    """Return the largest command at the end of a minute, after the loudest of each within a share of the ranges."""
    allowed = np.array([share * c.high for c in (*loop.bench.sensors, *loop.bench.actuators)])
    left = 0.0
    for thrown in throws:
        d = np.zeros((len(thrown), 60_000))
        lasts = thrown.shape[1]
        d[:, :lasts] = share * loop.bench.actuators[0].high * thrown
        for _ in range(LOWERED):
            run = disturb(loop.bench, d, loop.law)
            if (np.abs(np.vstack([run.outputs, run.inputs])[:, :lasts]).max(axis=1) <= allowed).all():
                break
            d *= 0.7
        left = max(left, float(np.abs(run.inputs[:, -THROWN:]).max()))
    return left
