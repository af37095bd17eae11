"""A fit to a response of a record that is too short for a mode says so; what it calls ok has the mode's damping."""

import numpy as np
import pytest
from scipy.signal import cont2discrete

import ultraquiet as uq
from ultraquiet.identify import Rational
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
