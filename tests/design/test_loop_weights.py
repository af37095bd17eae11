"""Weights on S, T and KS: no loop of a cost lies above cost over weight, in the plant's own units."""

import numpy as np
import pytest
from named_plants import bench_like

from ultraquiet._base.registry import lookup
from ultraquiet.design import BandAttenuation, MixedSensitivity
from ultraquiet.design.weights.loop_weights import LoopWeights
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
}


def functions(plant, law):
    """S, T and KS over frequency, `(nf, ...)`."""
    G, K = (np.moveaxis(s.frequency_response(F_HZ), 2, 0) for s in (plant, law))
    S = np.linalg.inv(np.eye(G.shape[1]) - G @ K)
    return {"S": S, "T": G @ K @ S, "KS": K @ S}


def share(result, plant):
    """The largest singular value of each weighted function over what is left to it, at its largest."""
    left, made = result.loop_weights.left(F_HZ, result.achieved), functions(plant, result.controller)
    return {name: float((np.linalg.norm(made[name], 2, axis=(1, 2)) / left[name]).max()) for name in left}


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


@pytest.mark.parametrize("form", ["four-block", "sks", "skst"])
def test_of_one_channel_the_tightest_weight_is_met(form, rng):
    """At the optimum the weighted loop is flat, and somewhere one of its blocks is most of it."""
    pole = 0.98 * np.exp(2j * np.pi * rng.uniform(0.01, 0.03))
    plant = StateSpace([[pole.real, pole.imag], [-pole.imag, pole.real]], [[0.1], [0.0]], [[1.0, 0.5]], [[0.0]], 3500.0)
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
