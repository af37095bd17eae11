"""A workbench that is killed while it writes, and one that shows a live bench for minutes."""

import json
import os
import re
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from workbench_helpers import browser, finished_study, served

from ultraquiet.workbench import Session

pytestmark = [pytest.mark.web, pytest.mark.slow]
# The server as it is, except that the disk is its end: killed as the N-th time that it waits for bytes once told to.
KILLED = """
import os, signal
from pathlib import Path
waits, wait = [], os.fsync
def fsync(number):
    if Path({armed!r}).exists():
        waits.append(number)
        if len(waits) == {at}:
            os.kill(os.getpid(), signal.SIGKILL)
    wait(number)
os.fsync = fsync
from ultraquiet.cli import main
main()
"""


@pytest.mark.parametrize("at", [1, 2, 3, 5], ids=["log", "named", "script", "study"])
def test_a_server_killed_while_it_writes_leaves_the_study_intact(tmp_path, at):
    """A step goes to the log, the script and the study file, each written beside and then named: two waits."""
    folder, armed = finished_study(tmp_path / "study", 1, 1), tmp_path / "armed"
    before = Session(folder)
    steps, kept = len(before.steps), before.item("models", "model").value().hash
    with served(folder, start=KILLED.format(armed=str(armed), at=at)) as made, browser(made) as seen:
        seen.go("records?data=run")
        seen.drawn("record-chart")
        workers = below(made.process.pid)
        armed.touch()
        seen.click("detrend-mean")
        assert made.process.wait(timeout=60) == -signal.SIGKILL
    armed.unlink()
    assert json.loads((folder / "workbench" / "log.json").read_text())["version"] == 1
    again = Session(folder)
    assert len(again.steps) == steps + (at > 1), "a step is in the log whole, or not at all"
    assert again.item("models", "model").value().hash == kept
    for board in ("data", "models", "laws", "codes"):
        for item in again.items(board):
            assert item.ready == (item.name != "run-flat"), item.name
    left = {path for path in folder.rglob(".*") if path.name.endswith((".part", ".part.npz"))}
    wait_until(lambda: not [pid for pid in workers if Path(f"/proc/{pid}").exists()], "workers end with their server")
    with served(folder) as made, browser(made) as seen:
        seen.go("records?data=run")
        seen.drawn("record-chart")
        seen.click("detrend-mean")
        seen.made("data", "run-flat")
        assert seen.errors == []
    assert at == 2 or left, "it was killed while it wrote"
    assert not [path for path in left if path.exists()]
    compile((folder / "study.py").read_text(), "study.py", "exec")
    assert abs(float(np.mean(Session(folder).item("data", "run-flat").value().outputs))) < 1e-6


def wait_until(so, why, patience_s=20.0):
    """Wait until something holds."""
    end = time.monotonic() + patience_s
    while not so():
        assert time.monotonic() < end, why
        time.sleep(0.2)


def below(pid):
    """All processes that a process has started, and theirs."""
    own = [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [*own, *(each for child in own for each in below(child))]


def resident_mb(pid):
    """What a process holds in memory."""
    text = Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", text)[1]) / 1024


WARM_S, EVERY_S = 15.0, 2.0  # compiled kernels and kept blocks fill up first
GROWTH_MB_A_MINUTE = 4.0


def test_a_live_bench_takes_no_more_memory_the_longer_it_runs(tmp_path, request):
    """RSS of the server and its workers and the page's heap, over `--live-seconds`; a slope through all samples."""
    seconds = request.config.getoption("--live-seconds")
    with served(tmp_path / "study") as made, browser(made) as seen:
        seen.go("bench")
        seen.click("take-bench")
        seen.find("channels")
        seen.click("live-start")
        seen.drawn("live-chart")
        time.sleep(WARM_S)
        page = seen.page.context.new_cdp_session(seen.page)
        drawn, samples, began = (
            seen.page.get_attribute("[data-testid='live-chart']", "data-drawn"),
            [],
            time.monotonic(),
        )
        while (at := time.monotonic() - began) < seconds:
            page.send("HeapProfiler.collectGarbage")
            heap = page.send("Runtime.getHeapUsage")["usedSize"] / 2**20
            pids = [made.process.pid, *below(made.process.pid)]
            samples.append((at, resident_mb(pids[0]), sum(map(resident_mb, pids[1:])), heap))
            seen.page.wait_for_timeout(1000 * EVERY_S)
        last = seen.page.get_attribute("[data-testid='live-chart']", "data-drawn")
        frames = int(last, 16) - int(drawn, 16)
        seen.click("live-stop")
        assert seen.errors == []
    at, *held = np.array(samples).T
    for name, values in zip(("server", "workers", "page"), held, strict=True):
        slope = 60 * np.polyfit(at, values, 1)[0]
        print(
            f"{name}: {values[0]:.1f} MB at the start, {values[-1]:.1f} after {at[-1]:.0f} s, {slope:+.2f} MB a minute"
        )
        assert slope < GROWTH_MB_A_MINUTE, name
    print(f"{frames} frames, load {os.getloadavg()[0]:.1f}, Python {sys.version.split()[0]}")
    assert frames > seconds, "it was drawn all the while"
