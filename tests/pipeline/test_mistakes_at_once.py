"""What is wrong with a study's bench, its files and its tables is told in one message, each with its line."""

import numpy as np
import pytest

from ultraquiet import pipeline
from ultraquiet.experiments import ListError
from ultraquiet.pipeline import walk
from ultraquiet.pipeline.study import StudyError

RIG = """
import ultraquiet as uq

def make(rate_hz=500.0, gain=1.0, reach=float("inf")):
    push = uq.Channel("push", "N", -reach, reach)
    plant = uq.StateSpace([[0.5]], [[gain]], [[1.0]], [[0.0]], rate_hz, [push])
    return uq.bench.LinearBench(plant)
"""
BENCH = """\
[study]
title = "a rig"
[bench]
object = "rig.py:make"
gain = 2.0
[experiment]
list = "list.toml"
[plant]
method = "subspace"
records = ["rough"]
[controllers.calm.design]
method = "lqg"
[requirements]
law = "calm"
"""
LIST = """\
[[commands]]
do = "excite"
name = "rough"
actuator = 1
samples = 500
signal = { method = "noise", stop_hz = 200.0 }
"""
FILES = """\
[study]
title = "files"
[records]
files = [
  "one.csv",
  "two.csv",
]
inputs = ["u1", "u2"]
outputs = "y1, y2"
[plant]
method = "subspace"
records = ["one"]
[controllers.calm.design]
method = "lqg"
"""
NEW = "[deploy]\nprecison = 1\n"
# What is written otherwise, and the line and words of everything that has to be told of it.
ASKED = {
    "arguments": (
        BENCH,
        [("gain = 2.0", "gian = 2.0\nrate = 3")],
        {5: "no argument 'gian'; did you mean 'gain'?", 6: "no argument 'rate'; did you mean 'rate_hz'?"},
    ),
    "a negative rate": (BENCH, [("gain = 2.0", "rate_hz = -5.0")], {5: "'rate_hz' must be"}),
    "no file, no list": (
        BENCH,
        [("rig.py", "rog.py"), ("list.toml", "lost.toml")],
        {4: "there is no file", 7: "lost.toml' cannot be read"},
    ),
    "no callable": (BENCH, [(":make", ":mkae"), ("list.toml", "lost.toml")], {4: "did you mean 'make'?", 7: "lost"}),
    "a list's own": (BENCH, [("gain", "gian"), ("list.toml", "bad.toml")], {5: "no argument 'gian'"}),
    "no records": (BENCH, [('["rough"]', '["ruogh"]')], {10: "there are no records 'ruogh'; there are rough"}),
    "bench and tables": (
        BENCH + NEW,
        [("rig.py", "rog.py"), ('law = "calm"', 'law = "clam"'), ("list.toml", "lost.toml")],
        {4: "rog.py' cannot be read", 7: "lost.toml' cannot be read", 14: "no law 'clam'", 16: "'precision'?"},
    ),
    "an older name": (
        BENCH + "[closed_loop]\ntones_hz = [50.0]\namplitude_v = 30.0\n",
        [("gain = 2.0", "reach = 20.0")],
        {17: "closed_loop.amplitude: 30 is beyond the range of 'push', -20 to 20 N"},
    ),
    "a run that a tone does not fit": (
        BENCH + "[closed_loop]\ntones_hz = [50.0, 1.3]\nduration_s = 1.5\n",
        [],
        {17: "closed_loop.duration_s: 1.5 s are too short for a tone of 1.3 Hz; ask for 1.54 s or more"},
    ),
    "columns": (FILES, [('"u2"', '"ux"'), ("y2", "yx")], {8: "no column 'ux'", 9: "no column 'yx'"}),
    "several of a side": (FILES, [("y1, y2", "yp, yq")], {9: "no columns 'yp', 'yq'"}),
    "files": (
        FILES,
        [("one.csv", "one.foo"), ("two.csv", "none.csv")],
        {5: "none of the suffixes", 6: "none.csv' cannot be read"},
    ),
    "one name for two": (FILES, [("two.csv", "one.csv")], {6: "two files of [records] are called 'one'"}),
    "other channels": (FILES, [("two.csv", "slow.csv")], {6: "another rate than 'one'"}),
    "a rate": (
        FILES,
        [("inputs", "rate_hz = 700.0\ninputs"), ("two.csv", "none.csv")],
        {6: "none.csv' cannot be read", 8: "700 Hz contradicts"},
    ),
    "in and out": (FILES, [("y1, y2", "y1, u1")], {8: "'u1' of 'one.csv' goes in and comes out as well"}),
    "a mapping": (
        FILES,
        [("inputs", 'mapping = "map.toml"\ninputs'), ("two.csv", "none.csv")],
        {6: "none.csv' cannot be read", 8: "map.toml' cannot be read"},
    ),
    "records": (
        FILES,
        [("two.csv", "none.csv"), ('records = ["one"]', 'records = ["noe"]')],
        {6: "none.csv' cannot be read", 12: "no records 'noe'; there are one, none"},
    ),
    "files and tables": (
        FILES + '[requirements]\nlaw = "clam"\n' + NEW,
        [("two.csv", "none.csv")],
        {6: "none.csv' cannot be read", 16: "no law 'clam'", 18: "'precision'?"},
    ),
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.py").write_text(RIG)
    (tmp_path / "list.toml").write_text(LIST)
    (tmp_path / "bad.toml").write_text(LIST.replace("stop_hz", "spot_hz"))
    rng = np.random.default_rng(1)
    for name, rate_hz in (("one", 500.0), ("two", 500.0), ("slow", 250.0)):
        rows = np.column_stack([np.arange(300) / rate_hz, rng.standard_normal((300, 4))])
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="t,u1,u2,y1,y2", comments="")
    return tmp_path


def refused(folder, text, changes=()):
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "study.toml").write_text(text)
    with pytest.raises((StudyError, ListError)) as error:
        walk(pipeline.load_study(folder / "study.toml"), folder / "out", folder, say=lambda _: None)
    print(error.value)
    assert not (folder / "out").exists()
    return error.value


@pytest.mark.parametrize("case", ASKED)
def test_every_mistake_of_bench_and_files_is_told_at_once_with_its_line(case, folder):
    text, changes, expected = ASKED[case]
    error = refused(folder, text, changes)
    assert str(error).startswith(f"{folder / 'study.toml'}: ")
    for line, words in expected.items():
        said = [sentence for at, sentence in error.mistakes if at == line]
        for one in (words,) if isinstance(words, str) else words:
            assert any(one in sentence for sentence in said), (line, one)
    assert {at for at, _ in error.mistakes} == set(expected)


def test_where_a_list_alone_is_wrong_its_own_lines_are_told(folder):
    error = refused(folder, BENCH, [("list.toml", "bad.toml")])
    ((line, sentence),) = error.mistakes
    assert isinstance(error, ListError)
    assert (line, "no setting 'spot_hz'" in sentence) == (6, True)


def test_what_leans_on_a_refused_value_is_not_called_wrong(folder):
    """Tones that will not do are not said to be missing where the requirements ask for them."""
    text = BENCH.replace('law = "calm"', 'law = "calm"\ntones_db = 6.0') + "[closed_loop]\ntones_hz = [-5.0]\n"
    error = refused(folder, text)
    assert [line for line, _ in error.mistakes] == [17]
