"""Tones that a study gives no amplitude are heard within the sensors' ranges before a law is closed."""

import numpy as np
import pytest

from ultraquiet.pipeline.preflight import loop_plan
from ultraquiet.pipeline.study import ClosedLoop
from ultraquiet.values import Channel, StateSpace


class Bench:
    def __init__(self, reach):
        self.actuators = (Channel("coil", "N", -50.0, 50.0), Channel("valve", "N", -80.0, 80.0))
        self.sensors = (Channel("gap", "µm", -reach, reach), Channel("free gap", "µm"))


PLANT = StateSpace([[0.5]], [[30.0, 10.0]], [[1.0], [100.0]], np.zeros((2, 2)), 1000.0)


@pytest.mark.parametrize(("reach", "expected"), [(1e4, 5.0), (20.0, 0.4 * 20.0 / 80.0), (np.inf, 5.0)])
def test_an_amplitude_that_nobody_gives_heeds_the_sensors(reach, expected):
    plan = loop_plan(ClosedLoop(tones_hz=[1e-6], band_hz=(1.0, 100.0)), Bench(reach), PLANT)
    assert plan.amplitude == pytest.approx(expected)


def test_an_amplitude_that_is_given_is_sent():
    plan = loop_plan(ClosedLoop(tones_hz=[1.0], band_hz=(1.0, 100.0), amplitude=7.0), Bench(20.0), PLANT)
    assert plan.amplitude == 7.0
