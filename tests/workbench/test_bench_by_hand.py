"""A bench by hand without a browser: its channels, a live look, a list that is measured and goes on as a study."""

import itertools
import re
import time
from pathlib import Path

import pytest

from ultraquiet import experiments
from ultraquiet.pipeline.identification import of_unit
from ultraquiet.pipeline.store.recorded import Records
from ultraquiet.pipeline.store.sources import bench_of, list_of
from ultraquiet.pipeline.study import Study, load_study, packaged_study, parse
from ultraquiet.workbench import Session
from ultraquiet.workbench.engine.items import FOLDER
from ultraquiet.workbench.jobs import bench_work
from ultraquiet.workbench.jobs.lane import STOP_FILE
from ultraquiet.workbench.web.pages.bench import demo_steps

LIST = """
[[commands]]
do = "excite"
name = "noise"
samples = 600
signal = { method = "noise", stop_hz = 150.0, peak_v = 5.0 }
"""


@pytest.fixture
def session(tmp_path):
    made = Session(tmp_path / "study")
    (made.folder / "list.toml").write_text(LIST)
    made.do({"op": "table", "table": "bench", "values": {"method": "hexapod", "unit": "ground"}})
    made.do({"op": "table", "table": "experiment", "values": {"list": "list.toml"}})
    return made


def test_a_bench_is_described_and_looked_at_live_until_it_is_stopped(session):
    known = bench_work.described(session.folder, session.state)
    assert (len(known["actuators"]), len(known["sensors"])) == (6, 6)
    stream = bench_work.live(session.folder, session.state, {"method": "noise", "peak_v": 5.0}, 2)
    began = time.perf_counter()
    parts = list(itertools.islice(stream, 4))
    assert time.perf_counter() - began >= 3 * bench_work.FRAME_S, "it runs at the bench's own pace"
    assert all(part["signals"].shape == (12, 175) for part in parts)
    moving = abs(parts[-1]["signals"][:6]).max(axis=1) > 0
    assert moving.tolist() == [False, False, True, False, False, False]
    (session.folder / FOLDER / STOP_FILE).touch()
    rest = list(stream)
    assert len(rest) < 20, "it is brought to rest and ends"


def test_what_was_measured_goes_to_the_boards_and_into_the_study(session):
    found = bench_work.measured(session.folder, session.state)["records"]
    assert list(found) == [f"noise-{k}" for k in range(1, 7)]
    for name, digest in found.items():
        session.do({"op": "measure", "name": name, "file": f"records/{name}.h5", "hash": digest})
    item = session.make("data", "noise-1")
    assert item.facts["hash"] == found["noise-1"]
    assert item.facts["samples"] == 600
    session.do(
        {"op": "identify", "name": "m", "records": ["noise-1"], "period_samples": None, "method": {"method": "arx"}}
    )
    session.do({"op": "design", "name": "k", "model": "m", "method": {"method": "lqg"}, "reduce": None})
    study = parse(session.toml())
    assert study.experiment.list == "list.toml"
    assert study.plant.records == ["noise-1"]
    again = bench_work.measured(session.folder, session.state)["records"]
    assert again == found, "records that are there stay"


def test_further_units_have_models_of_their_own(session, monkeypatch):
    """`[plant] units` of a study: kept on the boards, in the study and in the script, and made with the plant."""
    periodic = 'signal = { method = "multisine", period_samples = 200, stop_hz = 1600.0, peak_v = 5.0 }'
    (session.folder / "list.toml").write_text(re.sub("signal = .*", periodic, LIST))
    for name, digest in bench_work.measured(session.folder, session.state)["records"].items():
        session.do({"op": "measure", "name": name, "file": f"records/{name}.h5", "hash": digest})
    step = {"op": "identify", "name": "m", "records": [f"noise-{k}" for k in range(1, 7)], "period_samples": 200}
    session.do({**step, "method": {"method": "rational", "order": 4}, "units": ["flight"]})
    session.do({"op": "design", "name": "k", "model": "m", "method": {"method": "peak-bounded"}, "reduce": None})
    assert parse(session.toml()).plant.units == ["flight"]
    made = session.make("models", "m")
    ground, flight = made.value(), made.value(of_unit("flight"))
    assert ground.D.shape == flight.D.shape
    assert ground.hash != flight.hash
    lines = session.python().splitlines()
    monkeypatch.chdir(session.folder)
    found: dict[str, object] = {}
    exec("\n".join(line for line in lines if not line.startswith("law_")), found)
    assert found["model_m_units"]["flight"].hash == flight.hash
    assert any(line.startswith("law_k") and line.endswith("model_m_units)") for line in lines)


def test_the_demo_is_a_study_by_hand(tmp_path):
    made = Session(tmp_path / "demo")
    for step in demo_steps():
        made.do(step)
    study = bench_work.study_of(made.state)
    assert study.bench.method == "hexapod"
    assert study.experiment.list == "suite"
    assert made.state["title"].startswith("SUITE")
    made.do({"op": "measure", "name": "noise-1", "file": "records/noise-1.h5"})
    method = {"method": "subspace", "order": 4}
    made.do({"op": "identify", "name": "p", "records": ["noise-1"], "period_samples": None, "method": method})
    made.do({"op": "design", "name": "quiet", "model": "p", "method": {"method": "lqg"}, "reduce": None})
    written_down, packaged = load_study(made.folder / "study.toml"), packaged_study("suite")
    for table in ("bench", "experiment", "identify", "paper", "closed_loop", "limits", "payload", "validate_models"):
        assert getattr(written_down, table) == getattr(packaged, table), table


def test_a_study_that_ran_keeps_every_table_on_the_boards(tmp_path):
    """Whatever a study file may hold, but for the records that it names: those are the boards' own."""
    packaged = packaged_study("suite")
    law = next(iter(packaged.controllers))
    more = {"commission": {"law": law, "gains": [0.2, 1.0]}, "campaign": {"law": law, "benches": 3}}
    content = packaged.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    content["deploy"] = {"precision": "float64"}
    study = Study.model_validate({**content, **more})
    (tmp_path / "records").mkdir()
    for name in study.plant.records:
        for number in (1, 2):
            (tmp_path / "records" / f"{name}-{number}.h5").touch()
    (tmp_path / "study.json").write_text(study.model_dump_json())
    opened = Session(tmp_path)
    again = parse(opened.toml())
    told = {name for name, value in study if name not in ("records", "blending")}
    assert {name for name in told if getattr(study, name) == type(study).model_fields[name].default} == set()
    for name in told:
        assert getattr(again, name) == getattr(study, name), name


BLENDED = """
import numpy as np, ultraquiet as uq
def make():
    pole, nu, ny = 0.5, {nu}, {ny}
    state, gains = np.zeros(ny), np.linspace(0.5, 1.0, ny * nu).reshape(ny, nu)
    def step(u, d):
        y = state.copy()
        state[:] = pole * state + (1 - pole) * gains @ (u + d)
        return y
    names = [f"f {{k}}" for k in range(nu)] + [f"v {{k}}" for k in range(ny)]
    wires = [uq.Channel(name, "{unit}", -50.0, 50.0) for name in names]
    return uq.bench.Wrapped(step, lambda: state.fill(0), 1000.0, wires[:nu], wires[nu:])
"""


def blended_session(folder: Path, nu: int, ny: int, unit: str, control_rate_hz: float) -> Session:
    """A study whose bench is driven through the sum of its actuators, at a fraction of its rate."""
    made = Session(folder)
    (made.folder / "list.toml").write_text(LIST.replace("stop_hz = 150.0, peak_v", "stop_hz = 100.0, peak"))
    (made.folder / "bench.py").write_text(BLENDED.format(nu=nu, ny=ny, unit=unit))
    blending = {"actuators": [[1.0]] * nu, "actuator_names": ["all"], "actuator_unit": unit, "averages": 1}
    for table, values in (
        ("bench", {"object": "bench.py:make"}),
        ("experiment", {"list": "list.toml"}),
        ("blending", {**blending, "control_rate_hz": control_rate_hz}),
        ("closed_loop", {"band_hz": [20.0, 60.0]}),
    ):
        made.do({"op": "table", "table": table, "values": values})
    return made


@pytest.mark.parametrize(("nu", "ny", "unit"), [(1, 1, "V"), (4, 3, "N"), (3, 5, "mm")])
def test_a_law_of_a_study_in_modes_runs_on_the_bench_in_its_modes(tmp_path, nu, ny, unit):
    made = blended_session(tmp_path / "study", nu, ny, unit, 500.0)
    study = bench_work.study_of(made.state)
    ((name, digest),) = bench_work.measured(made.folder, made.state)["records"].items()
    made.do({"op": "measure", "name": name, "file": f"records/{name}.h5", "hash": digest})
    record = made.make("data", name).value()
    seen = bench_work.bench_of_plant(study, made.folder, record)
    assert (seen.rate_hz, len(seen.actuators), len(seen.sensors)) == (500.0, 1, ny)
    assert [c.name for c in seen.actuators] == ["all"]
    raw = bench_work.bench_of(study, made.folder)
    assert bench_work.bench_of_plant(study, made.folder, raw).rate_hz == 1000.0


@pytest.mark.slow
def test_a_loop_of_a_study_in_modes_is_measured_on_its_bench(tmp_path):
    made = blended_session(tmp_path / "study", 2, 1, "N", 500.0)
    ((name, digest),) = bench_work.measured(made.folder, made.state)["records"].items()
    made.do({"op": "measure", "name": name, "file": f"records/{name}.h5", "hash": digest})
    method = {"method": "subspace", "order": 2}
    made.do({"op": "identify", "name": "m", "records": [name], "period_samples": None, "method": method})
    made.do({"op": "design", "name": "k", "model": "m", "method": {"method": "lqg"}, "reduce": None})
    found = bench_work.closed(made.folder, made.state, "k")["facts"]["units"]["bench"]
    print(found)
    assert found["stable"]
    assert found["heard_hz"][1] < 250.0, "at the rate of the law"


@pytest.mark.parametrize("hashed", [True, False], ids=["measured by hand", "taken over"])
def test_what_was_measured_anew_beside_the_workbench_makes_stale_what_was_made_of_it(session, hashed):
    found = bench_work.measured(session.folder, session.state)["records"]
    for name, digest in found.items():
        step = {"op": "measure", "name": name, "file": f"records/{name}.h5"}
        session.do(step | ({"hash": digest} if hashed else {}))
    session.do({"op": "detrend", "name": "flat", "of": "noise-1", "kind": "mean"})
    session.make("data", "flat")
    session.do({"op": "title", "title": "taken back"})
    session.undo()
    steps = len(session.steps)
    assert Session(session.folder).item("data", "flat").ready
    study = bench_work.study_of({**session.state, "tables": {**session.state["tables"], "study": {"seed": 7}}})
    walk(study, session.folder, record_again=True)
    again = Session(session.folder)
    old, words = again.stale("data", "flat")
    assert old.ready
    assert words.startswith("data/noise-1: hash was ")
    assert len(again.steps) == steps + (len(found) if hashed else 1)
    assert again.can_redo
    assert again.make("data", "noise-1").facts["hash"] != found["noise-1"]
    assert Session(session.folder).steps == again.steps, "it is noticed once"


def walk(study: Study, folder: Path, record_again: bool) -> None:
    """Measure the list of a study as `ultraquiet run` does, and no more."""
    bench = bench_of(study, folder)
    listed = experiments.load(list_of(study, folder), bench, study.study.seed)
    store = Records(listed, bench, dict, folder, print)
    store.claim(record_again)
    store.take()
