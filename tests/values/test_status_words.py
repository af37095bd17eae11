"""The words of a status: an enumeration that equals its texts, listed in the docs, complete, no member idle."""

import ast
import copy
import functools
import json
import pickle
import re
from pathlib import Path

import pytest

from ultraquiet import files
from ultraquiet._base.errors import InputError
from ultraquiet.values import Status, StatusWord

ROOT = Path(__file__).parents[2]
SRC = ROOT / "src" / "ultraquiet"
OLD = ROOT / "tests" / "data" / "status_words_0_1.h5"


@functools.cache
def trees():
    texts = (path.read_text() for path in SRC.rglob("*.py") if path.name != "status.py")
    return [ast.parse(text) for text in texts if "Status" in text]


@pytest.mark.parametrize("word", StatusWord, ids=str)
def test_a_word_is_its_text(word, tmp_path):
    status = Status(word, "Because.")
    assert status.word == word.value == str(word) == f"{word}"
    assert repr(word) == repr(word.value)
    assert json.dumps({"status": word}) == json.dumps({"status": word.value})
    assert status.ok is bool(status) is (word == "ok")
    for back in (copy.deepcopy(status), pickle.loads(pickle.dumps(status)), Status(word.value, "Because.")):
        assert back == status
        assert back.word is word
    loaded = files.load(files.save(status, tmp_path / "status.h5"))
    assert loaded == status
    assert loaded.word is word


def test_another_word_is_refused_with_all_that_are_known():
    with pytest.raises(InputError, match=r"'ok', 'refused'.*got 'fine'"):
        Status("fine", "")


def test_archives_written_with_bare_strings_load():
    old = files.load_many(OLD)
    assert len(old) == 25
    for name, status in old.items():
        assert status.word is StatusWord(name)
        assert status.sentence == f"This is {name}."


def test_docs_list_every_word_with_its_meaning():
    rows = re.findall(r"^\| `(.+?)` \| (.+) \|$", (ROOT / "docs" / "status-words.md").read_text(), re.MULTILINE)
    assert rows == [(word.value, word.meaning) for word in StatusWord]


def test_every_word_is_given_somewhere():
    used = {
        node.attr
        for tree in trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "StatusWord"
    }
    assert used == set(StatusWord.__members__)


def test_no_status_is_built_from_a_bare_string():
    bare = [
        ast.unparse(node)
        for tree in trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Status"
        for word in ast.walk(node.args[0])
        if isinstance(word, ast.Constant) and word.value in set(StatusWord)
    ]
    assert bare == []
