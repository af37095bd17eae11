"""S and K S at single lines, also where the plant's or the law's own response has no bound."""

import numpy as np
import pytest

from ultraquiet.analyse.loop_response import both_sensitivities, loop_response
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
    assert np.array_equal(at_output, S)
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
