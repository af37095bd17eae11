"""A study by hand without a browser: steps, undo, stale marks, and what is written down of them."""

import json
import shutil
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from workbench_helpers import columns, csv_of

from ultraquiet import files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.pipeline import load_study, walk
from ultraquiet.pipeline.study import parse
from ultraquiet.workbench import Session
from ultraquiet.workbench.engine.making.imports import import_step, inside, received
from ultraquiet.workbench.jobs import looks
from ultraquiet.workbench.web.pages.report import since

IDENTIFY = {"op": "identify", "name": "arx4", "records": ["fit"], "period_samples": None}
METHOD = {"method": "arx", "order": 4}


@pytest.fixture
def session(tmp_path, seed):
    made = Session(tmp_path / "study")
    file = received(made.folder, "run.csv", csv_of(tmp_path / "run.csv", seed))
    made.do(import_step(made.folder, "run", file, columns(1, 1)))
    made.do({"op": "cut", "name": "fit", "of": "run", "start": 0, "stop": 1000})
    return made


def test_steps_can_be_undone_and_outlive_the_program(session):
    session.do({**IDENTIFY, "method": METHOD})
    item = session.make("models", "arx4")
    assert item.ready
    session.undo()
    assert not session.state["models"]
    session.redo()
    assert session.item("models", "arx4").ready, "what was made is found again"
    again = Session(session.folder)
    assert again.state == session.state
    assert [dict(step) for step in again.steps] == [dict(step) for step in session.steps]


def test_a_changed_input_makes_stale_and_says_what_changed(session):
    session.do({**IDENTIFY, "method": METHOD})
    session.make("models", "arx4")
    assert session.stale("models", "arx4") is None
    session.do({"op": "cut", "name": "fit", "of": "run", "start": 0, "stop": 800})
    old, words = session.stale("models", "arx4")
    assert "data/fit: stop was 1000, is 800" in words
    assert old.ready
    session.undo()
    assert session.stale("models", "arx4") is None


def test_a_summary_is_said_to_be_older_than_what_came_after_it(session):
    session.do({**IDENTIFY, "method": METHOD})
    session.make("models", "arx4")
    written = time.time() + 1
    assert since(session, written) == ""
    session.do({"op": "cut", "name": "fit", "of": "run", "start": 0, "stop": 800})
    assert since(session, written) == "fit is stale, arx4 is stale"
    session.make("models", "arx4")
    assert since(session, 0.0) == "run was made since, fit was made since, arx4 was made since"


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ({"op": "cut", "name": "a/b", "of": "run", "start": 0, "stop": 9}, "cannot name an item"),
        ({"op": "cut", "name": "x", "of": "gone", "start": 0, "stop": 9}, "holds no 'gone'"),
        ({"op": "cut", "name": "fit", "of": "fit", "start": 0, "stop": 9}, "made of itself"),
        ({"op": "cut", "name": "run", "of": "fit", "start": 0, "stop": 9}, "cannot be made of it"),
        ({"op": "remove", "board": "data", "name": "run"}, "remove that first"),
        ({"op": "choose", "model": "none"}, "no model 'none'"),
        ({"op": "identfy"}, "did you mean 'identify'"),
    ],
)
def test_a_step_that_will_not_do_changes_nothing(session, step, words):
    before = json.dumps(session.state)
    with pytest.raises(InputError, match=words):
        session.do(step)
    assert json.dumps(session.state) == before


def test_paths_outside_the_study_are_refused(session):
    for name in ("../secret.csv", "/etc/passwd", "imports/../../x"):
        with pytest.raises(InputError, match="not in the study's folder"):
            inside(session.folder, name)


def test_a_file_that_was_changed_after_it_was_dropped_is_refused(session):
    (session.folder / "imports" / "run.csv").write_text("other")
    with pytest.raises(StorageError, match="drop it once again"):
        session.make("data", "run")


def test_a_log_that_cannot_be_read_is_said_and_not_overwritten(session):
    log = session.folder / "workbench" / "log.json"
    log.write_text("{ torn")
    with pytest.raises(StorageError, match="move it away"):
        Session(session.folder)
    assert log.read_text() == "{ torn"


def walked(folder: Path, seed: int, nu: int, ny: int, scale: float) -> Session:
    """A study from a file to a law, its records detrended."""
    made = Session(folder / "study")
    file = received(made.folder, "run.csv", csv_of(folder / "run.csv", seed, nu, ny, scale))
    made.do(import_step(made.folder, "run", file, columns(nu, ny)))
    made.do({"op": "detrend", "name": "flat", "of": "run", "kind": "line"})
    made.do({"op": "cut", "name": "fit", "of": "flat", "start": 0, "stop": 1000})
    made.do({**IDENTIFY, "method": {"method": "subspace", "order": 8}})
    made.do({"op": "design", "name": "quiet", "model": "arx4", "method": {"method": "lqg"}, "reduce": None})
    made.make("laws", "quiet")
    return made


@pytest.mark.parametrize(
    ("nu", "ny", "scale"),
    [(1, 1, 1.0), pytest.param(3, 4, 1e9, marks=pytest.mark.slow), pytest.param(5, 3, 1e-9, marks=pytest.mark.slow)],
)
def test_the_recorded_python_gives_the_same_numbers(tmp_path, seed, monkeypatch, nu, ny, scale):
    made = walked(tmp_path, seed, nu, ny, scale)
    monkeypatch.chdir(made.folder)
    found: dict[str, object] = {}
    exec(compile((made.folder / "study.py").read_text(), "study.py", "exec"), found)
    model, law = made.item("models", "arx4").value(), made.item("laws", "quiet").value()
    assert found["record_fit"].hash == made.item("data", "fit").facts["hash"]
    assert found["model_arx4"].hash == model.hash
    assert found["law_quiet"].hash == law.hash


def test_a_law_is_put_round_another_and_goes_stale_with_it(tmp_path, seed, monkeypatch):
    made = walked(tmp_path, seed, 1, 1, 1.0)
    hum = {"method": "resonators", "tones_hz": [8.0], "settling_s": 2.0}
    made.do({"op": "design", "name": "hum", "model": "arx4", "method": hum, "reduce": None, "around": "quiet"})
    law = made.make("laws", "hum").value()
    monkeypatch.chdir(made.folder)
    found: dict[str, object] = {}
    exec(compile((made.folder / "study.py").read_text(), "study.py", "exec"), found)
    assert found["law_hum"].hash == law.hash
    assert parse((made.folder / "study.toml").read_text()).controllers["hum"].around == "quiet"
    lqg = {"method": "lqg", "control_weight": 10.0}
    made.do({"op": "design", "name": "quiet", "model": "arx4", "method": lqg, "reduce": None})
    assert not made.item("laws", "hum").ready
    with pytest.raises(InputError, match="'hum' is made of 'quiet'"):
        made.do({"op": "design", "name": "quiet", "model": "arx4", "method": lqg, "reduce": None, "around": "hum"})


def test_the_recorded_study_is_a_study_and_holds_the_same_records(tmp_path, seed):
    made = walked(tmp_path, seed, 1, 1, 1.0)
    text = (made.folder / "study.toml").read_text()
    study = parse(text)
    assert study.plant.method == "subspace"
    assert list(study.controllers) == ["quiet"]
    assert tomllib.loads(text)["records"]["files"] == ["data/fit.h5"]
    assert files.load(made.folder / "data" / "fit.h5").hash == made.item("data", "fit").facts["hash"]


@pytest.mark.slow
def test_a_run_goes_on_from_what_was_done_by_hand_and_the_other_way_round(tmp_path, seed):
    made = walked(tmp_path, seed, 1, 1, 1.0)
    said: list[str] = []
    study = load_study(made.folder / "study.toml")
    left = {name: (made.folder / "stages" / f"{name}.json").stat().st_mtime_ns for name in ("plant", "design-quiet")}
    walk(study, made.folder, beside=made.folder, say=said.append)
    for name, before in left.items():
        assert (made.folder / "stages" / f"{name}.json").stat().st_mtime_ns == before, f"{name} was computed again"
    law = files.load(made.folder / "controllers" / "quiet.h5")
    assert law.hash == made.item("laws", "quiet").value().hash
    at = time.time() + 1
    assert since(made, at) == ""
    made.do({"op": "table", "table": "requirements", "values": {"disk_margin": 0.9}})
    assert since(made, at) == "[requirements] was changed"
    shutil.rmtree(made.folder / "workbench")
    adopted = Session(made.folder)
    assert list(adopted.state["laws"]) == ["quiet"]
    assert adopted.make("laws", "quiet").value().hash == law.hash
    assert (made.folder / "stages" / "design-quiet.json").stat().st_mtime_ns == left["design-quiet"]


def test_poles_are_looked_at_one_order_after_the_other(session):
    """What the stabilisation diagram shows: the modes that the record was made with stand in line."""
    found = looks.seen(session.folder, looks.modes(session.folder, session.state, "run")["view"])
    last = found["rows"][found["rows"][:, 0] == found["orders"][-1]]
    assert found["orders"].tolist() == list(range(2, int(found["orders"][-1]) + 1, 2))
    assert np.abs(last[:, 1] / 8.0 - 1).min() < 0.02


def test_a_law_is_looked_at_beside_its_limit(session):
    """What the Design page says below its laws: the law's own attenuation, and more that no law exceeds."""
    session.do({**IDENTIFY, "method": METHOD})
    session.do({"op": "design", "name": "lqg", "model": "arx4", "method": {"method": "lqg"}, "reduce": None})
    law = session.make("laws", "lqg")
    found = looks.seen(session.folder, looks.limit(session.folder, session.state, "lqg")["view"])
    print(f"{found['attenuation_db']:.2f} dB of {found['limit_db']:.2f} dB: {found['words']}")
    assert found["attenuation_db"] == pytest.approx(law.facts["attenuation_db"], abs=0.1)
    assert found["limit_db"] > found["attenuation_db"]
    assert f"{found['limit_db']:.1f} dB" in str(found["words"])


OWN = '# my own study, three evenings of work\n[study]\ntitle = "Two masses"\n[bench]\nobject = "two_masses.py:make"\n'


def kept_in(folder: Path) -> dict[str, str]:
    """What was given another name, by it."""
    return {path.name: path.read_text() for path in folder.glob("study.edited*")}


def test_a_study_that_a_hand_has_written_is_kept(tmp_path):
    (tmp_path / "study.toml").write_text(OWN)
    (tmp_path / "study.py").write_text("mine = 1\n")
    made = Session(tmp_path)
    assert (tmp_path / "study.toml").read_text() == OWN
    made.do({"op": "title", "title": "x"})
    assert kept_in(tmp_path) == {"study.edited.toml": OWN, "study.edited.py": "mine = 1\n"}
    assert tomllib.loads((tmp_path / "study.toml").read_text())["study"]["title"] == "x"
    made.do({"op": "title", "title": "y"})
    made.undo()
    Session(tmp_path).do({"op": "title", "title": "z"})
    assert len(kept_in(tmp_path)) == 2, "what the workbench wrote itself is written over"


def test_what_was_edited_between_two_steps_is_kept_each_time(session):
    path = session.folder / "study.toml"
    for number, name in ((1, "study.edited.toml"), (2, "study.edited-2.toml")):
        path.write_text(path.read_text() + f"# note {number}\n")
        session.do({"op": "title", "title": f"title {number}"})
        assert kept_in(session.folder)[name].endswith(f"# note {number}\n")
        assert "# note" not in path.read_text()


def test_a_study_of_a_folder_without_notes_is_the_workbenchs_own_where_its_steps_lead_to_it(session):
    (session.folder / "workbench" / "written.json").unlink()
    again = Session(session.folder)
    again.do({"op": "title", "title": "x"})
    assert not kept_in(session.folder)
    (session.folder / "workbench" / "written.json").write_text("{ torn")
    Session(session.folder).undo()
    assert not kept_in(session.folder)


def test_a_study_that_is_only_opened_stays_as_it_is(session, tmp_path):
    session.do({**IDENTIFY, "method": METHOD})
    session.do({"op": "design", "name": "quiet", "model": "arx4", "method": {"method": "lqg"}, "reduce": None})
    study = parse(session.toml())
    ran = tmp_path / "ran"
    ran.mkdir()
    (ran / "study.json").write_text(study.model_dump_json())
    (ran / "study.toml").write_text(OWN)
    (ran / "records").mkdir()
    files.save(session.make("data", "fit").value(), ran / "records" / "fit.h5")
    opened = Session(ran)
    assert list(opened.state["laws"]) == ["quiet"]
    assert (ran / "study.toml").read_text() == OWN
    assert not kept_in(ran)
    assert Session(ran).state == opened.state
    assert (ran / "study.toml").read_text() == OWN
    opened.do({"op": "title", "title": "x"})
    assert kept_in(ran) == {"study.edited.toml": OWN}


def test_a_record_of_somebody_is_not_written_over(session):
    (session.folder / "data").mkdir(exist_ok=True)
    (session.folder / "data" / "fit.h5").write_bytes(b"mine")
    session.do({**IDENTIFY, "method": METHOD})
    session.make("data", "fit")
    assert (session.folder / "data" / "fit.edited.h5").read_bytes() == b"mine"
    digest = session.item("data", "fit").facts["hash"]
    assert files.load(session.folder / "data" / "fit.h5").hash == digest
    (session.folder / "data" / "fit.sha256").unlink()
    session.do({"op": "title", "title": "x"})
    assert not (session.folder / "data" / "fit.edited-2.h5").exists(), "it is the same record"


TABLES = {
    "a list of tables": {"claims": [{"where": "p. 1", "ours": {"a b": "x/y"}}, {"where": "p. 2"}, {}]},
    "tables in a list of tables": {"a": [{"b": [{"c": 1}, {"c": 2}]}, {"b": [{"c": 3}]}]},
    "a table beside numbers": {"mixed": [1, {"a": [{"b": 2}], "c d": True}], "rows": [[1.0, 2.0], [3.0, 4.0]]},
    "odd strings": {"quoted": 'a "b" \\ c', "breaks": "a\nb\tc", "control": "\x00\x1f\x7f", "far": "\U0001f600 ä"},
    "odd keys": {"": 1, "a.b": 2, "ä\U0001f600": 3, 'q"': {"x\x7f": 4}, "0": {"-": []}},
    "numbers": {"small": 1e-300, "large": 10**15, "minus": -0.5, "infinite": float("inf"), "no": False},
    "nothing in it": {"empty": {}, "list": [], "in": {"deep": {}}},
}


@pytest.mark.parametrize("words", TABLES)
def test_whatever_a_table_holds_is_read_back_from_the_study_as_it_was(session, words):
    session.do({"op": "table", "table": "paper", "values": TABLES[words]})
    assert tomllib.loads((session.folder / "study.toml").read_text())["paper"] == TABLES[words]


def test_what_no_study_file_can_say_is_refused_before_it_is_a_step(session):
    before = len(session.steps)
    with pytest.raises(InputError, match="no study file"):
        session.do({"op": "table", "table": "paper", "values": {"orders": [1, None]}})
    assert len(session.steps) == before
    assert "paper" not in session.state["tables"]
