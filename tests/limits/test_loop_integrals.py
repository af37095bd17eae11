"""Bode's and Poisson's integrals against quadrature on random loops, and against textbooks."""

import numpy as np
import pytest
from limit_plants import RATE_HZ, modal, regulator, responses
from scipy.linalg import solve_continuous_are

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.limits import bode_integral, distance, poisson_integral, principal_directions, waterbed_peak
from ultraquiet.values import StateSpace


def random_plant(rng, channels, continuous=False):
    n = int(rng.integers(2, 8))
    A = rng.standard_normal((n, n))
    A = (
        A - rng.uniform(0, 2) * np.eye(n)
        if continuous
        else A * rng.uniform(0.5, 1.4) / np.abs(np.linalg.eigvals(A)).max()
    )
    B, C = rng.standard_normal((n, channels)), rng.standard_normal((channels, n))
    return StateSpace(A, B, C, np.zeros((channels, channels)), rate_hz=None if continuous else 100.0)


@pytest.mark.parametrize("channels", [1, 3])
def test_bodes_integral_of_sampled_loops(rng, channels):
    for _ in range(20):
        plant = random_plant(rng, channels)
        found = bode_integral(plant, regulator(plant, rng))
        print(f"{channels} channels: measured {found.measured_db:.9f} dB, owed {found.owed_db:.9f} dB")
        assert found.measured_db == pytest.approx(found.owed_db, abs=1e-6)
        assert found.owed_db >= 0


def test_bodes_integral_with_a_direct_path():
    plant = StateSpace([[1.3]], [[1.0]], [[0.5]], [[0.4]], rate_hz=10.0)
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-1.0]], rate_hz=10.0)
    # S = 1 / (1 + 0.4 + 0.5 / (z - 1.3)): its value at infinity is 1 / 1.4, its zero 1.3
    assert bode_integral(plant, law).measured_db == pytest.approx(20 * np.log10(1.3 / 1.4), abs=1e-6)


def test_bodes_integral_of_continuous_loops(rng):
    for _ in range(10):
        plant = random_plant(rng, 2, continuous=True)
        A, B, C = plant.A, plant.B, plant.C
        F = -B.T @ solve_continuous_are(A, B, C.T @ C, np.eye(2))
        L = -solve_continuous_are(A.T, C.T, B @ B.T, np.eye(2)) @ C.T
        found = bode_integral(plant, StateSpace(A + B @ F + L @ C, -L, F, np.zeros((2, 2))))
        print(f"measured {found.measured_db:.6f} dB Hz, owed {found.owed_db:.6f} dB Hz")
        assert found.measured_db == pytest.approx(found.owed_db, abs=1e-4 * max(1.0, found.owed_db))


def test_bodes_integral_of_a_slow_roll_off():
    """L = 3 / (s + 1): S = (s + 1) / (s + 4), the area of ln|S| is -pi 3 / 2 (Skogestad and Postlethwaite, 5.2)."""
    lag = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-3.0]])
    exact = 20 / np.log(10) * -np.pi * 3 / 2 / (2 * np.pi)
    assert bode_integral(lag, law).owed_db == pytest.approx(exact, rel=1e-12)
    assert bode_integral(lag, law).measured_db == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("channels", [1, 2])
def test_poissons_integral(rng, channels):
    met = 0
    for _ in range(40):
        plant = random_plant(rng, channels)
        for found in poisson_integral(plant, regulator(plant, rng)):
            met += 1
            print(f"{found.name}: measured {found.measured_db:.7f} dB, owed {found.owed_db:.7f} dB")
            if channels == 1 or plant.is_stable():
                tolerance = 1e-4 * max(1.0, found.owed_db)
                assert found.measured_db >= found.owed_db - tolerance
            if channels == 1:
                assert found.measured_db == pytest.approx(found.owed_db, rel=1e-3, abs=1e-4)
    assert met > 5


def test_textbook_peak_of_an_unstable_plant_with_a_slow_zero():
    """(s - 4) / ((s - 1)(0.1 s + 1)): |S| >= (4 + 1) / (4 - 1) (Skogestad and Postlethwaite 2005, section 5.3)."""
    plant = StateSpace([[1.0, 1.0], [0.0, -10.0]], [[0.0], [10.0]], [[-3.0, 1.0]], [[0.0]])
    s = 2j
    response = plant.frequency_response([2 / (2 * np.pi)])[0, 0, 0]
    assert response == pytest.approx((s - 4) / ((s - 1) * (0.1 * s + 1)), rel=1e-9)
    assert waterbed_peak(plant, (1e-9, 2e-9), 0.0) == pytest.approx(20 * np.log10(5 / 3), rel=1e-6)


def test_textbook_peak_of_a_slow_zero():
    """A zero at x, attenuation A up to x rad/s: half of what it sees is quiet, so the peak is A."""
    zero = 2 * np.pi * 10.0
    plant = StateSpace([[-50.0]], [[1.0]], [[-50.0 - zero]], [[1.0]])  # (s - x) / (s + 50)
    assert waterbed_peak(plant, (1e-9, 10.0), 20.0) == pytest.approx(20.0, rel=1e-6)
    # up to tan(60 degrees) x: two thirds are quiet, the peak is twice A
    assert waterbed_peak(plant, (1e-9, 10.0 * np.sqrt(3)), 20.0) == pytest.approx(40.0, rel=1e-6)


def test_available_bandwidth():
    """Unstable pole p, bandwidth w: the peak is at least exp(pi p / w) (Stein 2003, doi:10.1109/MCS.2003.1213600)."""
    plant = StateSpace([[6.0, 1.0], [0.0, -30.0]], [[0.0], [30.0]], [[1.0, 0.0]], [[0.0]])
    least = waterbed_peak(plant, (1e-9, 2e-9), 0.0, bandwidth_hz=40 / (2 * np.pi))
    print(f"p = 6 rad/s, 40 rad/s of bandwidth: |S| >= {10 ** (least / 20):.3f}")
    assert 10 ** (least / 20) == pytest.approx(np.exp(np.pi * 6 / 40), rel=1e-6)


def test_real_loops_keep_to_the_waterbed(rng):
    for _ in range(20):
        plant = modal(rng)
        law = regulator(plant, rng)
        f = np.linspace(1, RATE_HZ / 2, 4000)
        S, _ = responses(plant, law, f)
        quiet = (f[np.argmin(S)] * 0.8, min(f[np.argmin(S)] * 1.2, 0.49 * RATE_HZ))
        reached = -20 * np.log10(S[(f >= quiet[0]) & (f <= quiet[1])].max())
        if reached > 0:
            assert waterbed_peak(plant, quiet, reached) <= 20 * np.log10(S.max()) + 0.05


def test_refusals():
    lag = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    wild = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[5.0]], rate_hz=100.0)
    with pytest.raises(uq.errors.InputError, match="bode_integral: the loop is unstable"):
        bode_integral(lag, wild)
    with pytest.raises(uq.errors.InputError, match="poisson_integral"):
        poisson_integral(lag, StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    with pytest.raises(uq.errors.InputError, match="waterbed_peak"):
        waterbed_peak(lag, (5.0, 20.0), 10.0, bandwidth_hz=15.0)


@pytest.mark.parametrize("verb", [bode_integral, poisson_integral, distance])
@pytest.mark.parametrize("name", ["plant", "controller"])
def test_what_is_no_system_is_refused_by_name(verb, name):
    lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=1000.0)
    asked = {"plant": lag, "controller": lag, **({"band_hz": (5.0, 50.0)} if verb is distance else {}), name: None}
    with pytest.raises(InputError, match=f"{verb.__name__}: '{name}' must be a StateSpace"):
        verb(**asked)
    with pytest.raises(InputError, match="principal_directions: 'plant' must be a StateSpace"):
        principal_directions(None, (5.0, 50.0))
