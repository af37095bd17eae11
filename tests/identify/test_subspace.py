"""State space from one record of all channels."""

import time

import numpy as np
import pytest
from truths import modal_truth

import ultraquiet as uq
from ultraquiet._base.errors import InputError

PEER_FIT = 89.5  # percent, the best figure measured on this truth before


def test_six_by_six_of_order_thirty(rng):
    plant, record, clean = modal_truth(rng)
    begun = time.process_time()
    result = uq.identify.Subspace(order=30, feedthrough=False).identify(record)
    seconds = time.process_time() - begun
    simulated = result.model.simulate(record.inputs)
    fit = 100 * (1 - np.linalg.norm(clean - simulated, axis=1) / np.linalg.norm(clean, axis=1))
    true, found = plant.poles(), result.model.poles()
    near = sum(np.abs(found - p).min() < 0.2 * (1 - abs(p)) for p in true) // 2
    print(
        f"\n6 x 6, 30 states, 24000 samples: fit {fit.min():.1f} .. {fit.max():.1f} %, {near} of 15 modes, "
        f"{result.details['horizon']} block rows, {seconds:.1f} processor s, {result.status}"
    )
    assert np.mean(fit) >= PEER_FIT
    assert near >= 13
    assert result.model.is_stable()
    assert result.state_space() is result.model


def test_feedthrough_and_channels_are_kept(rng):
    A = np.array([[0.9, 0.3], [-0.3, 0.9]])
    D = np.array([[0.5, 0.0], [0.0, -0.25]])
    plant = uq.StateSpace(A, np.eye(2), np.array([[1.0, 0.0], [0.5, 1.0]]), D, rate_hz=200.0)
    u = rng.standard_normal((2, 3000))
    record = uq.Record(u, plant.simulate(u) + 0.01 * rng.standard_normal((2, 3000)), 200.0, ["a", "b"], ["c", "d"])
    result = uq.identify.Subspace(order=2, horizon=8).identify(record)
    assert pytest.approx(D, abs=0.01) == result.model.D
    assert result.model.actuators == record.actuators
    f_hz = np.linspace(0, 100, 50)
    assert result.model.frequency_response(f_hz) == pytest.approx(plant.frequency_response(f_hz), abs=0.05)


def test_initial_state_and_offset_do_not_disturb(rng):
    plant = uq.StateSpace([[0.995]], [[0.1]], [[1.0]], [[0.0]], rate_hz=200.0)
    u = rng.standard_normal((1, 2000))
    y = plant.simulate(u, x0=np.array([20.0])) + 5.0 + 0.01 * rng.standard_normal((1, 2000))
    result = uq.identify.Subspace(order=1, horizon=10, feedthrough=False).identify(uq.Record(u, y, 200.0))
    print(f"\npole {result.model.poles()[0].real:.5f} of 0.995, fit {result.fit_percent[0]:.2f} %")
    assert result.model.poles()[0].real == pytest.approx(0.995, abs=1e-3)
    assert result.fit_percent[0] > 99.0


def test_a_short_horizon_is_refused(rng):
    record = uq.Record(rng.standard_normal((2, 4000)), rng.standard_normal((2, 4000)), 100.0)
    with pytest.raises(InputError, match=r"order 30 needs at least 17 block rows, got 10"):
        uq.identify.Subspace(order=30, horizon=10).identify(record)
