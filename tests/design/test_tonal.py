"""Resonator banks: depth, settling and margins on the model, tones of the noisy bench, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from named_plants import sensitivity_db
from tone_runs import reduction_db, run, seconds, tone

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.design import AdaptiveFeedforward, FilteredXLms, Resonators, YoulaKucera
from ultraquiet.linalg.discretize import zero_order_hold
from ultraquiet.testing.problems import damped_plant
from ultraquiet.values import Channel, StateSpace
from ultraquiet.values.interconnect import append, feedback, gain, series

EVERYWHERE = np.geomspace(1, 1749, 3000)


@pytest.fixture(scope="module")
def ground():
    return uq.bench.Hexapod(unit="ground").linear_model()


@pytest.mark.gate("flight")
@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_three_tones_on_both_units(unit, seed, rng):
    bench = uq.bench.Hexapod(unit=unit, seed=seed)
    plant = bench.linear_model()
    result = Resonators(tones_hz=(25.0, 60.0, 100.0)).design(plant)
    K = result.controller
    assert result.status.ok
    assert K.is_stable()
    f = np.array([25.0, 60.0, 100.0])
    depth = -sensitivity_db(plant, K, f)
    np.testing.assert_allclose(depth, list(result.details["depth_db"].values()), atol=0.01)
    peak = sensitivity_db(plant, K, EVERYWHERE).max()
    t = seconds(5.0)
    d = sum(tone(rng, np.full(t.size, x)) for x in f)
    opened, closed = run(bench, d), run(bench, d, K)
    got = [reduction_db(opened, closed, (3, 5), (x - 2, x + 2)) for x in f]
    print(f"{unit}: model {np.round(depth, 1)} dB, bench {np.round(got, 1)} dB, peak {peak:.2f} dB")
    print(f"  settling {result.details['settling_s']}, phase margins {result.details['phase_margin_deg']}")
    assert depth.min() > 55
    assert min(got) > 30
    assert peak < 3.01
    assert min(result.details["phase_margin_deg"].values()) > 60


def test_settling_is_what_the_poles_say(ground):
    result = Resonators(tones_hz=(40.0,), settling_s=0.5).design(ground)
    settling = result.details["settling_s"][40.0]
    loop = feedback(ground, result.controller)
    n = round(2 * settling * 3500)
    d = np.tile(np.sin(2 * np.pi * 40 * np.arange(n) / 3500), (6, 1))
    y = loop.simulate(d) * np.exp(-2j * np.pi * 40 * np.arange(n) / 3500)
    period = round(3500 / 40)
    size = np.abs(np.array([y[:, k : k + period].mean(axis=1) for k in range(0, n - period, period)])).max(axis=1)
    at = np.arange(size.size) * period / 3500
    inside = (at > 0.3 * settling) & (at < settling)
    slope = np.polyfit(at[inside], np.log(size[inside]), 1)[0]
    print(f"asked 0.5 s, poles say {settling:.3f} s, the run {-4 / slope:.3f} s")
    assert -4 / slope == pytest.approx(settling, rel=0.2)


@pytest.mark.slow
def test_bank_around_a_broadband_law(ground):
    alone = uq.design.BandAttenuation(band_hz=(9.0, 108.0), structure="repeated").design(ground)
    both = Resonators(tones_hz=(25.0, 60.0), around=alone.controller).design(ground)
    f = np.array([25.0, 60.0])
    more = sensitivity_db(ground, alone.controller, f) - sensitivity_db(ground, both.controller, f)
    rise = both.peak_sensitivity_db - alone.peak_sensitivity_db
    print(f"{np.round(more, 1)} dB more at the tones, peak {rise:+.2f} dB")
    assert both.status.ok
    assert more.min() > 40
    assert rise <= 3.0


def test_each_tone_settles_in_its_own_time(ground):
    asked = {25.0: 0.5, 60.0: 2.0}
    result = Resonators(tones_hz=tuple(asked), settling_s=tuple(asked.values()), peak_db=6.0).design(ground)
    assert result.status.ok
    for tone_hz, settling in result.details["settling_s"].items():
        slowed = result.details["slowed"][tone_hz]
        assert settling == pytest.approx(slowed * asked[tone_hz], rel=0.2)
    with pytest.raises(InputError, match="one number or 2, one a tone, got 3"):
        Resonators(tones_hz=(25.0, 60.0), settling_s=(1.0, 2.0, 3.0))


@pytest.mark.parametrize(("method", "usual"), [(Resonators, 0.5), (AdaptiveFeedforward, 0.3)])
def test_a_tone_that_misses_the_time_asked_for_is_short_and_one_that_nobody_timed_is_only_told(method, usual):
    plant, tones = below_its_tones(0.02), (15.0, 40.0)
    more = {"limit": 1.0} if method is AdaptiveFeedforward else {}
    told = method(tones_hz=tones, **more).design(plant)
    reached = told.details["settling_s"]
    slowest = max(reached, key=reached.get)
    print(told.status.sentence)
    assert told.status.ok
    takes = f"The slowest tone, {slowest:g} Hz, settles in {reached[slowest]:.3g} s"
    assert f"{takes}, {usual:g} s is usual: it was slowed" in told.status.sentence
    asked = (2 * max(reached.values()), usual)
    short = method(tones_hz=tones, settling_s=asked, **more).design(plant)
    print(short.status.sentence)
    assert short.status.word == "short"
    at_40_hz = short.details["settling_s"][40.0]
    assert f"The tone at 40 Hz settles in {at_40_hz:.3g} s, {usual:g} s was asked: it was" in short.status.sentence
    kept = method(tones_hz=tones, settling_s=2 * max(reached.values()), **more).design(plant)
    print(kept.status.sentence)
    assert kept.status.ok
    assert "The slowest tone, " in str(kept.status)


# It is held at every station of its span, of which one may pass where the tone itself does not: 1 of 11 draws.
AT_STATIONS = pytest.param(AdaptiveFeedforward, marks=pytest.mark.draws(false_alarm=0.1))


@pytest.mark.parametrize("method", [Resonators, AT_STATIONS])
def test_the_whole_loop_keeps_below_its_peak(seed, method):
    plant = damped_plant(seed)
    lqg = uq.design.Lqg().design(plant).controller
    inner = StateSpace(lqg.A, lqg.B, 0.2 * lqg.C, 0.2 * lqg.D, lqg.rate_hz)
    f_hz = np.geomspace(1e-2, 0.499 * plant.rate_hz, 5000)
    own = sensitivity_db(plant, inner, f_hz).max()
    more = {"limit": 1.0} if method is AdaptiveFeedforward else {}
    how = {"tones_hz": (25.0,), "settling_s": 0.05, "around": inner, **more}
    free = method(peak_db=6.0, **how).design(plant)
    held = method(peak_db=6.0, loop_peak_db=own + 0.05, **how).design(plant)
    peaks = [sensitivity_db(plant, each.controller, f_hz).max() for each in (free, held)]
    print(f"without a bank {own:.2f} dB, with one {peaks[0]:.2f} dB, held {peaks[1]:.2f} dB; {held.details['slowed']}")
    assert peaks[1] <= own + 0.05 + 1e-6
    assert peaks[1] <= peaks[0]
    assert (peaks[1] < peaks[0]) == (peaks[0] > own + 0.05 + 1e-6)  # held where it would pass, else left as it is
    below = method(loop_peak_db=own - 0.1, **how).design(plant)
    assert below.controller is None
    assert "already; 'loop_peak_db' must be above that" in str(below.status)


def test_a_law_without_states_that_is_too_loud_by_itself_is_said_to_be():
    """S of K0 = -5 round 0.1 / (z - 0.9) peaks at 1 / (1 - 5 / 19), 2.7 dB, at half the rate."""
    lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 1000.0)
    result = Resonators(tones_hz=(30.0,), around=gain([[-5.0]], 1000.0), loop_peak_db=1.0).design(lag)
    assert result.controller is None
    assert "without a bank the loop amplifies by 2.65 dB" in str(result.status)


def faint_and_loud(ny, nu, unit, rng):
    """A plant that answers 5 Hz a thousand times more faintly than 100 Hz: a high-pass in front of a mode."""
    shape = rng.standard_normal((ny, nu)) / unit
    wide = StateSpace(*zero_order_hold(-2 * np.pi * 200 * np.eye(nu), np.eye(nu), shape, np.zeros((ny, nu)), 1e-3), 1e3)
    a = np.exp(-2 * np.pi * 60 / 1e3)
    high = StateSpace(a * np.eye(ny), (a - 1) * np.eye(ny), np.eye(ny), np.eye(ny), 1e3)
    return series(series(wide, high), series(high, high))


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_a_bank_that_rolls_off_disturbs_what_is_above_its_tone_less(rng, ny, nu, unit):
    plant = faint_and_loud(ny, nu, unit, rng)
    depths, far = [], []
    for roll_off in (None, 2.0):
        result = Resonators(tones_hz=(5.0,), settling_s=8.0, peak_db=40.0, roll_off=roll_off).design(plant)
        assert result.status.word in ("ok", "fragile")
        depths.append(result.details["depth_db"][5.0])
        G, K = (np.moveaxis(s.frequency_response([100.0]), 2, 0)[0] for s in (plant, result.controller))
        far.append(np.linalg.norm(G @ K, 2))
    print(
        f"{ny}x{nu}: {depths[0]:.1f} and {depths[1]:.1f} dB at the tone, |G K| at 100 Hz {far[0]:.3g} and {far[1]:.3g}"
    )
    assert min(depths) > 59.0
    assert far[1] < far[0] / 3  # the phase of the plant at the tone decides how the plain one falls


def test_named_law_is_made_and_put_inside(seed):
    plant = damped_plant(seed)
    result = Resonators(tones_hz=(25.0,), around="lqg").design(plant)
    assert result.status.ok
    assert result.controller.states > 4


def test_plants_drawn_from_the_uncertainty_are_asked(ground, rng):
    off = (np.diag(rng.uniform(0.7, 1.3, 6)) for _ in range(5))
    drawn = [StateSpace(ground.A, ground.B @ D, ground.C, ground.D, 3500.0) for D in off]
    good = Resonators(tones_hz=(25.0,)).design(ground, drawn)
    print(f"least real part of an eigenvalue of G Ghat^-1: {good.details['least_real']}")
    assert good.status.ok
    assert 0.6 < good.details["least_real"][25.0] < 1.4
    turned = StateSpace(ground.A, -ground.B, ground.C, ground.D, 3500.0)
    bad = Resonators(tones_hz=(25.0, 60.0)).design(ground, [*drawn, turned])
    assert bad.controller is None
    assert "Hz an eigenvalue of G Ghat^-1" in str(bad.status)


@pytest.mark.parametrize("shape", [(6, 4), (4, 6)])
def test_rectangular_plants_are_quiet_where_they_can_be(ground, shape):
    ny, nu = shape
    plant = StateSpace(ground.A, ground.B[:, :nu], ground.C[:ny], ground.D[:ny, :nu], 3500.0)
    result = Resonators(tones_hz=(60.0,)).design(plant)
    assert result.status.ok
    assert result.details["directions"][60.0] == 4
    assert result.details["depth_db"][60.0] > 50


def test_weak_directions_are_left_alone(ground):
    weak = StateSpace(ground.A, ground.B @ np.diag([1, 1, 1, 1, 1, 1e-4]), ground.C, ground.D, 3500.0)
    result = Resonators(tones_hz=(60.0,)).design(weak)
    assert result.status.ok
    assert result.details["directions"][60.0] == 5


DEAF = StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, -2 * np.cos(2 * np.pi * 0.025)]], [[1.0]], 1000.0)  # zero at 25 Hz
LAG = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 1000.0)
SLOW = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
GROWING = StateSpace([[1.01]], [[0.1]], [[1.0]], [[0.0]], 1000.0)


@pytest.mark.parametrize("method", [Resonators, AdaptiveFeedforward, YoulaKucera, FilteredXLms])
def test_continuous_plants_and_misfits_are_refused(method):
    with pytest.raises(InputError, match=f"{method.__name__}: .*continuous"):
        method().design(SLOW)
    with pytest.raises(InputError, match=f"{method.__name__}: .*around"):
        method(around=append(LAG, LAG)).design(LAG)
    with pytest.raises(InputError, match=f"{method.__name__}: .*'around'"):
        method(around=3.0).design(LAG)
    with pytest.raises(InputError, match="unstable"):
        method(around=StateSpace([[0.0]], [[0.0]], [[0.0]], [[100.0]], 1000.0)).design(LAG)


@pytest.mark.parametrize("method", [Resonators, AdaptiveFeedforward, YoulaKucera])
@pytest.mark.parametrize("wrong", [(600.0,), (0.0,), (-5.0,), (), (25.0, 25.0)])
def test_impossible_tones_are_refused(method, wrong):
    with pytest.raises(InputError, match=method.__name__):
        method(tones_hz=wrong).design(LAG)


@pytest.mark.parametrize("method", [Resonators, AdaptiveFeedforward])
def test_a_tone_that_the_plant_cannot_reach_is_refused(method):
    with pytest.raises(InputError, match=r"no gain at 25 Hz"):
        method(tones_hz=(25.0,), **({"span": 0.0} if method is AdaptiveFeedforward else {})).design(DEAF)


@pytest.mark.parametrize("method", [Resonators, AdaptiveFeedforward, FilteredXLms])
def test_an_unstable_plant_needs_a_law_first(method):
    with pytest.raises(InputError, match="'around'"):
        method().design(GROWING)


def test_spans_that_overlap_or_pass_nyquist_are_refused():
    with pytest.raises(InputError, match="share"):
        AdaptiveFeedforward(tones_hz=(25.0, 28.0)).design(LAG)
    with pytest.raises(InputError, match="half the rate"):
        AdaptiveFeedforward(tones_hz=(480.0,)).design(LAG)


@pytest.mark.parametrize(
    "method",
    [AdaptiveFeedforward(tones_hz=(25.0,)), YoulaKucera(tones_hz=(25.0,)), FilteredXLms()],
    ids=lambda m: type(m).__name__,
)
def test_laws_refuse_another_number_of_readings(method):
    held = StateSpace(LAG.A, LAG.B, LAG.C, LAG.D, LAG.rate_hz, actuators=[Channel("coil", "N", -2.0, 3.0)])
    law = method.design(held).law
    assert law.limit_v.tolist() == [2.0]
    assert law.rate_hz == 1000.0
    with pytest.raises(InputError, match="takes 1 readings, got 2"):
        law.step(np.zeros(2))
    with pytest.raises(InputError, match="'limit' must be one number above zero, got"):
        replace(method, limit=(1.0, 2.0)).design(LAG)


@pytest.mark.parametrize(
    "method",
    [AdaptiveFeedforward(tones_hz=(25.0,)), YoulaKucera(tones_hz=(25.0,)), FilteredXLms()],
    ids=lambda m: type(m).__name__,
)
def test_a_law_that_adapts_asks_for_the_limits_that_nobody_states(method):
    free = StateSpace(LAG.A, LAG.B, LAG.C, LAG.D, LAG.rate_hz, actuators=[Channel("coil", "N")])
    with pytest.raises(InputError, match=r"no limit of 'coil' is known.*state the largest command as 'limit', in N"):
        method.design(free)
    older = type(method)(**{"tones_hz": (25.0,)} if hasattr(method, "tones_hz") else {}, limit_v=3.0)
    assert older.limit_v == older.limit == 3.0
    law = older.design(free).law
    assert law.limit.tolist() == law.limit_v.tolist() == [3.0]


def below_its_tones(zeta):
    """Return a mode at 0.5 Hz, which answers tones at 15 and 40 Hz some thousand times less than itself."""
    w, rate = 2 * np.pi * 0.5, 20000.0
    A, B = np.array([[0.0, w], [-w, -2 * zeta * w]]), np.array([[0.0], [1.0]])
    return StateSpace(*zero_order_hold(A, B, np.array([[0.0, 1.0]]), np.zeros((1, 1)), 1 / rate), rate)


def test_whether_a_bank_is_found_does_not_hang_on_the_time_asked_for():
    plant = below_its_tones(0.02)
    found = [Resonators(tones_hz=(15, 40), settling_s=s).design(plant) for s in (0.05, 0.5, 1.0, 5.0, 100.0)]
    settled = [result.details["settling_s"][15.0] for result in found]
    print(f"settled in {np.round(settled)} s")
    assert all(result.status.word == "short" for result in found)  # an hour and more, whatever was asked
    assert max(settled) < 1.5 * min(settled)


def test_a_bank_that_stays_loud_is_refused_with_what_makes_it_so():
    refusal = Resonators(tones_hz=(1500.0, 4000.0)).design(below_its_tones(5e-7)).status.sentence
    print(refusal)
    assert "loudest at 0.5 Hz, where the plant answers" in refusal
    assert "too near" not in refusal
