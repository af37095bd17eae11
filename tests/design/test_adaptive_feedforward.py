"""Tones of unknown, moving and jumping frequency, found and cancelled on the noisy bench; harmless without one."""

import numpy as np
import pytest
from tone_runs import mild_damping, reduction_db, run, seconds, tone

import ultraquiet as uq
from ultraquiet.design import AdaptiveFeedforward

SPAN = (21.0, 29.0)


@pytest.fixture(scope="module")
def law():
    result = AdaptiveFeedforward(tones_hz=(25.0,)).design(uq.bench.Hexapod(unit="ground").linear_model())
    assert result.status.ok
    assert result.controller.is_stable()
    return result.law


@pytest.fixture
def bench(seed):
    return uq.bench.Hexapod(unit="ground", seed=seed, hysteresis=True)


@pytest.mark.slow
def test_unknown_frequency_is_found_and_the_tone_cancelled(law, bench, rng):
    t = seconds(4.0)
    for f in (22.5, rng.uniform(22.5, 27.5), 27.5):
        d = tone(rng, np.full(t.size, f))
        opened, closed = run(bench, d), run(bench, d, law)
        got = [reduction_db(opened, closed, part, SPAN) for part in ((1.5, 2.5), (2.5, 4))]
        print(
            f"{f:.2f} Hz: {got[0]:.1f} dB from 1.5 s on, {got[1]:.1f} dB from 2.5 s; follows {law.tones_hz[0]:.3f} Hz"
        )
        assert law.status.ok
        assert abs(law.tones_hz[0] - f) < 0.05
        assert got[0] >= 20
        assert got[1] >= 20


@pytest.mark.slow
@pytest.mark.parametrize("hz_per_s", [0.5, -0.5])
def test_drifting_frequency_is_followed(law, bench, rng, hz_per_s):
    t = seconds(8.0)
    d = tone(rng, 25.0 + hz_per_s * (t - 4.0))
    opened, closed = run(bench, d), run(bench, d, law)
    got = reduction_db(opened, closed, (2, 8), SPAN)
    print(f"drift of {hz_per_s} Hz/s: {got:.1f} dB")
    assert got >= 15


@pytest.mark.slow
def test_a_jump_is_caught(law, bench, rng):
    t = seconds(6.0)
    d = tone(rng, np.where(t < 3, 23.0, 27.0))
    opened, closed = run(bench, d), run(bench, d, law)
    before, after = (reduction_db(opened, closed, part, SPAN) for part in ((2, 3), (4, 6)))
    print(f"23 Hz: {before:.1f} dB; one second after the jump to 27 Hz: {after:.1f} dB")
    assert before >= 20
    assert after >= 20


@pytest.mark.slow
def test_without_a_tone_it_does_no_harm(law, bench, rng):
    t = seconds(8.0)
    noise = 0.3 * rng.standard_normal((6, t.size))
    for name, d in (("sensor noise", np.zeros((6, t.size))), ("white disturbance", noise)):
        opened, closed = run(bench, d), run(bench, d, law)
        whole = np.sqrt(np.mean(closed.outputs**2) / np.mean(opened.outputs**2))
        share = reduction_db(opened, closed, (0, 8), SPAN)
        print(f"{name}: {20 * np.log10(whole):+.3f} dB in all, {-share:+.2f} dB in the span")
        assert 20 * np.log10(whole) < 0.1
        assert -share < 1.5


@pytest.mark.slow
def test_the_command_fades_when_the_tone_ends(law, bench, rng):
    t = seconds(7.0)
    d = tone(rng, np.full(t.size, 25.5)) * (t < 2)
    closed = run(bench, d, law)
    during, after = (np.abs(closed.inputs[:, round(a * 3500) : round(b * 3500)]).max() for a, b in ((1, 2), (6, 7)))
    print(f"command {during:.3f} V with the tone, {after:.5f} V four seconds after it")
    assert after < 0.01 * during
    assert np.isnan(law.tones_hz).all()


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_three_tones_at_once(unit, seed, rng):
    bench = uq.bench.Hexapod(unit=unit, seed=seed)
    law = AdaptiveFeedforward(tones_hz=(25.0, 60.0, 100.0), span=0.08).design(bench.linear_model()).law
    t = seconds(5.0)
    f = np.array([25.0, 60.0, 100.0]) * rng.uniform(0.93, 1.07, 3)
    d = sum(tone(rng, np.full(t.size, x)) for x in f)
    opened, closed = run(bench, d), run(bench, d, law)
    got = [reduction_db(opened, closed, (3, 5), (x - 3, x + 3)) for x in f]
    print(f"{unit}, {np.round(f, 1)} Hz: {np.round(got, 1)} dB")
    assert min(got) >= 20


def test_a_unit_that_is_not_the_model(law, seed, rng):
    t = seconds(4.0)
    bench = uq.bench.Hexapod(unit="ground", seed=seed, spread=1.0, unit_seed=seed % 1000, hysteresis=True)
    d = tone(rng, np.full(t.size, rng.uniform(23, 27)))
    opened, closed = run(bench, d), run(bench, d, law)
    got = reduction_db(opened, closed, (2, 4), SPAN)
    print(f"unit {seed % 1000} within its tolerances: {got:.1f} dB")
    assert got >= 20


@pytest.mark.slow
def test_around_another_law(bench, rng):
    plant = bench.linear_model()
    inside = mild_damping(6)
    law = AdaptiveFeedforward(tones_hz=(25.0,), around=inside).design(plant).law
    t = seconds(4.0)
    d = tone(rng, np.full(t.size, 24.2), volts=2.0)
    only, both = run(bench, d, inside), run(bench, d, law)
    got = reduction_db(only, both, (2, 4), SPAN)
    print(f"{got:.1f} dB more than the law inside alone")
    assert got >= 10


def test_amplitudes_stay_within_their_limit(bench, rng):
    law = AdaptiveFeedforward(tones_hz=(25.0,), limit=0.3).design(bench.linear_model()).law
    t = seconds(5.0)
    d = tone(rng, np.full(t.size, 25.0))
    opened, closed = run(bench, d), run(bench, d, law)
    got = reduction_db(opened, closed, (4, 5), SPAN)
    print(f"commands up to {np.abs(closed.inputs).max():.3f} V: {got:.1f} dB, {law.status}")
    assert np.abs(closed.inputs).max() <= 0.3 + 1e-9
    assert law.status.word == "limited"
    assert got > 1


@pytest.mark.slow
def test_a_law_for_a_steady_tone_is_the_linear_one(rng):
    """Once the frequency is known, the adaptive law and the resonator bank do the same."""
    bench = uq.bench.Hexapod(unit="ground", linear=True)
    result = AdaptiveFeedforward(tones_hz=(25.0,), limit=10.0).design(bench.linear_model())
    t = seconds(4.0)
    d = tone(rng, np.full(t.size, 25.0))
    adaptive, linear = run(bench, d, result.law), run(bench, d, result.controller)
    last = slice(-3500, None)
    gap = np.abs(adaptive.inputs[:, last] - linear.inputs[:, last]).max() / np.abs(linear.inputs[:, last]).max()
    print(f"commands differ by {100 * gap:.2f} %")
    assert gap < 0.02
