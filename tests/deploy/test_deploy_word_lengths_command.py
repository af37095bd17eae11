"""`ultraquiet deploy` on word lengths: the table, whole-number code, options that do not go together."""

import numpy as np
import pytest
from deploy_laws import RATE_HZ, block
from typer.testing import CliRunner

from ultraquiet import files
from ultraquiet._base.errors import InputError
from ultraquiet.cli.app import app
from ultraquiet.values import StateSpace


@pytest.fixture
def saved(tmp_path):
    A = block(0.9 * np.exp(0.1j))
    files.save(StateSpace(A, [[0.1], [0.1]], [[0.2, 0.1]], [[0.1]], rate_hz=RATE_HZ), tmp_path / "law.h5")
    return tmp_path / "law.h5"


def said(*words):
    told = CliRunner().invoke(app, ["deploy", *map(str, words)], terminal_width=200, env={"COLUMNS": "200"})
    if told.exception is not None and not isinstance(told.exception, SystemExit):
        raise told.exception
    return told.output


def test_table_of_word_lengths(saved):
    text = said(saved, "--word-lengths")
    print(text)
    assert all(word in text for word in ("float64", "float32", "q31", "q15", "delta l2"))
    assert not saved.with_suffix("").exists()


def test_whole_number_code(saved, cc):
    text = said(saved, "--precision", "q15", "--steps", "500", "--range", "10", "--limits", "25")
    print(text)
    assert "All words of 500 steps and of the self-test are the twin's" in text
    assert (saved.with_suffix("") / "controller.c").exists()


def test_options_that_whole_numbers_have_no_use_for(saved):
    with pytest.raises(InputError, match="code in q31 has no anti-windup"):
        said(saved, "--precision", "q31", "--anti-windup")
    assert not saved.with_suffix("").exists()
