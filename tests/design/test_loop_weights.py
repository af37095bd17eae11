"""Weights on S, T and KS: no loop of a cost lies above cost over weight, in the plant's own units."""

import numpy as np
import pytest
from named_plants import bench_like

from ultraquiet._base.registry import lookup
from ultraquiet.design import BandAttenuation, LoopShaping, MixedSensitivity, MuSynthesis
from ultraquiet.design.weights.loop_weights import LoopWeights
from ultraquiet.design.weights.shaped_loop import even_weight
from ultraquiet.design.weights.weight import weight
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append, gain, series

F_HZ = np.geomspace(1.0, 1740.0, 600)
BAND = {"band_hz": (10.0, 100.0)}
METHODS = {
    "default": (MixedSensitivity(), {"S", "KS"}),
    "default over a band": (MixedSensitivity(**BAND), {"S", "KS"}),
    "four-block": (MixedSensitivity(**BAND, height=3.0, noise=2.5), {"S", "KS"}),
    "skst": (MixedSensitivity("skst", **BAND, height=2.0), {"S", "T", "KS"}),
    "sks": (MixedSensitivity("sks", **BAND, height=2.0), {"S", "KS"}),
    "paper": (MixedSensitivity("paper"), {"S", "T", "KS"}),
    "band attenuation": (BandAttenuation(**BAND, height=2.0, uncertainty=(0.1, 300.0, 2.0)), {"S", "T", "KS"}),
    "band attenuation's default": (BandAttenuation(**BAND), {"S", "KS"}),
    "loop shaping": (LoopShaping(pre=(10.0, 50.0, 0.5)), {"S", "T", "KS"}),
    "loop shaping at both ends": (LoopShaping(pre=(10.0, 50.0, 0.5), post=(2.0, 50.0, 1.0)), {"S", "T", "KS"}),
    "loop shaping with constants": (LoopShaping(pre=gain(np.diag([1.0, 2.0] * 3), 3500.0)), {"S", "T", "KS"}),
}
# The plant is their measure: seconds of search each.
SMALL = {
    "loop shaping's default": (LoopShaping(), {"S", "T", "KS"}),
    "loop shaping by numbers": (LoopShaping(**BAND, height=3.0), {"S", "T", "KS"}),
    "mu synthesis": (MuSynthesis(iterations=2), {"S", "KS"}),
    "mu synthesis by numbers": (
        MuSynthesis(on_inputs=0.2, on_outputs=0.1, **BAND, height=3.0, control_limit=5.0, iterations=2),
        {"S", "KS"},
    ),
    "mu synthesis without control": (
        MuSynthesis(on_inputs=0.2, performance=(5.0, 60.0, 0.4), iterations=2),
        {"S"},
    ),
}


def mode(rng):
    """One damped mode, of one channel."""
    pole = 0.98 * np.exp(2j * np.pi * rng.uniform(0.01, 0.03))
    return StateSpace([[pole.real, pole.imag], [-pole.imag, pole.real]], [[0.1], [0.0]], [[1.0, 0.5]], [[0.0]], 3500.0)


def functions(plant, law):
    """S, T and KS over frequency, `(nf, ...)`."""
    G, K = (np.moveaxis(s.frequency_response(F_HZ), 2, 0) for s in (plant, law))
    S = np.linalg.inv(np.eye(G.shape[1]) - G @ K)
    return {"S": S, "T": G @ K @ S, "KS": K @ S}


def share(result, plant):
    """The largest singular value of each weighted function over what is left to it, at its largest."""
    left, made = result.loop_weights.left(F_HZ, result.achieved), functions(plant, result.controller)
    return {name: float((np.linalg.norm(made[name], 2, axis=(1, 2)) / left[name]).max()) for name in left}


@pytest.mark.gate("default over a band", "loop shaping", "paper", "skst")
@pytest.mark.parametrize("name", METHODS)
def test_no_loop_lies_above_what_its_cost_leaves(name, rng):
    method, weighted = METHODS[name]
    plant = bench_like(rng, 3)
    uneven = series(gain(np.diag(10 ** rng.uniform(-1, 1, 6)), plant.rate_hz), plant)
    result = method.design(uneven)
    shares = share(result, uneven)
    print(f"{name}: {shares}")
    assert set(shares) == weighted
    assert max(shares.values()) <= 1 + 1e-6


@pytest.mark.gate("loop shaping's default", "loop shaping by numbers")
@pytest.mark.parametrize("name", SMALL)
def test_so_it_is_where_the_plant_is_the_measure(name, rng):
    method, weighted = SMALL[name]
    one = mode(rng)
    A, B, C = (np.kron(np.eye(2), part) for part in (one.A, one.B, one.C))
    plant = StateSpace(A, B @ [[1.0, 0.3], [0.2, 2.0]], [[1.0, 0.1], [0.2, 10.0]] @ C, np.zeros((2, 2)), 3500.0)
    result = method.design(plant)
    shares = share(result, plant)
    print(f"{name}: {shares}")
    assert set(shares) == weighted
    assert max(shares.values()) <= 1 + 1e-6


@pytest.mark.parametrize(
    ("errors", "named"),
    [({"on_inputs": 0.2}, {"S", "T"}), ({"on_inputs": 0.2, "on_outputs": (0.1, 500.0, 1.0)}, {"S", "T"})],
)
def test_of_one_channel_the_error_that_is_stood_bounds_t(errors, named, rng):
    plant = mode(rng)
    result = MuSynthesis(**errors, performance=(5.0, 60.0, 0.4), iterations=2).design(plant)
    shares = share(result, plant)
    print(f"{errors}: {shares}")
    assert set(shares) == named
    assert max(shares.values()) <= 1 + 1e-6


def test_of_one_channel_a_shaped_loop_is_as_large_as_its_norm_allows(rng):
    plant = mode(rng)
    shares = share(LoopShaping(margin=1.001).design(plant), plant)
    print(shares)
    assert 0.9 < max(shares.values()) <= 1 + 1e-6


def test_an_integrator_in_the_loop_leaves_its_own_frequency_open(rng):
    weights = LoopShaping(**BAND, height=3.0, integral_hz=1.0).design(mode(rng)).loop_weights
    left = weights.left(np.array([0.0]), 1.0)["S"]  # an infinite weight, or one that is as good as that
    assert np.all(np.isinf(left) | (left < 1e-6))
    assert np.isfinite(weights.left(np.array([1.0]), 1.0)["S"]).all()


def test_a_weight_is_told_apart_into_one_channel_and_a_constant(rng):
    one, mix = weight("test", "pre", (20.0, 5.0, 0.5), 1, 1000.0), rng.standard_normal((3, 3))
    W = series(append(one, one, one), gain(mix, 1000.0))
    found = even_weight(W)
    again = found.mix @ (np.eye(3) * found.one.frequency_response(F_HZ[:5])[0, 0][:, None, None])
    np.testing.assert_allclose(np.moveaxis(again, 0, 2), W.frequency_response(F_HZ[:5]), rtol=1e-9)
    other = weight("test", "pre", (3.0, 5.0, 0.5), 1, 1000.0)
    assert even_weight(append(one, other)) is None


@pytest.mark.parametrize("form", ["four-block", "sks", "skst"])
def test_of_one_channel_the_tightest_weight_is_met(form, rng):
    """At the optimum the weighted loop is flat, and somewhere one of its blocks is most of it."""
    plant = mode(rng)
    result = MixedSensitivity(form, **BAND, height=3.0, disturbance=1e-3, noise=2.0, margin=1.001).design(plant)
    shares = share(result, plant)
    print(f"{form}: {shares}")
    assert 0.9 < max(shares.values()) <= 1 + 1e-6


def test_what_the_weights_leave_is_of_the_direction_that_they_weigh_least():
    one, two = (weight("test", "performance", (low, 5.0, 0.5), 1, 1000.0) for low in (20.0, 3.0))
    left = LoopWeights(S=append(one, two)).left(np.array([0.0]), 2.0)["S"]
    np.testing.assert_allclose(left, 2.0 / 3.0)


def test_a_weight_that_sees_not_every_direction_bounds_nothing():
    of_the_sum = gain([[1.0, 1.0]])
    assert np.isinf(LoopWeights(S=of_the_sum).left(F_HZ, 1.0)["S"]).all()


def test_a_method_without_weights_on_the_loop_has_none():
    plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    assert lookup("design", "lqg")().design(plant).loop_weights is None
