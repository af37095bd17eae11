"""What was written or named before the rooms were furnished again still loads and answers: archives, studies, names."""

import hashlib
import importlib
import inspect
import json
from pathlib import Path

import numpy as np
import pytest

from ultraquiet import bench, experiments, files
from ultraquiet._base import registry
from ultraquiet._base.registry import older_names
from ultraquiet.files.packing import pack
from ultraquiet.pipeline import load_study

BEFORE = Path(__file__).parents[1] / "data" / "before_0_2"
CONTENTS = json.loads((BEFORE / "contents.json").read_text())
PUBLIC = json.loads((BEFORE / "public_names.json").read_text())


def digests(tree):
    """The texts of a tree as they are, its arrays by the hash of their bytes."""
    return {
        key: digests(leaf)
        if isinstance(leaf, dict)
        else leaf
        if isinstance(leaf, str)
        else hashlib.sha256(np.ascontiguousarray(leaf).tobytes()).hexdigest()
        for key, leaf in tree.items()
    }


@pytest.mark.parametrize("name", CONTENTS)
def test_archives_return_every_bit(name):
    assert digests(pack(files.load(BEFORE / f"{name}.h5"))[1]) == CONTENTS[name]


def test_study_files_load():
    study = load_study(BEFORE / "study.toml")
    assert len(study.controllers) == 5


def test_experiment_lists_load():
    assert len(experiments.load(BEFORE / "list.toml", bench.Hexapod(seed=1)).steps) > 5


@pytest.mark.parametrize("family", PUBLIC["methods"])
def test_registered_names_and_their_settings_answer(family):
    known = registry.methods(family)
    for name, settings in PUBLIC["methods"][family].items():
        assert name in known
        accepted = {*inspect.signature(known[name]).parameters, *older_names(known[name])}
        assert [s for s in settings if s not in accepted] == [], name


@pytest.mark.parametrize("room", PUBLIC["names"])
def test_public_names_answer(room):
    module = importlib.import_module(f"ultraquiet.{room}")
    assert [name for name in PUBLIC["names"][room] if not hasattr(module, name)] == []


def test_a_frame_of_a_log_answers_to_its_older_name():
    older = importlib.import_module("ultraquiet.files.frames")
    assert older.Frame is older.LogFrame
    with pytest.raises(AttributeError, match="no attribute 'Frames'"):
        older.Frames  # noqa: B018
