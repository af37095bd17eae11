"""Limits by direction depend on no unit of states, and on no order of actuators."""

import numpy as np
import pytest
from limit_plants import RATE_HZ, modal

from ultraquiet.limits import by_direction
from ultraquiet.limits.circle import Circle
from ultraquiet.limits.directions import AllActuators, _common, driven
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append, series

QUIET = (20.0, 100.0)
LAG = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)


def in_units(plant, d):
    return StateSpace(plant.A * d / d[:, None], plant.B / d[:, None], plant.C * d, plant.D, plant.rate_hz)


def turned(plant, rng):
    Q = np.linalg.qr(rng.standard_normal((plant.states, plant.states)))[0]
    return StateSpace(Q.T @ plant.A @ Q, Q.T @ plant.B, plant.C @ Q, plant.D, plant.rate_hz)


def late(samples, channels):
    """Return equal lags, each behind a delay beside its own."""
    A, C = np.eye(samples, k=1), np.eye(1, samples)
    chain = series(StateSpace(A, np.eye(samples)[:, -1:], C, [[0.0]], RATE_HZ), LAG)
    plant = chain
    for _ in range(channels - 1):
        plant = append(plant, chain)
    return plant


@pytest.mark.parametrize("scale", [1e5, 4e5, 1e9])
def test_a_bound_has_no_units_of_states(scale):
    """Two lags in a row in each channel: two samples of delay, however large the states are written."""
    plant, v = append(series(LAG, LAG), series(LAG, LAG)), np.array([1.0, 0.0])
    scaled = in_units(plant, np.array([1 / scale, scale, 1 / scale, scale]))
    one, other = (
        by_direction(G, QUIET, 6.0, directions=v[:, None], control_gain=300.0, basis=10)[0] for G in (plant, scaled)
    )
    print(f"{one.limit.bound_db:.2f} dB, in other units {other.limit.bound_db:.2f} dB")
    assert _common(plant, v)[1] == _common(scaled, v)[1] == 2
    assert other.limit.attenuation_db == pytest.approx(one.limit.attenuation_db, abs=0.05)
    assert other.limit.bound_db == pytest.approx(one.limit.bound_db, abs=0.2)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("samples", [1, 3, 12])
def test_a_delay_is_counted_in_any_coordinates(rng, channels, samples):
    plant = late(samples, channels)
    v = np.ones(channels) / np.sqrt(channels)
    d = 10.0 ** rng.uniform(-8, 8, plant.states)
    for form in (plant, in_units(plant, d), turned(plant, rng), in_units(turned(plant, rng), d)):
        assert _common(form, v)[1] == samples + 1


@pytest.mark.parametrize("shape", [(1, 1), (3, 4), (5, 3)])
def test_zeros_and_delay_are_those_of_the_plant(rng, shape):
    """A mode sampled slowly answers within a sample; times z it has the same zeros, and no delay."""
    ny, nu = shape
    square = modal(rng, max(shape))
    plant = StateSpace(square.A, square.B[:, :nu], square.C[:ny], square.D[:ny, :nu], RATE_HZ)
    for v in np.eye(ny):
        zeros, delay = _common(plant, v)
        assert delay == 1
        for s in zeros:
            z = (1 + s / (2 * RATE_HZ)) / (1 - s / (2 * RATE_HZ))
            row = v @ plant.C @ np.linalg.solve(z * np.eye(plant.states) - plant.A, plant.B)
            assert np.linalg.norm(row) < 1e-6 * np.linalg.norm(v @ plant.C) * np.linalg.norm(plant.B)


@pytest.mark.slow
@pytest.mark.parametrize("channels", [2, 3])
def test_a_limit_has_no_order_of_actuators(channels):
    plant = append(*[LAG] * channels)
    wired = StateSpace(plant.A, np.roll(plant.B, 1, axis=1), plant.C, plant.D, plant.rate_hz)
    f = np.geomspace(*QUIET, 5)
    for one, other in zip(
        *(by_direction(G, QUIET, 6.0, control_gain=10.0, basis=12) for G in (plant, wired)), strict=True
    ):
        assert one.limit.status.ok, one.limit.status
        assert other.limit.status.word == one.limit.status.word
        assert other.limit.attenuation_db == pytest.approx(one.limit.attenuation_db, abs=1e-3)
        assert other.limit.bound_db == pytest.approx(one.limit.bound_db, abs=1e-3)
        assert other.coupling_db > 100
    v = np.eye(channels)[:, 0]
    assert np.all(driven(plant, v, QUIET) == v)
    assert np.abs(v @ wired.frequency_response(f)[:, :, 0] @ driven(wired, v, QUIET)) > 0.1


@pytest.mark.parametrize("shape", [(1, 2), (4, 3), (3, 5)])
@pytest.mark.parametrize("draw", range(3))
def test_what_all_actuators_reach_is_the_plants_own_gain_where_its_poles_crowd(shape, draw):
    """Three poles within 2 % of each other, five decades below the sampling rate: modes alone are off by a half."""
    rng, rate_hz = np.random.default_rng(draw), 5e4
    companion = np.poly(-0.3 * (1 + rng.uniform(0, 0.02, 3)))
    A = np.eye(3) + np.vstack([-companion[1:], np.eye(2, 3)]) / rate_hz
    B, C = rng.standard_normal((3, shape[1])) / rate_hz, rng.standard_normal((shape[0], 3))
    v = np.linalg.qr(rng.standard_normal((shape[0], 1)))[0][:, 0]
    f = np.geomspace(0.005, 0.5, 40)
    reached = AllActuators(StateSpace(A, B, C, np.zeros(shape), rate_hz), v, Circle(rate_hz, 0.05))(f).b
    z = np.exp(2j * np.pi * f / rate_hz)
    expected = np.linalg.norm(v @ C @ np.linalg.solve(z[:, None, None] * np.eye(3) - A, B.astype(complex)), axis=1)
    assert np.abs(reached) == pytest.approx(expected, rel=1e-6)
