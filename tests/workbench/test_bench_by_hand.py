"""A bench by hand without a browser: its channels, a live look, a list that is measured and goes on as a study."""

import itertools
import re
import time

import pytest

from ultraquiet.pipeline.identification import of_unit
from ultraquiet.pipeline.study import parse
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
