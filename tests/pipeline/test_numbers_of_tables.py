"""Numbers of a study's tables: what is none, or nothing of a bench, is refused with table, key and line."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pydantic import BaseModel
from small_study import LIST, STUDY, known

import ultraquiet as uq
from ultraquiet._base.errors import UltraquietError
from ultraquiet.pipeline import preflight, walk
from ultraquiet.pipeline.study import Study, StudyError, load_study, parse
from ultraquiet.pipeline.tables import matrices
from ultraquiet.pipeline.walk import prepared

# What every table needs besides the key that is tried.
NEEDED = {
    "study": ['title = "t"'],
    "bench": ['method = "hexapod"'],
    "plant": ['method = "subspace"', 'records = ["all"]'],
    "payload": ['shaker = "a"', 'sensors = ["b"]', "band_hz = [5.0, 100.0]"],
    "paper": ['records = ["all"]'],
    "requirements": ['law = "calm"'],
    "controllers.calm.design": ['method = "lqg"', "band_hz = [5.0, 10.0]"],
}
BAD = {
    "nan": "nan",
    "inf": "inf",
    "minus inf": "-inf",
    "negative": "-1",
    "zero": "0",
    "text": '"4"',
    "word": '"fast"',
    "list": "[[1.0]]",
    "bool": "true",
    "huge": "1e300",
    "huge and whole": "1" + "0" * 30,
    "date": "1979-05-27",
    "table": "{ a = 1 }",
}
# Zero is a seed, filters may average nothing, no bench need be measured, and less than nothing may be required.
LEGITIMATE = {
    ("seed", "zero"),
    ("first_seed", "zero"),
    ("averages", "zero"),
    ("measured", "zero"),
    ("uncertainty", "zero"),
    ("tune", "bool"),
    ("counts_plant", "bool"),
}
LEGITIMATE |= {(f"{key}_db", kind) for key in ("attenuation", "payload", "tones") for kind in ("zero", "negative")}
REQUIRED = {("requirements", "peak_db", kind) for kind in ("zero", "negative")}
NOT_TRIED = {("records", "rate_hz")}  # a study has a bench or files; tried below
MATRICES = {"sensors", "actuators"}  # rows of numbers or the name of a file; tried below


def holds_numbers(kind):
    return kind in (int, float, bool) or any(holds_numbers(part) for part in get_args(kind))


def is_a_list(kind):
    return getattr(kind, "__origin__", None) in (list, tuple) or any(is_a_list(part) for part in get_args(kind))


def keys():
    for name, field in Study.model_fields.items():
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                for key, each in kind.model_fields.items():
                    if holds_numbers(each.annotation) and key not in MATRICES and (name, key) not in NOT_TRIED:
                        yield field.alias or name, key, is_a_list(each.annotation)


KEYS = list(keys())
CASES = [
    (table, key, several, kind)
    for table, key, several in KEYS
    for kind in BAD
    if (key, kind) not in LEGITIMATE and (table, key, kind) not in REQUIRED
]


def written(table, key, value):
    """A study in which one key has a value, and the line on which it stands."""
    tables = {name: list(lines) for name, lines in NEEDED.items()}
    lines = [line for line in tables.get(table, []) if not line.startswith(f"{key} =")]
    tables[table] = [*lines, f"{key} = {value}"]
    text = "".join(f"[{name}]\n" + "".join(f"{line}\n" for line in lines) for name, lines in tables.items())
    return text, text.split("\n").index(f"{key} = {value}") + 1


def test_the_tables_are_looked_through():
    found = {(table, key) for table, key, _ in KEYS}
    print(sorted(found))
    for each in ("payload", "seconds"), ("campaign", "benches"), ("commission", "gains"), ("paper", "channel"):
        assert each in found


@pytest.mark.parametrize(("table", "key", "several", "kind"), CASES, ids=[f"{c[0]}.{c[1]}-{c[3]}" for c in CASES])
def test_what_is_no_number_is_refused_on_its_line(table, key, several, kind):
    value = BAD[kind]
    values = [value]
    if several and kind != "list":
        values += [f"[{value}]", f"[{value}, 20.0]", f"[5.0, {value}]"]
    for each in values:
        text, line = written(table, key, each)
        with pytest.raises(StudyError) as refused:
            parse(text)
        mistakes = dict(refused.value.mistakes)
        print(line, mistakes)
        assert list(mistakes) == [line]
        assert mistakes[line].startswith(f"{table}: '{key}")


def test_numbers_as_they_should_be_pass():
    good = {
        "payload": ("seconds", "8"),
        "campaign": ("first_seed", "0"),
        "commission": ("gains", "[0.2, 1]"),
        "paper": ("channel", "2"),
        "requirements": ("peak_db", "6"),
        "deploy": ("limits", "[1.0, 2]"),
        "closed_loop": ("tones_hz", "[]"),
    }
    for table, (key, value) in good.items():
        study = parse(written(table, key, value)[0])
        assert getattr(getattr(study, table), key) is not None


@pytest.mark.parametrize("rows", ["[]", "[[]]", '[["1"]]', "[[nan]]", "[[true]]", "[[1.0], [1.0, 2.0]]", "4", "true"])
def test_a_blending_that_is_no_matrix_is_refused_before_anything_runs(rows, small):
    (small / "study.toml").write_text(f"{STUDY}[blending]\nsensors = {rows}\n")
    with pytest.raises(UltraquietError, match="sensors") as refused:
        walk(load_study(small / "study.toml"), small / "out", small, say=lambda _: None)
    print(refused.value)
    assert not (small / "out").exists()


@pytest.fixture
def small(tmp_path):
    (tmp_path / "list.toml").write_text(LIST)
    with known():
        yield tmp_path


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("[deploy]\nlimits = [1.0, 2.0, 3.0]", "deploy.limits: there are 2 actuators and 3 limits"),
        ("[deploy]\nlimits = [9e3, 20.0]", "deploy.limits: 20 is below the range of 'shaker 2', -5000 to 5000 N"),
        ('[paper]\nrecords = ["noise"]\nband_hz = [10.0, 100.0]\nchannel = 3', "paper.channel: there is no channel 3"),
        ("[commission]\nseconds = 80000.0", "commission.seconds: 80000 s are more than memory holds"),
        (
            '[payload]\nshaker = "shaker 1"\nsensors = ["mass 1"]\nband_hz = [5.0, 100.0]\nlevel = 9e3',
            "payload.level: 9000 is beyond the range of 'shaker 1'",
        ),
        (
            '[payload]\nshaker = "mass 1"\nsensors = ["mass 1"]\nband_hz = [5.0, 100.0]',
            "payload: there is no actuator 'mass 1'",
        ),
    ],
)
def test_numbers_that_the_bench_does_not_have_are_refused_before_anything_runs(table, words, small):
    (small / "study.toml").write_text(f"{STUDY}{table}\n")
    with pytest.raises(StudyError) as refused:
        walk(load_study(small / "study.toml"), small / "out", small, say=lambda _: None)
    print(refused.value)
    ((line, sentence),) = refused.value.mistakes
    assert sentence.startswith(words)
    assert f"{STUDY}{table}".split("\n")[line - 1].split(" =")[0].strip("[]") in sentence
    assert not (small / "out").exists()


@pytest.mark.parametrize(("limits", "below"), [("3.0", True), ("[7.0, 1.0]", False), ("[4.0, 1.0]", True)])
def test_a_limit_of_code_is_for_an_actuator_that_states_none(limits, below):
    wires = [uq.Channel("coil", "A", -2.0, 5.0), uq.Channel("valve", "bar")]
    record = uq.Record(np.zeros((2, 50)), np.zeros((3, 50)), 1000.0, wires)
    study = parse(written("deploy", "limits", limits)[0])
    if not below:
        preflight.check(study, None, ["all"], seen=record)
        return
    with pytest.raises(StudyError, match=r"is below the range of 'coil', -2 to 5 A, which its code keeps to"):
        preflight.check(study, None, ["all"], seen=record)


def test_units_of_a_plant_are_those_of_a_bench():
    record = uq.Record(np.ones((1, 50)), np.ones((1, 50)), 1000.0)
    played = written("plant", "units", '["flight"]')[0]
    filed = f'{STUDY[: STUDY.index("[bench]")]}[records]\nfiles = ["all.csv"]\n{STUDY[STUDY.index("[plant]") :]}'
    filed = filed.replace("[plant]", '[plant]\nunits = ["flight"]')
    for text, bench in ((filed, None), (played, uq.bench.Replay((record,)))):
        study = parse(text)
        with pytest.raises(StudyError, match=r"plant.units: no bench of this study could be another unit"):
            preflight.check(study, bench, ["all"], seen=record)


def test_limits_of_a_study_of_files_are_one_an_actuator(small):
    rng = np.random.default_rng(0)
    record = uq.Record(rng.standard_normal((3, 50)), rng.standard_normal((2, 50)), rate_hz=100.0)
    study = parse(written("deploy", "limits", "[1.0, 2.0]")[0])
    with pytest.raises(StudyError, match="3 actuators and 2 limits"):
        preflight.check(study, None, ["all"], seen=record)


def test_a_study_of_files_reads_its_matrices_once(small, monkeypatch):
    u = np.random.default_rng(0).standard_normal((2, 300))
    uq.files.save(uq.Record(u, [[1.0, 0.2], [0.1, 1.0]] @ np.roll(u, 1, axis=1), 500.0), small / "all.h5")
    for name in ("Ts", "Ta"):
        np.savetxt(small / f"{name}.csv", [[1.0, 1.0], [1.0, -1.0]], delimiter=",")
    blending = '[blending]\nsensors = "Ts.csv"\nactuators = "Ta.csv"\nnames = ["sum", "difference"]\n'
    files = '[records]\nfiles = ["all.h5"]\n'
    text = STUDY[: STUDY.index("[bench]")] + files + STUDY[STUDY.index("[plant]") :] + blending
    (small / "study.toml").write_text(text)
    read: list[Path] = []
    real = matrices._read
    monkeypatch.setattr(matrices, "_read", lambda who, name, path: read.append(path) or real(who, name, path))
    with prepared(load_study(small / "study.toml"), small / "out", small, lambda _: None) as stages:
        assert [c.name for c in stages.records["all"].sensors] == ["sum", "difference"]
    print(read)
    assert sorted(path.name for path in read) == ["Ta.csv", "Ts.csv"]
