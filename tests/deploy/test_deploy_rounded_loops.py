"""Loops with rounded laws: what is lost is what the law loses, not what the analysis rounds."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.deploy import reanalysis
from ultraquiet.values import StateSpace


def test_a_tone_that_no_actuator_reaches_hides_no_loss_at_another():
    plant = StateSpace([[0.5]], [[-0.5]], [[1.0]], [[1.0]], 100.0)  # silent at 0 Hz, to the last digit
    law = StateSpace([[0.5]], [[1.0]], [[-1.0]], [[0.0]], 100.0)
    found = reanalysis(law, 0.2 * law, plant, (0.0, 10.0))
    S = [1 / (1 - (plant @ each).frequency_response([10.0])[0, 0, 0]) for each in (law, 0.2 * law)]
    assert found.status.word == "degraded"
    assert found.loss_db == pytest.approx([0.0, 20 * np.log10(abs(S[1]) / abs(S[0]))])
    dead = StateSpace([[0.9]], [[0.0]], [[1.0]], [[0.0]], 100.0)
    assert "at most 0.00 dB" in reanalysis(law, law, dead).status.sentence


def integrating_loop(rng, unit):
    """Return a plant and the gain of an integrator around it whose loop is stable: a plant silent at 0 Hz has none."""
    while True:
        A = 0.6 * np.eye(3) + 0.05 * rng.standard_normal((3, 3))
        B, C = rng.standard_normal((3, 2)), unit * rng.standard_normal((2, 3))
        K = -0.02 * np.linalg.inv(C @ np.linalg.solve(np.eye(3) - A, B))
        closed = np.block([[A + B @ K @ C, B @ K], [C, np.eye(2)]])
        if np.abs(np.linalg.eigvals(closed)).max() < 0.995:
            return StateSpace(A, B, C, np.zeros((2, 2)), 100.0), K


@pytest.mark.parametrize("unit", [1.0, 1e-9])
def test_an_integrators_rest_at_0_hz_is_nothing_that_rounding_loses(unit, rng):
    for _ in range(10):
        plant, K = integrating_loop(rng, unit)
        laws = [StateSpace(np.eye(2), np.eye(2), each, each, 100.0) for each in (K, np.float64(np.float32(K)))]
        assert reanalysis(*laws, plant, (0.0, 1.0)).status.ok


def test_a_loop_in_continuous_time_has_no_rounded_law():
    plant, law = StateSpace([[-5.0]], [[5.0]], [[1.0]], [[0.0]]), StateSpace([[-50.0]], [[1.0]], [[-10.0]], [[0.0]])
    with pytest.raises(InputError, match="in continuous time, code has a rate; discretise them first"):
        reanalysis(law, law, plant)
