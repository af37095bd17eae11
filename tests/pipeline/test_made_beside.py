"""What the process beside a study leaves is what the walk would have made, and what it cannot make it leaves alone."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.beside import SENTENCE, numbered
from ultraquiet.pipeline import load_study
from ultraquiet.pipeline.facts.typed import to_plain
from ultraquiet.pipeline.limits import stage as limits
from ultraquiet.pipeline.making.designs import by_need, chains, design_key, design_stage
from ultraquiet.pipeline.making.processes import designing_beside
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.store import entry
from ultraquiet.pipeline.study import parse

PLAN = LoopPlan(("bench",), (12.0,), 1.0, 2.0, (8.0, 40.0))
STUDY = """
[study]
title = "two springs"
[records]
files = ["any.csv"]
rate_hz = 500.0
[plant]
method = "subspace"
records = ["any"]
[controllers.calm.design]
method = "lqg"
[controllers.none.design]
method = "lqg"
band_hz = [300.0, 400.0]
[controllers.asked.design]
method = "lqg"
band_hz = [8.0, 40.0]
[requirements]
law = "asked"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Of a study whose plant is there and whose controllers are not; one of them cannot be designed."""
    tmp_path = tmp_path_factory.mktemp("beside")
    w, z = 2 * np.pi * np.array([9.0, 31.0]) / 500.0, 0.02
    A = np.zeros((4, 4))
    for k, angle in enumerate(w):
        turn = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.exp(-z * angle) * np.array(turn)
    shapes = np.array([[0.6, 0.8], [0.8, -0.6]])
    B, C = np.zeros((4, 2)), np.zeros((2, 4))
    B[1::2], C[:, ::2] = 0.01 * shapes.T, shapes
    (tmp_path / "study.toml").write_text(STUDY)
    study = load_study(tmp_path / "study.toml")
    place = tmp_path / "study"
    (place / "models").mkdir(parents=True)
    (place / "study.json").write_text(study.model_dump_json())
    uq.files.save(uq.StateSpace(A, B, C, np.zeros((2, 2)), 500.0), place / "models" / "plant.h5")
    return place


def made(folder, jobs=4):
    """Let the process beside make everything, three laws and the limits; return what it said."""
    with numbered(jobs) as numbers:
        words = ["design", str(folder), str(numbers), json.dumps(to_plain(PLAN))]
        command = [sys.executable, "-m", "ultraquiet.pipeline.making.worker", *words]
        pipe = subprocess.PIPE
        # it ends with its input, which is this process's to close
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, pass_fds=[numbers]) as process:
            os.write(process.stdin.fileno(), b"\n")  # all laws are there by the time it asks
            return process.stdout.read().split("\n")


@pytest.fixture(scope="module")
def said(folder):
    """What the process said."""
    return made(folder)


@pytest.mark.slow  # a process or two, and limits of three seconds each
def test_every_stage_is_the_one_the_walk_looks_for(folder, said):
    study = uq.pipeline.study.reload_study(folder)
    assert [word for word in said if word in study.controllers] == by_need(study) == ["calm", "asked", "none"]
    plant, cache = uq.files.load(folder / "models" / "plant.h5"), Cache(folder)
    assert not (folder / "stages" / "design-none.json").exists()  # who asks for it is told why
    laws = {}
    for name in ("asked", "calm"):
        settings = study.controllers[name]
        assert cache.holds(f"design-{name}", design_key(plant, settings, PLAN, {}))
        laws |= design_stage(cache, name, settings, plant, PLAN, {}).values
    here = design_stage(Cache(folder.parent / "here"), "calm", study.controllers["calm"], plant, PLAN, {})
    assert laws["calm"].hash == here.values["calm"].hash
    before = (folder / "stages" / "limits.json").read_bytes()
    limits(cache, study.limits, plant, laws, PLAN.band_hz)
    assert (folder / "stages" / "limits.json").read_bytes() == before  # found, not computed again


@pytest.mark.slow  # a process or two, and limits of three seconds each
def test_what_was_changed_by_hand_is_told_to_who_began_the_process(folder, said):
    assert not any(word.startswith(SENTENCE) for word in said)
    law = folder / "controllers" / "calm.h5"
    before = uq.files.load(law).hash
    uq.files.save(uq.StateSpace([[0.0]], np.zeros((1, 2)), np.zeros((2, 1)), np.eye(2), 500.0), law)
    told = [word.removeprefix(SENTENCE) for word in made(folder) if word.startswith(SENTENCE)]
    assert any("controllers/calm.h5" in sentence and "edited" in sentence for sentence in told), told
    assert uq.files.load(law).hash == before


@pytest.mark.slow  # a process or two, and limits of three seconds each
def test_processes_share_the_laws_and_one_of_them_finds_the_limits(folder, said, tmp_path):
    place = tmp_path / "shared"
    (place / "models").mkdir(parents=True)
    for name in ("study.json", "models/plant.h5"):
        shutil.copy(folder / name, place / name)
    study = uq.pipeline.study.reload_study(folder)
    with designing_beside(Cache(place), True, 4, json.dumps(to_plain(PLAN))) as designs:
        for name in study.controllers:
            designs.wait(name)
        designs.begin()
        designs.wait()
    for name in ("controllers/asked.h5", "controllers/calm.h5"):
        assert uq.files.load(place / name).hash == uq.files.load(folder / name).hash
    shared, alone = (json.dumps(entry.read(each, "limits").facts) for each in (place, folder))
    assert shared == alone


def test_laws_sought_with_a_given_peak_begin_early_and_chains_stay_together():
    table = '\n[controllers.{}.design]\nmethod = "band-attenuation"\npeak_db = 6.0\n'
    round_calm = (
        '\n[controllers.hum]\naround = "calm"\n[controllers.hum.design]\nmethod = "resonators"\ntones_hz = [30.0]\n'
    )
    study = parse(STUDY + table.format("late") + round_calm)
    assert by_need(study) == ["calm", "asked", "late", "none", "hum"]
    assert chains(study) == [["calm", "hum"], ["asked"], ["late"], ["none"]]
