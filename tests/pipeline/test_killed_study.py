"""A whole study, killed at moments spread over all its stages and run again: the same numbers, and no stray file."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest
import small_study

import ultraquiet as uq

SCRIPT = Path(__file__).with_name("small_study.py")
ENVIRONMENT = {**os.environ, "PYTHONWARNINGS": "ignore"}
STRUCK = {"recording", "plant", "design", "loop", "deploy", "summary and report"}
# The first of these that a folder lacks was being made. Models are identified beside loop and code.
MILESTONES = {
    "study.json": "before it began",
    "records/all.h5": "recording",
    "stages/plant.json": "plant",
    "stages/design-calm.json": "design",
    "stages/loop-calm.json": "loop",
    "stages/deploy-calm.json": "deploy",
    "stages/identify.json": "identify, controllers done",
    "stages/analyse.json": "validation",
    "stages/limits.json": "limits",
    "report.html": "summary and report",
}


@pytest.fixture
def study(tmp_path):
    return small_study.written(tmp_path)


@pytest.fixture
def walked(study, tmp_path):
    """Has the study run in a process of its own, killed at its `death`-th change of the folder or after some seconds.

    All of them are children of one that has run it before: a run takes what the study takes, and no start of Python.
    """
    with (
        (tmp_path / "said").open("w+") as said,
        subprocess.Popen(
            [sys.executable, str(SCRIPT), str(study)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
            env=ENVIRONMENT,
        ) as server,
    ):
        assert server.stdin is not None
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n", (tmp_path / "said").read_text()

        def one(folder, death=0, after=None, told=None):
            server.stdin.write(json.dumps([str(folder), death, told and str(told)]) + "\n")
            server.stdin.flush()
            pid = int(server.stdout.readline())
            if after is not None:
                time.sleep(after)
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            return int(server.stdout.readline()), (tmp_path / "said").read_text()[-500:]

        yield one
        server.stdin.close()
        server.wait(30)


def numbers(folder):
    """Everything a study found out, without how long it took."""
    summary = json.loads((folder / "summary.json").read_text(), object_pairs_hook=untimed)
    archives = {p.relative_to(folder).as_posix(): uq.files.load(p) for p in folder.rglob("*.h5")}
    hashes = {name: getattr(value, "hash", None) or repr(value) for name, value in archives.items()}
    code = {p.relative_to(folder).as_posix(): p.read_bytes() for p in (folder / "code").rglob("*.[ch]*")}
    return summary, hashes, code


def untimed(pairs):
    return {key: value for key, value in pairs if "seconds" not in key}


def names(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*")}


def moment(folder):
    """What a killed run was about."""
    missing = [what for name, what in MILESTONES.items() if not (folder / name).exists()]
    return missing[0] if missing else "the end"


@pytest.mark.slow
@pytest.mark.timeout(5400)
@pytest.mark.parametrize("count", [40])
def test_a_study_killed_anywhere_and_run_again_leaves_the_same(count, walked, tmp_path, rng, cases):
    """Half of the kills strike at a change of the folder, one in each of as many parts of them, half at any time."""
    whole, count = count, cases(count)
    begun = time.monotonic()
    code, said = walked(tmp_path / "whole", death=1 << 30, told=tmp_path / "told")
    took = time.monotonic() - begun
    assert code == 0, said
    wanted, files = numbers(tmp_path / "whole"), names(tmp_path / "whole")
    changes = len((tmp_path / "told").read_text().splitlines())
    deaths = [int(1 + (k + rng.random()) * changes / (count // 2)) for k in range(count // 2)]
    deaths[-1] = changes - 2  # summary and report are written within the last five, whatever runs beside
    kills = [{"death": death} for death in deaths] + [{"after": after} for after in rng.uniform(0, took, count // 2)]
    struck, identifying, wrong = Counter(), 0, []
    for number, kill in enumerate(kills):
        folder = tmp_path / str(number)
        killed, _ = walked(folder, **kill)
        assert killed in (-9, 0)
        at = moment(folder) if folder.exists() else "before it began"
        struck[at if killed else "too late"] += 1
        identifying += (folder / "records/all.h5").exists() and not (folder / "stages/identify.json").exists()
        code, said = walked(folder)
        if code != 0 or names(folder) != files or numbers(folder) != wanted:
            wrong.append((kill, at, code, said, sorted(names(folder) ^ files)))
        print(f"{number + 1}: killed at {kill}, about {at}; wrong so far: {len(wrong)}", flush=True)
    print(
        f"{count} kills within {changes} changes and {took:.0f} s: {dict(struck)}, of these {identifying} while models "
        f"were identified; wrong afterwards: {len(wrong)}"
    )
    assert not wrong, wrong
    if count == whole:
        assert set(struck) >= STRUCK
        assert identifying > 0


@pytest.mark.slow
def test_a_second_run_of_a_process_study_does_not_move_the_plant(run, tmp_path):
    """By the command line; the plant keeps a diary of its runs."""
    plant, diary = SCRIPT.with_name("two_masses_process.py"), tmp_path / "diary"
    study = small_study.written(tmp_path)
    process = f'method = "process"\ncommand = ["{sys.executable}", "{plant}", "{diary}"]'
    study.write_text(study.read_text().replace('method = "two-masses"', process))
    said = [run("run", study, "--out", "out") for _ in range(2)]
    assert [code for code, *_ in said] == [0, 0], said
    first = numbers(tmp_path / "out")
    runs = diary.read_text().splitlines()
    said = run("report", "out")
    assert said[0] == 0, said
    print(f"{len(runs)} runs of the plant by the first walk, {len(diary.read_text().splitlines()) - len(runs)} later")
    assert diary.read_text().splitlines() == runs
    assert numbers(tmp_path / "out") == first
    # Its command is what it is: another one is another bench.
    study.write_text(study.read_text().replace(str(diary), f'{diary}", "more'))
    code, _, err = run("run", study, "--out", "out")
    assert (code, "'command' was" in err) == (2, True)
    assert numbers(tmp_path / "out") == first


RIG = """
from pathlib import Path
import numpy as np
import ultraquiet as uq


def make():
    sent, state, out = np.zeros(2), np.zeros(2), open(Path(__file__).with_name("sent"), "a", buffering=1)

    def write(u):
        sent[:] = u
        out.write(" ".join(map(str, u)) + "\\n")

    def read():
        state[:] = 0.9 * state + 0.1 * sent
        return state + 1e-3 * np.sin(1e3 * state)

    wires = [[uq.Channel(f"{side} {k}", "N", -5.0, 5.0) for k in range(2)] for side in ("force", "speed")]
    return uq.bench.Hardware(write, read, 500.0, *wires, uq.bench.Interlocks(ramp_s=0.1, frame_s=60.0), lambda: None)
"""
ON_THE_RIG = """
[study]
title = "guarded"
[bench]
object = "rig.py:make"
[experiment]
list = "list.toml"
[plant]
method = "subspace"
order = 2
records = ["push"]
[controllers.calm.design]
method = "lqg"
"""
# Under `nohup` a child would be born with HUP ignored, as these tests are, and rightly go on.
HEARING = """
import runpy, signal
signal.signal(signal.SIGHUP, signal.SIG_DFL)
runpy.run_module("ultraquiet", run_name="__main__", alter_sys=True)
"""
PUSHES = """
[[commands]]
do = "excite"
name = "push"
samples = 3000
actuator = "all"
signal = { method = "noise", peak = 2.0 }
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_run_that_is_ended_while_it_closes_a_loop_leaves_a_guarded_bench_at_rest(tmp_path, number):
    """Loops are closed in threads, which no signal reaches by itself."""
    for name, text in (("rig.py", RIG), ("study.toml", ON_THE_RIG), ("list.toml", PUSHES)):
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-c", HEARING, "run", "study.toml", "--out", "out"]
    with subprocess.Popen(command, cwd=tmp_path, env=ENVIRONMENT, stdout=subprocess.DEVNULL) as process:
        until = time.monotonic() + 120
        while not (tmp_path / "out/stages/design-calm.json").exists() or not moving(tmp_path / "sent", 4000):
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        process.send_signal(number)
        assert process.wait(60) == 130
    assert not (tmp_path / "out/stages/loop-calm.json").exists()
    last = [[float(x) for x in line.split()] for line in (tmp_path / "sent").read_text().splitlines()[-20:]]
    assert last[-1] == [0.0, 0.0]
    assert max(abs(a - b) for one, other in itertools.pairwise(last) for a, b in zip(one, other, strict=True)) <= 0.1


def moving(path: Path, most: int) -> bool:
    """Whether a bench was sent more than so many commands, and was moving at the last of them."""
    lines = path.read_text().splitlines()
    return len(lines) > most and any(abs(float(x)) > 0.1 for x in lines[-2].split())
