"""What a study refuses before anything moves, and which records it takes for its own."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet import experiments, pipeline
from ultraquiet.pipeline.cache import Cache, Outcome
from ultraquiet.pipeline.walk import _list_of, _prepare, _recorded, walk

SUITE = (Path(pipeline.__file__).parent / "suite.toml").read_text()
LIST = """
[[commands]]
do = "excite"
name = "push"
signal = { method = "chirp" }
samples = 500
actuator = 1
"""
WRONG = {
    "unit": ('units = ["ground", "flight"]', 'units = ["moon"]', "'moon'"),
    "falling band": ("band_hz = [10.0, 100.0]", "band_hz = [100.0, 10.0]", "band_hz"),
    "tone": ("tones_hz = [5.0, 25.0, 100.0]\nband", "tones_hz = [5000.0]\nband", "5000 Hz"),
    "records": ('records = "noise"', 'records = "nosie"', "'nosie'"),
    "held out": ('held_out = "judge"', 'held_out = "jugde"', "'jugde'"),
    "paper's records": ('["chirp", "noise", "prbs"]', '["chrip"]', "'chrip'"),
    "plant's records": ('["lowest", "low", "high"]', '["loewst"]', "'loewst'"),
    "structure": ('["arx", "armax", "output-error", "box-jenkins"]', '["rational"]', "'rational'"),
    "paper's structure": ('paper_structure = "box-jenkins"', 'paper_structure = "box-jenkin"', "'box-jenkin'"),
    "a path for a name": ("controllers.lqg-ltr", 'controllers."../../x"', "../../x"),
}


@pytest.mark.parametrize("culprit", WRONG)
def test_a_mistake_stops_the_study_before_it_begins(culprit, tmp_path):
    old, new, named = WRONG[culprit]
    assert old in SUITE
    (tmp_path / "study.toml").write_text(SUITE.replace(old, new))
    with pytest.raises(uq.errors.InputError, match=r"1 mistake|2 mistakes") as told:
        walk(pipeline.load_study(tmp_path / "study.toml"), tmp_path / "out", say=lambda _: None)
    print(told.value)
    assert named in str(told.value)
    assert not (tmp_path / "out").exists()


def listed(bench):
    return experiments.parse(LIST, bench)


def taken(bench, folder):
    return _recorded(listed(bench), bench, pipeline.packaged_study("suite"), folder)["push"]


def test_a_broken_off_run_takes_up_no_record_of_another_bench(tmp_path, monkeypatch, seed):
    ground, flight = (uq.bench.Hexapod(unit=unit, seed=seed) for unit in ("ground", "flight"))
    first = taken(ground, tmp_path)
    assert taken(ground, tmp_path).hash == first.hash

    def stopped(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(experiments, "run", stopped)
        with pytest.raises(KeyboardInterrupt):
            taken(flight, tmp_path)
    again = taken(flight, tmp_path)
    assert not np.array_equal(again.outputs, first.outputs)
    assert again.hash == taken(flight, tmp_path).hash


def test_records_that_no_study_left_are_not_touched(tmp_path, seed):
    bench = uq.bench.Hexapod(seed=seed)
    experiments.run(listed(bench), tmp_path / "records", bench)
    before = (tmp_path / "records" / "push.h5").read_bytes()
    with pytest.raises(uq.errors.StorageError, match=re.escape("no study left")):
        taken(bench, tmp_path)
    with pytest.raises(uq.errors.StorageError, match=re.escape("no study left")):
        taken(bench, tmp_path)
    assert (tmp_path / "records" / "push.h5").read_bytes() == before


def test_report_finds_the_list_that_stands_beside_the_study(tmp_path):
    (tmp_path / "mine.toml").write_text(LIST)
    (tmp_path / "study.toml").write_text(SUITE.replace('list = "suite"', 'list = "mine.toml"'))
    _prepare(pipeline.load_study(tmp_path / "study.toml"), tmp_path / "out", tmp_path)
    again = pipeline.reload_study(tmp_path / "out")
    assert Path(_list_of(again, tmp_path / "out")) == tmp_path / "mine.toml"


@pytest.mark.parametrize("path", ["../outside.h5", "models/../../outside.h5", "{absolute}", "models/link.h5", "", 3])
def test_a_stage_reads_back_nothing_from_outside_its_folder(path, tmp_path):
    folder, outside = tmp_path / "out", tmp_path / "outside.h5"
    record = uq.Record([[1.0, 0.0]], [[0.1, 0.3]], rate_hz=3500.0)
    uq.files.save(uq.Record([[9.0, 9.0]], [[9.0, 9.0]], rate_hz=3500.0), outside)
    cache = Cache(folder)

    def take():
        return cache.stage("plant", "models", "key", lambda: Outcome({"plant": record}))

    assert [take().reused for _ in range(2)] == [False, True]
    (folder / "models" / "link.h5").symlink_to(outside)
    facts = folder / "stages" / "plant.json"
    held = json.loads(facts.read_text())
    held["values"]["plant"] = str(outside) if path == "{absolute}" else path
    facts.write_text(json.dumps(held))
    again = take()
    assert (again.reused, again.values["plant"].hash) == (False, record.hash)
