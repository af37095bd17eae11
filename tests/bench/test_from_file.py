"""A bench of a Python file is the one that stands there."""

import os

import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.bench.from_file import from_file

TEXT = """import numpy as np
from ultraquiet.bench import LinearBench
from ultraquiet.values import StateSpace

def make():
    return LinearBench(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1000.0))
"""


def test_a_file_that_was_changed_at_once_is_read_anew(tmp_path, monkeypatch):
    """Of the same size and within the same second, where byte code may be kept: it leaves none beside the file."""
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    monkeypatch.setattr("sys.pycache_prefix", None)
    file = tmp_path / "mine.py"
    for rate in (1000.0, 2000.0, 3000.0):
        file.write_text(TEXT.replace("1000.0", str(rate)))
        os.utime(file, (1e9, 1e9))
        assert from_file("mine.py:make", tmp_path, {}).rate_hz == rate
    assert sorted(tmp_path.iterdir()) == [file]


def test_what_is_no_python_file_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text(TEXT)
    with pytest.raises(InputError, match=r"'.*mine\.txt' is no Python file"):
        from_file("mine.txt:make", tmp_path, {})
