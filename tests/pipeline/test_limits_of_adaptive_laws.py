"""A law that adapts is watched at its limit: a study gives it what is known, and never one of another bench."""

import json

import numpy as np
import pytest

from ultraquiet.pipeline.control import with_limits
from ultraquiet.pipeline.study import parse
from ultraquiet.values import Channel, Record

STUDY = """
[study]
title = "a coil and a valve"
[records]
files = ["run.csv"]
[plant]
method = "subspace"
records = ["run"]
[controllers.hum.design]
method = "adaptive-feedforward"
tones_hz = [25.0]
{setting}
[controllers.still.design]
method = "lqg"
"""
WIRES = (Channel("coil", "N", -2.0, 3.0), Channel("valve", "mA"))
RECORD = Record([[1.5, -1.0], [0.25, -0.5]], [[0.0, 0.0]], 1000.0, WIRES)


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("", [2.0, 0.5]),  # the actuator's own, and the largest command of the records
        ("[deploy]\nlimits = [5.0, 7.0]", [2.0, 7.0]),
        ("limit = 4.0", 4.0),
        ("limit_v = 4.0", 4.0),
    ],
)
def test_a_study_gives_a_law_that_adapts_the_limits_that_its_code_is_held_to(setting, expected):
    table = "deploy" in setting
    text = STUDY.format(setting="" if table else setting) + (setting if table else "")
    settings = parse(text)
    complete = with_limits(settings, WIRES, [RECORD])
    made = complete.controllers["hum"].design.make("design")
    assert np.array_equal(made.limit, expected)
    assert complete.controllers["still"] == settings.controllers["still"]
    # as the folder of a study holds it
    again = type(complete).model_validate_json(complete.model_dump_json())
    assert np.array_equal(again.controllers["hum"].design.make("design").limit, expected)
    assert json.loads(complete.model_dump_json())["controllers"]["still"]["design"] == {"method": "lqg"}


def test_a_study_whose_actuators_state_their_limits_is_left_as_it_is():
    settings = parse(STUDY.format(setting=""))
    assert with_limits(settings, WIRES[:1], [RECORD]) is settings
