"""Hardware behind two callbacks, and what it left played back, each the bench of a study file."""

import json

import numpy as np
import pytest

import ultraquiet as uq
from report_words import foreign_words, visible
from ultraquiet.pipeline import load_study
from ultraquiet.pipeline.preflight import check
from ultraquiet.pipeline.study import StudyError

RIG = '''
"""A rig of two callbacks, its card a simulation, and the same rig played back."""

from pathlib import Path

import numpy as np
import ultraquiet as uq

W = 2 * np.pi * np.array([12.0, 37.0])
SHAPES = np.array([[0.6, 0.8], [0.8, -0.6]])


class Card:
    """Two masses behind converters: what was put out last acts until the next frame."""

    def __init__(self, rate_hz):
        angles = W / rate_hz
        self.blocks = [np.exp(-0.03 * a) * np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in angles]
        self.state, self.noise = np.zeros((2, 2)), np.random.default_rng(5)

    def put(self, newtons):
        drive = SHAPES.T @ newtons
        self.state = np.array([self.blocks[k] @ self.state[k] + np.array([0.01 * drive[k], 0.0]) for k in range(2)])

    def get(self):
        return SHAPES @ self.state[:, 0] + 1e-5 * self.noise.standard_normal(2)


def make(rate_hz=500.0):
    card = Card(rate_hz)
    forces = [uq.Channel(f"{side} force", "N", -30.0, 30.0) for side in ("left", "right")]
    speeds = [uq.Channel(f"{side} mass", "m/s") for side in ("left", "right")]
    return uq.bench.Hardware(card.put, card.get, rate_hz, forces, speeds, wait=lambda: 0)


def played(folder):
    return uq.bench.Replay(tuple(uq.files.load(p) for p in sorted(Path(folder).rglob("*.h5"))))
'''
LIST = """
title = "rig"
[[commands]]
do = "configure"
samples = 3000
[[commands]]
do = "excite"
name = "rough"
actuator = "each"
signal = { method = "noise", stop_hz = 150.0, peak_v = 20.0 }
[[commands]]
do = "excite"
name = "sines"
actuator = "each"
signal = { method = "multisine", start_hz = 1.0, stop_hz = 200.0, period_samples = 1000, peak_v = 20.0 }
"""
STUDY = """
[study]
title = "The rig"
seed = 3
[bench]
object = "rig.py:make"
[experiment]
list = "list.toml"
[plant]
method = "rational"
records = ["sines"]
period_samples = 1000
[controllers.calm.design]
method = "lqg"
[closed_loop]
tones_hz = [17.0]
"""
PLAYED = STUDY.replace("rig.py:make", "rig.py:played").replace("[bench]", '[bench]\nfolder = "FOLDER"')


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "rig.py").write_text(RIG)
    (tmp_path / "list.toml").write_text(LIST)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


def test_what_a_recording_cannot_answer_is_refused_before_anything_moves(rig):
    text = PLAYED + '[requirements]\nlaw = "calm"\npeak_db = 6.0\n'
    (rig / "played.toml").write_text(text)
    bench = uq.bench.Replay((uq.Record(np.zeros((2, 10)), np.zeros((2, 10)), 500.0),))
    with pytest.raises(StudyError) as refused:
        check(load_study(rig / "played.toml"), bench, ["rough-1", "sines-1"])
    print(refused.value)
    for name in ("closed_loop", "requirements.peak_db"):
        assert f"{name}: the bench plays back its records and cannot react" in str(refused.value)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_two_callbacks_and_what_they_left_walk_the_whole_study(rig, run):
    code, _, said = run("run", "study.toml", "--out", "out")
    print(said[-1500:])
    assert code == 0
    made = json.loads((rig / "out" / "summary.json").read_text())
    assert made["closed_loop"]["calm"]["bench"]["stable"]
    assert set(made["closed_loop"]["calm"]["bench"]["tones"]) == {"17"}
    text = PLAYED.replace("FOLDER", str(rig / "out" / "records"))
    (rig / "played.toml").write_text(text[: text.index("[closed_loop]")])
    code, _, said = run("run", "played.toml", "--out", "again")
    print(said[-1500:])
    assert code == 0
    assert "plays back its records: no loop is closed" in said
    again = json.loads((rig / "again" / "summary.json").read_text())
    assert again["closed_loop"] == {}
    assert again["identification"]["preferred"] == made["identification"]["preferred"]
    assert again["design"] == made["design"]
    assert again["deployment"]["calm"]["bit_exact"] is True
    for folder in ("out", "again"):
        page = (rig / folder / "report.html").read_text()
        assert not foreign_words(page)
        assert all(name in visible(page) for name in ("left force", "right mass", "(m/s)/N"))
