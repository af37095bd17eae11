"""A record whose outputs have nothing to do with its inputs leaves no model that is called ok."""

import numpy as np
import pytest

import ultraquiet as uq

METHODS = (uq.identify.Arx(order=2), uq.identify.OutputError(order=2), uq.identify.BoxJenkins(order=2))
METHODS += (uq.identify.Armax(order=2),)


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


@pytest.mark.parametrize("noise", [0.1, 1.0, 3.0])
def test_a_faint_answer_is_still_one(noise, rng):
    found = uq.identify.OutputError(order=2).identify(recorded(rng, noise))
    print(found.fit_percent, found.status)
    assert found.status.word != "poor fit"
    assert np.all(found.fit_percent > 0)
