"""S and K S at single lines, also where the plant's or the law's own response has no bound."""

import numpy as np
import pytest

from ultraquiet.analyse.loop_response import band_attenuation, both_sensitivities, loop_response, reached_directions
from ultraquiet.design import Lqg
from ultraquiet.linalg import discretize
from ultraquiet.reduce import ClosedLoopWeighted
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback, sensitivity, series

RATE_HZ = 1000.0


def two_by_two(mode_hz: float) -> StateSpace:
    """Return a double integrator that moves both readings alike, and an undamped mode in which they differ."""
    w = 2 * np.pi * mode_hz
    A = np.zeros((4, 4))
    A[0, 1], A[2, 3], A[3, 2] = 1.0, w, -w
    B = np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0], [1.0, -1.0]])
    C = np.array([[1.0, 0.0, 1.0, 0.0], [1.0, 0.0, -1.0, 0.0]])
    return StateSpace(*discretize.zero_order_hold(A, B, C, np.zeros((2, 2)), 1 / RATE_HZ), rate_hz=RATE_HZ)


def control(plant, law):
    """Return K S as a system: the law behind the sensitivity."""
    return series(sensitivity(plant, law), law)


@pytest.mark.parametrize("mode_hz", [20.0, 111.0])
def test_a_line_on_a_pole_has_the_closed_loops_own_response(mode_hz):
    plant = two_by_two(mode_hz)
    law = Lqg().design(plant).controller
    assert feedback(plant, law).is_stable()
    f = np.array([0.0, 1e-7, 1e-4, 3.0, mode_hz, mode_hz * (1 + 1e-15), 400.0])
    S, KS = loop_response(plant, law, f)
    expected = np.moveaxis(sensitivity(plant, law).frequency_response(f), 2, 0)
    # K S of a series of systems loses what cancels between them, not what is compared here
    driven = np.moveaxis(control(plant, law).frequency_response(f), 2, 0)
    assert np.abs(S - expected).max() < 1e-6
    assert np.abs(KS - driven).max() < 1e-6 * np.abs(driven).max()
    at_input, at_output = both_sensitivities(plant, law)(f)
    assert at_output == pytest.approx(S, abs=1e-12)  # K S beside it evens the states otherwise
    other = np.moveaxis(sensitivity(law, plant).frequency_response(f), 2, 0)
    assert np.abs(at_input - other).max() < 1e-6 * np.abs(other).max()
    # where both readings move alike without bound, nothing of their mean is left, and their difference is free
    assert np.abs(S[0].sum(axis=0)).max() < 1e-9


def test_an_ordinary_line_is_plain_arithmetic(rng):
    plant = StateSpace(0.5 * np.eye(3), rng.normal(size=(3, 2)), rng.normal(size=(4, 3)), np.zeros((4, 2)), RATE_HZ)
    law = StateSpace([[0.3]], 0.01 * rng.normal(size=(1, 4)), rng.normal(size=(2, 1)), np.zeros((2, 4)), RATE_HZ)
    f = np.geomspace(1.0, 499.0, 20)
    S, KS = loop_response(plant, law, f)
    at_input, _ = both_sensitivities(plant, law)(f)
    for k, at in enumerate(f):
        G, K = (system.frequency_response([at])[:, :, 0] for system in (plant, law))
        assert S[k] @ (np.eye(4) - G @ K) == pytest.approx(np.eye(4), abs=1e-12)
        assert KS[k] == pytest.approx(K @ S[k], abs=1e-12)
        assert at_input[k] @ (np.eye(2) - K @ G) == pytest.approx(np.eye(2), abs=1e-12)


def test_a_law_of_integrators_is_reduced_by_what_it_promised():
    """Its lines begin where the loop's size is beyond all digits; the matrix to invert was singular there."""
    for mode_hz in (0.02, 3.0, 200.0):
        plant = two_by_two(mode_hz)
        law = Lqg().design(plant).controller
        small = ClosedLoopWeighted().reduce(law, plant)
        assert small.status.ok, small.status
        assert feedback(plant, small.controller).is_stable()


def drifting(outputs: int, inputs: int, rate_hz: float | None) -> StateSpace:
    """Return a mode at 5 Hz of damping 1e-3 and an integrator, each seen in a direction of its own."""
    rng, w = np.random.default_rng(outputs), 2 * np.pi * 5.0
    A = np.array([[-1e-3 * w, w, 0.0], [-w, -1e-3 * w, 0.0], [0.0, 0.0, 0.0]])
    B = np.vstack([np.zeros(inputs), w * rng.normal(size=inputs), rng.normal(size=inputs)])
    C = np.column_stack([rng.normal(size=outputs), np.zeros(outputs), 5 * rng.normal(size=outputs)])
    D = np.zeros((outputs, inputs))
    return StateSpace(*(discretize.zero_order_hold(A, B, C, D, 1 / rate_hz) if rate_hz else (A, B, C, D)), rate_hz)


def solved(system: StateSpace, f: np.ndarray) -> np.ndarray:
    z = 2j * np.pi * f if system.rate_hz is None else np.exp(2j * np.pi * f / system.rate_hz)
    return system.C @ np.linalg.solve(z[:, None, None] * np.eye(system.states) - system.A, system.B) + system.D


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("rate_hz", [None, 100.0, 1e5])
@pytest.mark.parametrize(("outputs", "inputs"), [(2, 1), (4, 3), (3, 5)])
def test_directions_off_an_integrator_are_those_of_the_plant_at_any_rate(outputs, inputs, rate_hz, unit):
    plant = drifting(outputs, inputs, rate_hz)
    plant = StateSpace(plant.A, plant.B * unit, plant.C, plant.D, rate_hz)
    f = np.array([0.5, 4.0, 5.0, 5.1, 40.0])
    G, basis = solved(plant, f), reached_directions(plant)(f)
    left = G - basis @ (basis.conj().swapaxes(1, 2) @ G)
    assert np.all(np.linalg.norm(left, axis=(1, 2)) < 1e-7 * np.linalg.norm(G, axis=(1, 2)))


@pytest.mark.parametrize("rate_hz", [500.0, 5000.0])
def test_the_worst_direction_of_a_plant_with_an_integrator_is_that_of_its_own_response(rate_hz):
    """A loop 40 dB quieter was told as 1 dB: the plant's poles had all been moved by a share of a sample."""
    plant = drifting(2, 1, rate_hz)
    law = Lqg(band_hz=(4.0, 6.0)).design(plant).controller
    assert law is not None
    f = np.geomspace(4.0, 6.0, 1001)
    G, K = solved(plant, f), solved(law, f)
    left = np.linalg.norm(np.linalg.solve(np.eye(2) - G @ K, G), axis=(1, 2)) / np.linalg.norm(G, axis=(1, 2))
    told, _ = band_attenuation(plant, law, (4.0, 6.0))
    assert told == pytest.approx(-20 * np.log10(left.max()), abs=1e-3)
