"""Reduction: certificates of the loop, bounds, and fewer states than plain truncation can keep stable."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.analyse import hinf_norm
from ultraquiet.design import BandAttenuation, common_mode
from ultraquiet.reduce import Balanced, ClosedLoopWeighted
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback, parallel


@pytest.fixture(scope="module")
def designed():
    plant = common_mode(uq.bench.Hexapod(unit="ground").linear_model())
    return plant, BandAttenuation(band_hz=(9.0, 108.0), height=12.0).design(plant)


def test_certified_loss_is_that_of_the_loop(designed):
    plant, result = designed
    for states in (20, 16, 12, 10):
        small = ClosedLoopWeighted(states=states).reduce(result.controller, plant, result.details["weights"])
        print(f"{small.controller.states} of {result.controller.states} states: {small.status}")
        assert small.status.word == ("loss" if small.broken else "ok")
        assert small.controller.states == states
        assert feedback(plant, small.controller).is_stable()
        assert abs(small.cost_before / result.achieved - 1) < 1e-3
        assert small.cost_after >= 0.99 * result.details["optimum"][0]


def test_two_thirds_of_the_states_cost_little(designed):
    plant, result = designed
    small = ClosedLoopWeighted(states=16).reduce(result.controller, plant, result.details["weights"])
    print(f"24 -> 16 states: {100 * small.loss:.1f} % of the closed-loop norm")
    assert small.loss < 0.10


def test_fewest_states_within_a_loss(designed):
    plant, result = designed
    small = ClosedLoopWeighted(states=None, loss=0.05).reduce(result.controller, plant, result.details["weights"])
    assert small.loss <= 0.05
    assert small.controller.states < result.controller.states


@pytest.mark.slow
def test_full_six_by_six_controller_keeps_its_promise_or_says_what_is_lost():
    """Of 144 states 84 keep the band, the peak and the control within half a decibel; 60 do not, and that is told."""
    plant = uq.bench.Hexapod(unit="ground").linear_model()
    result = BandAttenuation(band_hz=(9.0, 108.0), height=12.0).design(plant)
    kept, short = (
        ClosedLoopWeighted(states=n).reduce(result.controller, plant, result.details["weights"]) for n in (84, 60)
    )
    plain = Balanced(states=60).reduce(result.controller)
    stable = feedback(plant, plain.controller).is_stable()
    print(f"{kept.status}\n{short.status}\nplain truncation to 60 is {'' if stable else 'un'}stable")
    assert kept.status.ok
    assert (short.status.word, "the worst direction in the band falls" in short.status.sentence) == ("loss", True)
    assert all(uq.analyse.peak_sensitivity(plant, small.controller)[0] < 8.0 for small in (kept, short))


def test_balanced_keeps_its_bound_and_the_unstable_part(rng):
    for _ in range(10):
        n = 12
        A = rng.standard_normal((n, n)) / np.sqrt(n) * 1.05
        K = StateSpace(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), np.zeros((2, 2)), rate_hz=10.0)
        small = Balanced(states=9).reduce(K)
        minus = StateSpace(small.controller.A, small.controller.B, -small.controller.C, -small.controller.D, 10.0)
        f = np.linspace(0, 5, 2000)
        error = np.linalg.norm(np.moveaxis(parallel(K, minus).frequency_response(f), 2, 0), 2, axis=(1, 2)).max()
        assert error <= small.details["bound"] * (1 + 1e-6) + 1e-8
        unstable = np.sum(np.abs(K.poles()) >= 1)
        assert np.sum(np.abs(small.controller.poles()) >= 1) == unstable


def test_perturbation_is_exact_at_zero_frequency(rng):
    n = 10
    A = rng.standard_normal((n, n)) / np.sqrt(n) * 0.7
    K = StateSpace(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), np.zeros((2, 2)), rate_hz=10.0)
    small = Balanced(states=4, method="perturbation").reduce(K).controller
    np.testing.assert_allclose(small.frequency_response([0.0]), K.frequency_response([0.0]), rtol=1e-6)


def test_an_unstable_loop_is_refused():
    plant = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)
    K = StateSpace([[0.1]], [[1.0]], [[5.0]], [[0.0]], rate_hz=1.0)
    with pytest.raises(InputError, match="unstable"):
        ClosedLoopWeighted(states=1).reduce(K, plant)


def test_norm_after_is_infinite_only_with_an_unstable_loop(designed):
    plant, result = designed
    small = ClosedLoopWeighted(states=1).reduce(result.controller, plant, result.details["weights"])
    stable = feedback(plant, small.controller).is_stable()
    assert stable or not small.status.ok
    assert np.isfinite(small.cost_after) == stable
    assert hinf_norm(feedback(plant, small.controller))[0] < np.inf or not stable


@pytest.mark.slow
def test_six_equal_laws_stay_equal():
    """One law of 24 states on six struts becomes one of 8 on six struts: 48 states, quiet in every direction."""
    plant = uq.bench.Hexapod(unit="ground").linear_model()
    numbers = {"control_limit": 1000.0, "control_hz": 400.0, "roll_off_hz": 500.0}
    result = BandAttenuation(band_hz=(9.0, 108.0), structure="repeated", **numbers).design(plant)
    small = ClosedLoopWeighted(states=50).reduce(result.controller, plant, result.details["weights"]).controller
    assert small.states == 48
    np.testing.assert_array_equal(small.A[:8, :8], small.A[40:, 40:])
    assert not np.any(small.A[:8, 8:])
    worst = uq.design.worst_attenuation_db(plant, small, (10.0, 100.0))
    peak_db = uq.analyse.peak_sensitivity(plant, small)[0]
    print(f"six times 8 states: worst direction {worst:.2f} dB over 10-100 Hz, peak {peak_db:.2f} dB")
    assert worst >= 12.0
    assert peak_db <= 8.0
