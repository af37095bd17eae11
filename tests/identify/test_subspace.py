"""State space from one record of all channels."""

import time

import numpy as np
import pytest
from truths import modal_truth

import ultraquiet as uq
from ultraquiet._base.errors import InputError

PEER_FIT = 89.5  # percent, the best figure measured on this truth before
FIT, SHARE = 95.0, 0.01  # percent; of a mode's frequency


def fit_percent(clean, said):
    return 100 * (1 - np.linalg.norm(clean - said, axis=1) / np.linalg.norm(clean, axis=1))


def modes_found(plant, model, share=SHARE):
    true, found = (np.abs(np.log(m.poles())) for m in (plant, model))
    return sum(np.abs(found / one - 1).min() < share for one in true) // 2


@pytest.mark.slow
def test_six_by_six_of_order_thirty(rng):
    plant, record, clean = modal_truth(rng)
    begun = time.process_time()
    result = uq.identify.Subspace(order=30, feedthrough=False).identify(record)
    seconds = time.process_time() - begun
    fit = fit_percent(clean, result.model.simulate(record.inputs))
    near = modes_found(plant, result.model)
    print(
        f"\n6 x 6, 30 states, 24000 samples: fit {fit.min():.1f} .. {fit.max():.1f} %, {near} of 15 modes, "
        f"{result.details['horizon']} block rows, {seconds:.1f} processor s, {result.status}"
    )
    assert np.mean(fit) >= PEER_FIT
    assert near >= 13
    assert result.model.is_stable()
    assert result.state_space() is result.model


@pytest.mark.slow
def test_the_order_of_six_by_six_is_found(rng):
    plant, record, clean = modal_truth(rng)
    result = uq.identify.Subspace(order=None, feedthrough=False, refine=True).identify(record)
    fit = fit_percent(clean, result.model.simulate(record.inputs))
    near = modes_found(plant, result.model)
    print(f"\norder {result.details['order']} of 30, fit {fit.min():.1f} %, {near} of 15 modes, {result.status}")
    assert 28 <= result.details["order"] <= 34
    assert np.mean(fit) >= FIT


def small(rng, n=3000, noise=0.01):
    """Two inputs, two outputs, two modes and a record of them."""
    A = np.array([[0.9, 0.3, 0, 0], [-0.3, 0.9, 0, 0], [0, 0, 0.5, 0.7], [0, 0, -0.7, 0.5]])
    B, C = rng.uniform(0.5, 1.5, (4, 2)) * [1, -1], rng.uniform(0.5, 1.5, (2, 4)) * [[1, 1, 1, 1], [1, 1, -1, -1]]
    D = np.array([[0.5, 0.0], [0.0, -0.25]])
    plant = uq.StateSpace(A, B, C, D, rate_hz=200.0)
    u = rng.standard_normal((2, n))
    y = plant.simulate(u)
    return plant, uq.Record(u, y + noise * rng.standard_normal(y.shape), 200.0, ["a", "b"], ["c", "d"])


@pytest.mark.parametrize("weight", ["moesp", "n4sid", "cva"])
@pytest.mark.parametrize("refine", [False, True])
def test_every_weight_finds_the_plant(weight, refine, rng):
    plant, record = small(rng)
    result = uq.identify.Subspace(order=4, horizon=8, weight=weight, refine=refine).identify(record)
    f_hz = np.linspace(0, 100, 50)
    true, found = plant.frequency_response(f_hz), result.model.frequency_response(f_hz)
    print(f"\n{weight}: largest error of the response {np.abs(found - true).max():.1e} of {np.abs(true).max():.0f}")
    assert found == pytest.approx(true, abs=0.02 * np.abs(true).max())
    assert pytest.approx(plant.D, abs=0.05) == result.model.D
    assert result.model.actuators == record.actuators
    assert result.details["singular_values"].size >= 4


def test_the_order_is_found(rng):
    _, record = small(rng)
    result = uq.identify.Subspace(order=None).identify(record)
    print(f"\norder {result.details['order']} of 4, {result.status}")
    assert result.details["order"] == 4
    assert result.model.states == 4
    assert result.status.word != "not converged"


def test_initial_state_and_offset_do_not_disturb(rng):
    plant = uq.StateSpace([[0.995]], [[0.1]], [[1.0]], [[0.0]], rate_hz=200.0)
    u = rng.standard_normal((1, 2000))
    noise = 0.01 * rng.standard_normal((1, 2000))
    y = plant.simulate(u, x0=np.array([20.0])) + 5.0 + noise
    best = 100 * (1 - noise.std() / y.std())
    for refine, worse in ((False, 1.0), (True, 0.01)):
        method = uq.identify.Subspace(order=1, horizon=10, feedthrough=False, refine=refine)
        result = method.identify(uq.Record(u, y, 200.0))
        pole, fit = result.model.poles()[0].real, result.fit_percent[0]
        print(f"\nrefined: {refine}; pole {pole:.5f} of 0.995, fit {fit:.2f} %, of the truth {best:.2f}")
        assert pole == pytest.approx(0.995, abs=1e-3)
        assert fit > best - worse


def test_a_short_horizon_is_refused(rng):
    record = uq.Record(rng.standard_normal((2, 4000)), rng.standard_normal((2, 4000)), 100.0)
    with pytest.raises(InputError, match=r"order 30 needs at least 17 block rows, got 10"):
        uq.identify.Subspace(order=30, horizon=10).identify(record)


BOTH = [uq.identify.Subspace(order=4), uq.identify.PredictorSubspace(order=4)]


@pytest.fixture(params=BOTH, ids=lambda m: m.name)
def method(request):
    return request.param


@pytest.mark.parametrize("late", [0, 1])
def test_collinear_inputs_are_refused(method, late, rng):
    u = rng.standard_normal((3, 6000))
    u[2] = np.roll(u[0] - 0.5 * u[1], late)
    record = uq.Record(u, rng.standard_normal((2, 6000)), 200.0, ["x", "y", "z"])
    with pytest.raises(InputError, match=r"follow from each other|follows from the other inputs"):
        method.identify(record)


def test_nearly_collinear_inputs_are_not(method, rng):
    _, record = small(rng)
    u = np.vstack([record.inputs[0], record.inputs[0] + 0.1 * record.inputs[1]])
    method.identify(uq.Record(u, record.outputs, 200.0))


def test_an_order_too_high_is_told(rng):
    _, record = small(rng)
    for refine in (False, True):
        result = uq.identify.Subspace(order=16, horizon=20, refine=refine).identify(record)
        print(f"\norder 16 for a plant of 4, refine {refine}: {result.status}")
        assert result.status.word == "not converged"
        assert result.details["spare_modes"] >= 3


def test_an_unstable_record_is_told(method, rng):
    plant = uq.StateSpace([[1.005, 0.1], [-0.1, 1.005]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.0]], rate_hz=200.0)
    u = rng.standard_normal((1, 2000))
    with pytest.raises(InputError, match="unstable") as refused:
        method.identify(uq.Record(u, plant.simulate(u), 200.0))
    print(f"\n{refused.value}")


def test_an_all_zero_channel_is_refused(method, rng):
    _, record = small(rng)
    for inputs, outputs, kind in (
        (record.inputs * [[1], [0]], record.outputs, "input 'b'"),
        (record.inputs, record.outputs * [[0], [1]], "output 'c'"),
    ):
        with pytest.raises(InputError, match=f"{kind} is constant at 0,"):
            method.identify(uq.Record(inputs, outputs, 200.0, ["a", "b"], ["c", "d"]))
