"""Hardware behind two callbacks, and what it left played back, each the bench of a study file."""

import json

import numpy as np
import pytest
from rig_study import LIST, RIG, STUDY

import ultraquiet as uq
from report_words import foreign_words, small_openings, visible
from ultraquiet.pipeline import load_study
from ultraquiet.pipeline.preflight import check
from ultraquiet.pipeline.study import StudyError

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
        assert not small_openings(page)
        assert all(name in visible(page) for name in ("left force", "right mass", "(m/s)/N"))
