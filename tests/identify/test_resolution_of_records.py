"""A fit to a response of a record that is too short for a mode says so; what it calls ok has the mode's damping."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import ultraquiet as uq
from ultraquiet.identify import Rational
from ultraquiet.identify.response.follows_inputs import following
from ultraquiet.linalg import discretize
from ultraquiet.values import Record, StateSpace

RATE_HZ, MODE_HZ = 200.0, 20.0


def truth(zeta, ny, nu, rng, scale):
    w = 2 * np.pi * MODE_HZ
    A = np.array([[0, 1], [-w * w, -2 * zeta * w]])
    B = np.vstack([np.zeros((1, nu)), w * w * rng.uniform(0.5, 1.0, (1, nu))])
    C = np.hstack([rng.uniform(0.5, 1.0, (ny, 1)), np.zeros((ny, 1))])
    A, B, C, D, _ = cont2discrete((A, B, C, np.zeros((ny, nu))), 1 / RATE_HZ)
    return StateSpace(A, B, scale * C, scale * D, RATE_HZ)


@pytest.mark.parametrize(("ny", "nu", "scale"), [(1, 1, 1.0), (3, 2, 1e-6)])
@pytest.mark.parametrize("samples", [4000, 16000])
def test_ok_has_the_damping_and_a_record_too_short_is_told(rng, samples, ny, nu, scale):
    for zeta in (0.001, 0.003, 0.01, 0.03):
        plant = truth(zeta, ny, nu, rng, scale)
        u = rng.standard_normal((nu, samples))
        y = plant.simulate(u)
        y += 0.01 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
        fitted = Rational(order=2).identify(Record(u, y, RATE_HZ))
        poles = np.log(fitted.model.poles().astype(complex)) * RATE_HZ
        found = poles[np.argmin(np.abs(poles.imag - 2 * np.pi * MODE_HZ))]
        share = -found.real / np.abs(found) / zeta
        print(f"{samples} samples, damping {zeta}: {share:.2f} of the truth, {fitted.status}")
        if fitted.status.ok:
            assert 0.85 < share < 1.15
        width, line = 2 * zeta * MODE_HZ, RATE_HZ / (samples // 8)
        if width < line:
            assert fitted.status.word == "poor fit"
            assert "Hz wide" in str(fitted.status) or "simulated" in str(fitted.status)
        if width > 2.5 * line:
            assert fitted.status.ok


def test_a_response_that_is_given_is_taken_as_it_is(rng):
    plant = truth(0.001, 1, 1, rng, 1.0)
    f = np.arange(0.5, 90.0, 0.5)
    fitted = Rational(order=2).identify_response(uq.FrequencyResponse(f, plant.frequency_response(f)), RATE_HZ)
    print(fitted.status)
    assert fitted.status.ok


def modes_at(hz, zeta, ny, nu, rng, scale=1.0):
    """Modes that answer white inputs alike in power."""
    w = np.repeat(2 * np.pi * np.asarray(hz), 2)
    A = np.zeros((w.size, w.size))
    for k in range(0, w.size, 2):
        A[k : k + 2, k : k + 2] = [[0, w[k]], [-w[k], -2 * zeta * w[k]]]
    B = (
        np.sqrt(w)[:, None]
        * (np.arange(w.size) % 2)[:, None]
        * np.repeat(rng.uniform(0.5, 1.5, (w.size // 2, nu)), 2, axis=0)
    )
    C = np.repeat(rng.uniform(0.5, 1.5, (ny, w.size // 2)), 2, axis=1) * (np.arange(w.size) % 2 == 0)
    return StateSpace(*discretize.zero_order_hold(A, B, scale * C, np.zeros((ny, nu)), 1 / RATE_HZ), RATE_HZ)


def ringing(hz, zeta, rng, shape):
    p = np.exp(2 * np.pi * hz / RATE_HZ * (-zeta + 1j))
    return np.asarray(lfilter([1.0], [1.0, -2 * p.real, abs(p) ** 2], rng.standard_normal(shape), axis=1))


@pytest.mark.parametrize(("ny", "nu", "scale"), [(1, 1, 1.0), (4, 3, 1e5), (3, 5, 1e-6)])
@pytest.mark.parametrize("zeta", [0.02, 0.1])
def test_a_slow_mode_that_is_missing_is_told(rng, ny, nu, scale, zeta):
    plant = modes_at([0.2, 20.0], zeta, ny, nu, rng, scale)
    u = rng.standard_normal((nu, 8000))
    y = plant.simulate(u)
    y += 0.03 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    fitted = Rational(order=4).identify(Record(u, y, RATE_HZ))
    told, true = (abs(x.frequency_response(np.array([0.2]))[:, :, 0]) for x in (fitted.model, plant))
    print(f"{told.max() / true.max():.3f} of the gain at 0.2 Hz, fit {fitted.fit_percent}, {fitted.status}")
    assert np.all(told > 0.5 * true) or fitted.status.word == "poor fit"


@pytest.mark.gate("4-3-100000.0", "1-1-1.0")
@pytest.mark.parametrize(("ny", "nu", "scale"), [(1, 1, 1.0), (4, 3, 1e5), (3, 5, 1e-6)])
def test_a_noise_louder_than_the_output_is_no_missing_mode(rng, ny, nu, scale):
    """Also where it rings: at the plant's mode, beside it, and so slowly that it outlasts the record."""
    plant = modes_at([12.0, 30.0], 0.03, ny, nu, rng, scale)
    u = rng.standard_normal((nu, 16000))
    y = plant.simulate(u)
    for hz, zeta in ((12.2, 1e-3), (22.0, 1e-4), (0.1, 1e-2)):
        v = ringing(hz, zeta, rng, y.shape)
        noisy = y + y.std(axis=1, keepdims=True) * v / v.std(axis=1, keepdims=True)
        fitted = Rational(order=4).identify(Record(u, noisy, RATE_HZ))
        print(f"noise at {hz} Hz: fit {fitted.fit_percent}, {fitted.status}")
        assert "follow the inputs" not in fitted.status.sentence


@pytest.mark.draws(false_alarm=9e-3)  # nine tests at the level of a thousandth
@pytest.mark.parametrize("nu", [1, 3])
def test_noise_follows_no_input_whatever_the_colours(rng, nu):
    n = 4000
    slow, sharp, wandering, early = (
        lambda shape: ringing(0.1, 1e-3, rng, shape),
        lambda shape: ringing(13.0, 1e-4, rng, shape),
        lambda shape: np.cumsum(rng.standard_normal(shape), axis=1),
        lambda shape: np.exp(-np.arange(n) / 500) * rng.standard_normal(shape),
    )
    for inputs in (wandering, sharp, early):
        for noise in (slow, sharp, wandering):
            found = following(noise((1, n))[0], inputs((nu, n)))
            print(found)
            assert found.p_value >= 1e-3
            assert found.share == 0.0
