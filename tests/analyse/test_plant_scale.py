"""The units of a plant's own where some of its responses are zero: a dead channel, axes that do not see each other."""

import numpy as np
import pytest

from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design import BandAttenuation, LoopShaping, Lqg, MixedSensitivity
from ultraquiet.values import StateSpace

RATE_HZ = 1000.0
FURTHEST = 1e3  # between scales of channels whose gains lie within ten of each other
LOUDEST_DB = 25.0


def plant_of(*modes, damping=0.02):
    """Return a plant of modes, each a frequency in Hz, what every output hears of it and how every input moves it."""
    A, B, C = np.zeros((2 * len(modes), 2 * len(modes))), [], []
    for k, (hz, outputs, inputs) in enumerate(modes):
        pole = np.exp(2 * np.pi * hz / RATE_HZ * (-damping + 1j))
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, -pole.imag], [pole.imag, pole.real]]
        B += [np.zeros(len(inputs)), np.array(inputs)]
        C += [np.array(outputs), np.zeros(len(outputs))]
    return StateSpace(A, np.array(B), np.array(C).T, np.zeros((len(C[0]), len(B[0]))), RATE_HZ)


PLANTS = {
    "dead sensor": plant_of((20.0, [1, 2, 0], [3, 1]), (60.0, [1, -1, 0], [-2, 1])),
    "four dead sensors": plant_of((20.0, [1, 2, 0, 0, 0, 0], [3, 1]), (60.0, [1, -1, 0, 0, 0, 0], [-2, 1])),
    "three dead actuators": plant_of((20.0, [1, 2], [3, 1, 0, 0, 0]), (60.0, [1, -1], [-2, 1, 0, 0, 0])),
    "two sensors on one axis": plant_of((20.0, [1, 3, 0], [1, 0]), (60.0, [0, 0, 1], [0, 1])),
}


@pytest.mark.parametrize("name", PLANTS)
def test_scales_of_alike_channels_stay_near_each_other_where_responses_are_zero(name):
    even = even_plant(PLANTS[name])
    both = np.concatenate([even.outputs, even.inputs])
    assert both.max() < FURTHEST * both.min(), (even.outputs, even.inputs)


@pytest.mark.parametrize("design", [Lqg, MixedSensitivity, BandAttenuation, LoopShaping])
@pytest.mark.parametrize("name", PLANTS)
def test_no_default_listens_to_what_is_dead(name, design):
    """A law of scales that had drifted apart had rounding errors in the place of zeros, and amplified by 400 dB."""
    plant = PLANTS[name]
    result = design().design(plant)
    assert result.status.ok, result.status
    assert result.peak_sensitivity_db < LOUDEST_DB
    law = result.controller
    assert law is not None
    K = np.abs(law.D + law.C @ np.linalg.solve(np.exp(0.1j) * np.eye(law.states) - law.A, law.B))
    heard, moved = plant.C.any(axis=1), plant.B.any(axis=0)
    assert K[:, ~heard].max(initial=0.0) < 1e-9 * K.max()
    assert K[~moved].max(initial=0.0) < 1e-9 * K.max()
