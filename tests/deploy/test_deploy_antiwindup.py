"""Anti-windup: nothing changes inside the limits; after them the command comes back sooner."""

import numpy as np
import pytest
from deploy_laws import RATE_HZ, random_law

from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.deploy import Twin, conditioning_gain, generate
from ultraquiet.deploy.law.anti_windup import decide_anti_windup
from ultraquiet.values import Channel, StateSpace


def test_conditioned_law_is_stable(law_of):
    law = law_of(40)
    L = conditioning_gain(law.A, law.B, law.C, law.D)
    radius = np.abs(np.linalg.eigvals(law.A - L @ law.C)).max()
    print(f"spectral radius of A - L C: {radius:.6f}, of A: {np.abs(law.poles()).max():.6f}")
    assert L.shape == (40, 6)
    assert radius < 1


def test_invertible_minimum_phase_law_gets_hanus_gain(rng):
    # D large against C (zI - A)^-1 B: minimum phase for certain, and the floor on R is 1e-4 of D D'.
    A = np.diag(rng.uniform(-0.9, 0.9, 4))
    B, C, D = rng.standard_normal((4, 2)), 0.01 * rng.standard_normal((2, 4)), np.diag(rng.uniform(1.0, 2.0, 2))
    L = conditioning_gain(A, B, C, D)
    assert np.allclose(L, B @ np.linalg.inv(D), rtol=0.01, atol=0.01)


def test_an_equation_that_no_pencil_can_be_reordered_for_has_a_gain():
    """Three pairs of poles within 1.4e-3 of the circle, one command of three loud: SciPy's solver gives up on it."""
    law = random_law(np.random.default_rng(72), 6, 1, 3, mixed=False)
    L = conditioning_gain(law.A, law.B, law.C, law.D)
    assert np.abs(np.linalg.eigvals(law.A - L @ law.C)).max() < 1.0


def test_inside_the_limits_nothing_changes(law_of, rng, tmp_path):
    law = law_of(20)
    y = rng.standard_normal((6, 300))
    y *= 20.0 / np.abs(law.simulate(y)).max()
    plain, aware = (generate(law, tmp_path / str(k), anti_windup=k, form="modal").law for k in (False, True))
    runs = []
    for held in (plain, aware):
        twin = Twin(held)
        twin.reset()
        runs.append(twin.run(y))
    assert np.array_equal(*runs)


def test_slow_law_leaves_the_limit_at_once(tmp_path):
    # A slow integrating law driven far beyond its limit, then asked for the other direction.
    pole = np.exp(-2 * np.pi * 0.2 / RATE_HZ)
    law = StateSpace([[pole]], [[0.02]], [[1.0]], [[0.05]], rate_hz=RATE_HZ)
    y = np.concatenate([np.full(3500, 50.0), np.full(3500, -50.0)])[None]
    wait = {}
    for aware in (False, True):
        twin = Twin(generate(law, tmp_path / str(aware), "float64", limits_v=25.0, anti_windup=aware).law)
        twin.reset()
        u = twin.run(y)[0, 3500:]
        wait[aware] = int(np.argmax(u < 24.99))
    print(f"samples at the limit after the reversal: {wait[False]} plain, {wait[True]} conditioned")
    assert wait[True] <= 1
    assert wait[False] > 100


def test_gain_that_does_not_exist_is_refused(tmp_path):
    hidden = StateSpace([[1.0, 0.0], [0.0, 0.5]], [[1.0], [1.0]], [[0.0, 1.0]], [[0.0]], rate_hz=RATE_HZ)
    with pytest.raises(NumericalError, match="no anti-windup gain exists"):
        generate(hidden, tmp_path / "code", anti_windup=True)


def mode(f_hz, damping, gain=1.0):
    """A law of one mode whose response peaks at gain / (2 damping) or so."""
    w = 2 * np.pi * f_hz / RATE_HZ
    pole = np.exp(w * (-damping + 1j * np.sqrt(1 - damping**2)))
    A = [[pole.real, pole.imag], [-pole.imag, pole.real]]
    return StateSpace(A, [[gain * w], [0.0]], [[1.0, 0.0]], [[0.1 * gain]], rate_hz=RATE_HZ)


LIMITS = np.array([[-10.0, 10.0]])


def test_slow_and_unstable_laws_want_it():
    assert not decide_anti_windup("auto", mode(20.0, 0.1), LIMITS).on
    slow = decide_anti_windup("auto", mode(0.3, 0.5), LIMITS)
    unstable = decide_anti_windup("auto", mode(20.0, -0.01), LIMITS)
    print(slow.why, "|", unstable.why)
    assert slow.on
    assert "0.3 Hz is slower than 1 Hz" in slow.why
    assert unstable.on
    assert "outside the unit circle" in unstable.why


def test_design_disturbance_decides(rng):
    law = mode(20.0, 0.1)
    d = rng.standard_normal((1, 5000))
    peak = np.abs(law.simulate(d)).max()
    below, above = (decide_anti_windup("auto", law, LIMITS, None, d * factor * 10.0 / peak) for factor in (0.9, 1.1))
    print(below.why, "|", above.why)
    assert (below.on, above.on) == (False, True)


def test_a_plant_closes_the_loop_before_commands_are_judged(rng):
    """u = K (I - G K)^-1 d against a loop stepped sample by sample."""
    law, plant = mode(20.0, 0.1, -0.5), mode(60.0, 0.2, 0.5)
    d = rng.standard_normal((1, 2000))
    G, K = plant, law
    xg, xk, u = np.zeros(2), np.zeros(2), np.zeros((1, 2000))
    for k in range(2000):
        coupling = np.linalg.inv(np.eye(1) - K.D @ G.D)
        u[:, k] = coupling @ (K.D @ (d[:, k] + G.C @ xg) + K.C @ xk)
        y = d[:, k] + G.C @ xg + G.D @ u[:, k]
        xg, xk = G.A @ xg + G.B @ u[:, k], K.A @ xk + K.B @ y
    peak = np.abs(u).max()
    below, above = (
        decide_anti_windup("auto", law, LIMITS, plant, d * factor * 10.0 / peak) for factor in (0.999, 1.001)
    )
    assert (below.on, above.on) == (False, True)


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_a_plant_that_closes_no_loop_is_refused_before_commands_are_judged(ny, nu, unit, rng, tmp_path):
    n = min(ny, nu)
    D = np.eye(nu, ny) / unit
    law = StateSpace(0.5 * np.eye(n), 0.1 * np.eye(n, ny), np.eye(nu, n), D, rate_hz=RATE_HZ)
    taller = StateSpace(np.eye(1) / 2, np.ones((1, nu)), np.ones((ny + 1, 1)), np.zeros((ny + 1, nu)), rate_hz=RATE_HZ)
    turns = np.linalg.qr(rng.standard_normal((nu, nu)))[0] @ np.eye(nu, ny)
    at_once = StateSpace(np.eye(1) / 2, np.ones((1, nu)), np.ones((ny, 1)), unit * turns.T, rate_hz=RATE_HZ)
    singular = StateSpace(law.A, law.B, law.C, turns / unit, rate_hz=RATE_HZ)
    settings = {"anti_windup": "auto", "disturbance_v": np.ones((ny, 10)), "limits_v": 1.0}
    with pytest.raises(InputError, match="does not close a loop"):
        generate(law, tmp_path / "code", plant=taller, **settings)
    with pytest.raises(InputError, match="ill-posed"):
        generate(singular, tmp_path / "code", plant=at_once, **settings)
    assert not (tmp_path / "code").exists()


def test_a_loop_that_runs_away_under_its_disturbance_is_refused_as_unstable(tmp_path):
    law, plant = mode(20.0, 0.1), StateSpace([[1.2]], [[1.0]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    settings = {"anti_windup": "auto", "disturbance_v": np.ones((1, 5000)), "limits_v": 1.0}
    with pytest.raises(NumericalError, match="the loop of this plant and the law is unstable"):
        generate(law, tmp_path / "code", plant=plant, **settings)


def test_generate_follows_the_wish_while_the_budget_allows(tmp_path, law_of):
    slow = mode(0.3, 0.5)
    on = generate(slow, tmp_path / "code", anti_windup="auto")
    assert on.law.L is not None
    assert on.tables["anti_windup_because"].startswith("on: a pole of the law at 0.3 Hz")
    off = generate(mode(20.0, 0.1), tmp_path / "code", anti_windup="auto")
    assert off.law.L is None
    big = law_of(130)
    big = StateSpace(big.A, big.B, big.C, big.D, rate_hz=RATE_HZ)
    tight = generate(big, tmp_path / "code", form="modal", anti_windup="auto", budget_cycles=2200)
    print(tight.tables["anti_windup_because"])
    assert tight.law.L is None
    assert tight.tables["c31_cycles"] <= 2200


def test_auto_without_a_gain_says_so(tmp_path):
    hidden = StateSpace([[1.0, 0.0], [0.0, 0.5]], [[1.0], [1.0]], [[0.0, 1.0]], [[0.0]], rate_hz=RATE_HZ)
    made = generate(hidden, tmp_path / "code", anti_windup="auto")
    assert made.law.L is None
    assert "no anti-windup gain exists" in made.tables["anti_windup_because"]


def test_bad_settings_are_refused(tmp_path):
    for settings, words in (
        ({"anti_windup": "maybe"}, "anti_windup"),
        ({"anti_windup": "auto", "disturbance_v": np.zeros((2, 10))}, "must have 1 channels"),
        ({"excitation_v": np.nan}, "excitation_v"),
        ({"excitation_v": [[1.0, 2.0]]}, "must hold 0,"),
        ({"overrun_limit": 0}, "overrun_limit"),
    ):
        with pytest.raises(InputError, match=words):
            generate(mode(20.0, 0.1), tmp_path / "code", **settings)
        assert not (tmp_path / "code").exists()


def test_the_largest_command_is_told_in_its_own_unit():
    D = np.diag([1e-6, 2e-6, 3e-6])
    wires = (Channel("left", "N"), Channel("right", "N"), Channel("valve"))
    for count, said in ((1, "2e-06 N"), (2, "4e-06 N"), (3, "6e-06,")):
        law = StateSpace(np.zeros((0, 0)), np.zeros((0, count)), np.zeros((count, 0)), D[:count, :count], RATE_HZ)
        law = StateSpace(law.A, law.B, law.C, law.D, RATE_HZ, sensors=wires[:count])
        decided = decide_anti_windup("auto", law, np.array([[-1.0, 1.0]] * count), None, 2.0 * np.ones((count, 5)))
        assert f"commands peak at {said}" in decided.why
        assert " V" not in decided.why
