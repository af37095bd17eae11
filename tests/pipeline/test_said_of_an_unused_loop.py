"""What a study asks of a loop that no bench closes is said, not passed over."""

import numpy as np

import ultraquiet as uq
from ultraquiet.pipeline import load_study
from ultraquiet.pipeline.preflight import unheard
from ultraquiet.pipeline.walk import prepared

STUDY = """[study]
title = "files alone"
[records]
files = ["run.h5"]
[plant]
method = "subspace"
order = 2
[controllers.quiet.design]
method = "lqg"
"""


def said_of(tmp_path, loop):
    rng = np.random.default_rng(2)
    uq.files.save(uq.Record(rng.standard_normal((1, 50)), rng.standard_normal((1, 50)), 100.0), tmp_path / "run.h5")
    (tmp_path / "study.toml").write_text(STUDY + loop)
    said = []
    with prepared(load_study(tmp_path / "study.toml"), tmp_path / "out", tmp_path, said.append):
        pass
    print(said)
    return [sentence for sentence in said if "closed_loop" in sentence]


def test_tones_that_nothing_sends_are_said(tmp_path):
    said = said_of(tmp_path, "[closed_loop]\ntones_hz = [5.0]\namplitude = 1.0\nband_hz = [1.0, 20.0]\n")
    assert said == ["closed_loop: without a bench no loop is closed and no tone is sent; unused: tones_hz, amplitude"]


def test_a_band_alone_is_used_and_nothing_is_said(tmp_path):
    assert said_of(tmp_path, "[closed_loop]\nband_hz = [1.0, 20.0]\n") == []


def test_every_setting_of_the_loop_is_heard_or_told(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY + "[closed_loop]\nduration_s = 3.0\n")
    assert unheard(load_study(tmp_path / "study.toml")) == ["duration_s"]
