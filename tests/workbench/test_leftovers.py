"""What a killed workbench left half written is gone when the next begins, and no two serve one study."""

import re

import pytest

from ultraquiet._base.errors import StorageError
from ultraquiet.workbench.engine.leftovers import HIDDEN, alone

LEFT = (
    ".study.toml.0123456789ab.part",
    ".study.py.0123456789ab.part",
    "data/.run.h5.0123456789ab.part",
    "data/.run.sha256.0123456789ab.part",
    "imports/.run.csv.part",
    "imports/.run.csv.0123456789ab.part",
    "workbench/.dropped.part",
    "workbench/.log.json.0123456789ab.part",
    "workbench/.made.json.0123456789ab.part",
    "workbench/items/.models-0123.part/value.h5",
    "workbench/views/.0123.part.npz",
)
OWN = (
    ".hidden",
    ".notes.part",
    "study.toml",
    "data/.notes.part",
    "imports/run.part",
    "workbench/log.json",
    "a/.b.part",
)


def test_what_was_left_half_written_is_removed_and_nothing_else(tmp_path):
    for name in (*LEFT, *OWN):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    with alone(tmp_path):
        found = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert found - {"workbench/study.lock"} == set(OWN)
    assert not (tmp_path / "workbench/items/.models-0123.part").exists()
    assert {room for room in HIDDEN if any(name.startswith(f"{room}/.".removeprefix("./")) for name in LEFT)} == set(
        HIDDEN
    )


def test_a_second_workbench_on_a_study_is_told_who_serves_it(tmp_path):
    words = re.escape(f"a workbench is open on '{tmp_path}' already")
    with alone(tmp_path), pytest.raises(StorageError, match=words), alone(tmp_path):
        pass
    with alone(tmp_path):  # and when it has ended the study is free
        pass
