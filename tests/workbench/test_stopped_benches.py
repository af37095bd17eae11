"""A bench that is stopped: whatever moves it is asked to bring it to rest, then told to, and killed last of all."""

import time
from pathlib import Path

import numpy as np
import pytest

from ultraquiet.experiments import StoppedError
from ultraquiet.workbench import Session
from ultraquiet.workbench.engine.items import FOLDER
from ultraquiet.workbench.jobs import bench_work, lane, worker
from ultraquiet.workbench.jobs.lane import STOP_FILE, Lane, WorkItem

HARDWARE = """
import time
from pathlib import Path
import numpy as np, ultraquiet as uq
def make():
    held, channels = [np.zeros({nu})], range({nu})
    def write(u):
        held.append(u.copy())
        with open(r"{folder}/written.txt", "a", buffering=1) as out:
            out.write(" ".join(map(str, u)) + "\\n")
        if len(held) == {presses}:
            Path(r"{folder}/workbench/stop").touch()
    return uq.bench.Hardware(
        write=write, read=lambda: np.zeros({ny}), rate_hz=500.0,
        actuators=[uq.Channel(f"u{{k}}", "{unit}", -10.0, 10.0) for k in channels],
        sensors=[uq.Channel(f"y{{k}}", "{unit}/s", -50.0, 50.0) for k in range({ny})],
        interlocks=uq.bench.Interlocks(frame_s=60.0), wait=lambda: time.sleep(2e-3))  # a card keeps the time
"""
PUSH = """
[[commands]]
do = "excite"
name = "push"
samples = 5000
signal = {method = "step", level = 5.0, rise_s = 0.1, fall_s = 9.0}
"""


def moving_bench(folder: Path, nu: int = 1, ny: int = 1, unit: str = "V", presses: int = -1) -> Session:
    """A study of a bench that notes what is written to it, and presses the red button at one write."""
    made = Session(folder)
    (made.folder / "list.toml").write_text(PUSH)
    words = {"nu": nu, "ny": ny, "unit": unit, "presses": presses, "folder": made.folder}
    (made.folder / "bench.py").write_text(HARDWARE.format(**words))
    made.do({"op": "table", "table": "bench", "values": {"object": "bench.py:make"}})
    made.do({"op": "table", "table": "experiment", "values": {"list": "list.toml"}})
    return made


def written(folder: Path) -> np.ndarray:
    """What was written so far, `(writes, nu)`."""
    path = folder / "written.txt"
    return np.loadtxt(path, ndmin=2) if path.exists() else np.zeros((0, 1))


def came_to_rest(sent: np.ndarray) -> None:
    """Whether what was written last is zero, and was led there in a tenth of a second at least."""
    assert not sent[-1].any()
    assert (np.abs(np.diff(sent[60:], axis=0)) <= 5.0 / 50 * (1 + 1e-9)).all()


@pytest.mark.parametrize(("nu", "ny", "unit"), [(1, 1, "V"), (4, 3, "N"), (3, 5, "mm")])
def test_a_list_that_is_stopped_brings_its_bench_to_rest(tmp_path, nu, ny, unit):
    made = moving_bench(tmp_path / "study", nu, ny, unit, presses=60)
    with pytest.raises(StoppedError, match="stopped as asked in 'push-1'"):
        bench_work.measured(made.folder, made.state)
    sent = written(made.folder)
    assert sent[59].max() == 5.0
    came_to_rest(sent)
    assert len(sent) < 200


# What a process that computes says of a job, without what it computes.
STAND_IN = """
import json, signal, sys, time
from pathlib import Path
folder, way = Path(sys.argv[1]), {way!r}
def leave(number, frame):
    with open(folder / "told", "a") as told:
        told.write("SIGTERM ")
    if way != "deaf":
        raise SystemExit(143)
signal.signal(signal.SIGTERM, leave)
for line in sys.stdin:
    number = json.loads(line)["id"]
    (folder / "begun").touch()
    while way == "deaf" or not (way == "asks" and (folder / "workbench" / "stop").exists()):
        if way == "slow" and (folder / "workbench" / "stop").exists():
            print(json.dumps({{"id": number, "rest_s": 0.3}}), flush=True)
        time.sleep(0.01)
    print(json.dumps({{"id": number, "failed": "stopped", "asked": True}}), flush=True)
"""


def stand_in(folder: Path, monkeypatch, way: str) -> Lane:
    """A lane whose process asks whether it is to stop, ends when it is told to, or does neither."""
    (folder / "workbench").mkdir()
    (folder / "stand_in.py").write_text(STAND_IN.format(way=way))
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.setattr(lane, "WORKER", "stand_in")
    monkeypatch.setattr(lane, "SOFT_S", 5.0 if way == "asks" else 0.1)  # who asks needs none of it
    return Lane(folder, lambda: None)


def wait_for(holds) -> None:
    """Wait until something holds."""
    until = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.parametrize("closes", [False, True], ids=["cancelled", "closed"])
@pytest.mark.parametrize(
    ("task", "way", "told"),
    [
        ("measure", "asks", 0),
        ("live", "asks", 0),
        ("close", "ends", 1),
        ("run", "ends", 1),
        ("measure", "ends", 1),
        ("run", "deaf", 1),
        ("describe", "ends", 0),
    ],
)
def test_who_may_move_a_bench_is_asked_then_told_and_then_killed(tmp_path, monkeypatch, task, way, told, closes):
    used = stand_in(tmp_path, monkeypatch, way)
    try:
        job = used.submit(WorkItem(task, "a job", {}, {}))
        wait_for((tmp_path / "begun").exists)
        if closes:
            used.close()
        else:
            used.cancel(job)
            used.cancel(job)  # pressed again, it is as if it had been pressed once
            wait_for(lambda: job.over)
        assert (tmp_path / "told").exists() == bool(told)
        if told:
            assert (tmp_path / "told").read_text().split() == ["SIGTERM"] * told
        if task != "describe":
            assert job.status == "cancelled"
            assert job.sentence == "a job: cancelled; what was finished before is kept."
    finally:
        used.close()


def test_a_bench_that_needs_longer_to_come_to_rest_is_given_that_time(tmp_path, monkeypatch):
    used = stand_in(tmp_path, monkeypatch, "slow")
    try:
        job = used.submit(WorkItem("measure", "a job", {}, {}))
        wait_for((tmp_path / "begun").exists)
        began = time.monotonic()
        used.cancel(job)
        wait_for(lambda: job.over)
        assert time.monotonic() - began > 0.39
        assert job.status == "cancelled"
    finally:
        used.close()


def test_work_of_another_lane_does_not_take_back_a_stop(tmp_path, monkeypatch):
    used = stand_in(tmp_path, monkeypatch, "ends")
    try:
        (tmp_path / FOLDER / STOP_FILE).touch()
        used.submit(WorkItem("make", "a model", {}, {}))
        wait_for((tmp_path / "begun").exists)
        assert (tmp_path / FOLDER / STOP_FILE).exists()
    finally:
        used.close()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["measure", "run", "closed"])
def test_the_red_button_leaves_no_voltage_on_a_bench(tmp_path, how):
    """The process that computes itself, while it measures a list, or one that belongs to the whole study."""
    made = moving_bench(tmp_path / "study")
    made.do({"op": "measure", "name": "push-1", "file": "records/push-1.h5"})
    method = {"method": "arx"}
    made.do({"op": "identify", "name": "m", "records": ["push-1"], "period_samples": None, "method": method})
    made.do({"op": "design", "name": "k", "model": "m", "method": {"method": "lqg"}, "reduce": None})
    used = Lane(made.folder, lambda: None)
    try:
        job = used.submit(WorkItem("run" if how == "run" else "measure", how, dict(made.state), {}))
        wait_for(lambda: len(written(made.folder)) > 100)
        used.close() if how == "closed" else used.cancel(job)
        wait_for(lambda: job.over)
        assert job.status == "cancelled", job.sentence
        sent = written(made.folder)
        assert sent.max() > 4.0
        came_to_rest(sent)
    finally:
        used.close()


class Gone:
    """A server that is there no more after a few lines."""

    lines = 0

    def write(self, text):
        self.lines += 1
        if self.lines > 4:
            raise BrokenPipeError(text[:10])

    def flush(self):
        """Nothing waits."""


@pytest.mark.parametrize(("nu", "ny", "unit"), [(1, 1, "V"), (4, 3, "N"), (3, 5, "mm")])
def test_a_look_at_a_bench_that_nobody_takes_any_more_has_ended_before_its_error_is_told(tmp_path, nu, ny, unit):
    session = moving_bench(tmp_path, nu, ny, unit)
    words = {"signal": {"method": "step", "level": 5.0, "rise_s": 0.1, "fall_s": 9.0}, "actuator": 0}
    request = {"id": 1, "task": "live", "state": session.state, "words": words}
    with pytest.raises(BrokenPipeError) as told:
        worker.answer(session.folder, request, Gone())
    assert told.tb is not None
    came_to_rest(written(session.folder))
