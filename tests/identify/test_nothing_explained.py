"""A record whose outputs have nothing to do with its inputs leaves no model that is called ok."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq

METHODS = (uq.identify.Arx(order=2), uq.identify.OutputError(order=2), uq.identify.BoxJenkins(order=2))
METHODS += (uq.identify.Armax(order=2),)
OTHERS = {
    "subspace": uq.identify.Subspace(order=2),
    "subspace refined": uq.identify.Subspace(order=2, refine=True),
    "subspace auto": uq.identify.Subspace(),
    "predictor": uq.identify.PredictorSubspace(order=2),
    "predictor auto": uq.identify.PredictorSubspace(),
    "impulse": uq.identify.ImpulseResponse(),
    "regularised": uq.identify.RegularisedArx(),
    "weighted rational": uq.identify.WeightedRational(order=2),
    "recursive arx": uq.identify.RecursiveArx(order=2),
    "recursive armax": uq.identify.RecursiveArmax(order=2),
    "recursive output error": uq.identify.RecursiveOutputError(order=2),
    "recursive box-jenkins": uq.identify.RecursiveBoxJenkins(order=2),
}
FOUND = OTHERS | {"box-jenkins": uq.identify.BoxJenkins(order=2)}


def recorded(rng, noise):
    plant = uq.StateSpace([[0.9, 0.3], [-0.3, 0.9]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.0]], rate_hz=100.0)
    u = rng.standard_normal((1, 2000))
    y = plant.simulate(u)
    return uq.Record(u, y + noise * y.std() * rng.standard_normal(y.shape), 100.0)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_inputs_and_outputs_swapped_or_of_two_runs(method, rng):
    one, other = recorded(rng, 0.1), recorded(rng, 0.1)
    white = uq.Record(one.inputs, rng.standard_normal((1, 2000)), 100.0)
    for record in (white, uq.Record(one.inputs, other.inputs, 100.0)):
        found = method.identify(record)
        print(found.fit_percent, found.status)
        assert not found.status.ok


@pytest.mark.parametrize("method", OTHERS)
def test_noise_of_no_input_is_called_alike_by_all(method, rng):
    found = OTHERS[method].identify(uq.Record(rng.standard_normal((1, 3000)), rng.standard_normal((1, 3000)), 100.0))
    print(found.fit_percent, found.status)
    assert found.status.word == "poor fit"


@pytest.mark.parametrize("method", FOUND)
def test_noise_that_rings_is_explained_by_no_input(method, rng):
    """At its resonance noise has most of its power, and a mode put there takes much of it by chance."""
    y = lfilter([1.0], [1.0, -1.6, 0.95], rng.standard_normal((1, 1500)))
    found = FOUND[method].identify(uq.Record(rng.standard_normal((1, 1500)), y, 100.0))
    print(found.fit_percent, found.status)
    assert not found.status.ok


@pytest.mark.parametrize("method", FOUND)
@pytest.mark.parametrize("colour", [0.0, 0.95])
def test_a_slow_mode_under_loud_noise_is_not_called_nothing(method, colour, rng):
    plant = uq.StateSpace([[0.99]], [[0.1]], [[1.0]], [[0.0]], rate_hz=100.0)
    u = rng.standard_normal((1, 3000))
    y, e = plant.simulate(u), lfilter([1.0], [1.0, -colour], rng.standard_normal((1, 3000)))
    found = FOUND[method].identify(uq.Record(u, y + y.std() / e.std() * e, 100.0))
    print(found.fit_percent, found.status)
    assert "by chance" not in found.status.sentence


@pytest.mark.parametrize("noise", [0.1, 1.0, 3.0])
def test_a_faint_answer_is_still_one(noise, rng):
    found = uq.identify.OutputError(order=2).identify(recorded(rng, noise))
    print(found.fit_percent, found.status)
    assert found.status.word != "poor fit"
    assert np.all(found.fit_percent > 0)


def test_a_zero_of_the_plant_is_none_of_these(rng):
    """Two loops that do not touch, one record an actuator; swapped columns of the same records are still told."""
    records = []
    for k in range(2):
        own, rest = recorded(rng, 0.1), rng.standard_normal((1, 2000))
        outputs = np.vstack([own.outputs, rest] if k == 0 else [rest, own.outputs])
        records.append(uq.Record(own.inputs, outputs, 100.0, [f"coil {k + 1}"]))
    method = uq.identify.OutputError(order=2)
    found = uq.identify.identify_matrix(method, records)
    print(found.status, [[s.sentence for s in row] for row in found.statuses])
    assert found.status.ok
    assert "a zero of the plant" in found.statuses[0][1].sentence
    dead = [uq.Record(r.inputs, np.vstack([r.outputs[:1], rng.standard_normal((1, 2000))]), 100.0) for r in records]
    assert uq.identify.identify_matrix(method, dead).status.word == "poor fit"
