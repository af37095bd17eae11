"""The exit code of every command: 0 done and ok, 1 done and not ok, 2 refused, 130 interrupted."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import typer.main

import ultraquiet as uq
from ultraquiet._base import registry
from ultraquiet._base.errors import (
    BenchError,
    InputError,
    Interrupting,
    NumericalError,
    StageError,
    StorageError,
    ToolError,
)
from ultraquiet.cli.app import app
from ultraquiet.cli.exits.codes import EPILOG, ExitCode, exit_code
from ultraquiet.deploy.toolchain.compiler import compiler
from ultraquiet.design.result import DesignResult
from ultraquiet.experiments import StoppedError
from ultraquiet.values import Status, StatusWord

DOCS = Path(__file__).parents[2] / "docs" / "exit-codes.md"
RATE_HZ = 1000.0
COMMANDS = sorted(typer.main.get_command(app).commands)

DYING = """\
import sys
for line in sys.stdin:
    word = line.split()[0]
    if word == "hello":
        print("ultraquiet-plant 1\\nrate 1000\\nactuator V -10 10 force\\nsensor V -10 10 speed\\nready", flush=True)
    elif word == "step":
        sys.exit(3)
    else:
        print("ok", flush=True)
"""
LIST = """\
[bench]
method = "process"
command = {command}
[[commands]]
do = "excite"
name = "push"
actuator = 1
samples = 50
signal = {{ method = "tone", frequency_hz = 100.0, amplitude_v = 1.0 }}
"""
SIMULATED = """\
[bench]
method = "hexapod"
[[commands]]
do = "excite"
name = "push"
actuator = 1
samples = 50
signal = { method = "tone", frequency_hz = 100.0, amplitude_v = 1.0 }
"""


@dataclass(frozen=True)
class Verdict:
    """A design method that says what the test wants said, and leaves its law."""

    word: str = "ok"
    law: bool = True

    def design(self, plant):
        K = uq.StateSpace([[0.5]], [[0.1]], [[0.1]], [[0.0]], plant.rate_hz)
        return DesignResult(Status(self.word, "As the test wants it."), K if self.law else None)


@pytest.fixture
def folder(tmp_path, rng, monkeypatch):
    """Small files for every command: good ones, and ones whose result is not ok."""
    u = rng.standard_normal((1, 1500))
    y = np.zeros((1, 1500))
    for k in range(1, 1500):
        y[0, k] = 0.8 * y[0, k - 1] + 0.5 * u[0, k - 1] + 0.1 * rng.standard_normal()
    uq.files.save(uq.Record(u, y, RATE_HZ), tmp_path / "record.h5")
    for name, pole in (("good", 0.8), ("bad", 0.2)):
        model = uq.PolynomialModel(a=[1.0, -pole], b=[[0.0, 0.5]], f=[[1.0]], rate_hz=RATE_HZ)
        uq.files.save(uq.PolynomialMatrix([[model]]), tmp_path / f"{name}-model.h5")
    uq.files.save(uq.StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ), tmp_path / "plant.h5")
    uq.files.save(uq.StateSpace([[0.9]], [[0.1]], [[0.1]], [[0.0]], RATE_HZ), tmp_path / "law.h5")
    mild = uq.StateSpace([[0.5]], [[0.1]], [[-0.1]], [[0.0]], RATE_HZ)
    uq.files.save(mild, tmp_path / "mild-law.h5")
    # Its pole lies so near the circle that float32 puts it there.
    slow = uq.StateSpace([[1.0 - 2e-9]], [[0.1]], [[0.1]], [[0.0]], RATE_HZ)
    uq.files.save(slow, tmp_path / "slow-law.h5")
    (tmp_path / "dying.py").write_text(DYING)
    (tmp_path / "dying.toml").write_text(LIST.format(command=json.dumps([sys.executable, "dying.py"])))
    (tmp_path / "list.toml").write_text(SIMULATED)
    monkeypatch.setitem(registry._table["design"], "verdict", Verdict)
    return tmp_path


# Command -> code -> words. What a command judges nothing of has no 1.
CASES = {
    "identify": {
        0: "record.h5 --method arx --order 1 --out m.h5",
        1: "record.h5 --method output-error --order 1 --out m.h5 --set delay=2",
        2: "absent.h5",
    },
    "validate": {0: "good-model.h5 record.h5", 1: "bad-model.h5 record.h5", 2: "plant.h5 absent.h5"},
    "spectra": {0: "record.h5", 2: "record.h5 --show waterfall"},
    "design": {
        0: "plant.h5 --method verdict --out K.h5",
        1: "plant.h5 --method verdict --set word=short --out K.h5",
        2: "plant.h5 --method verdict --set law=false --set word=refused --out K.h5",
    },
    "analyse": {0: "plant.h5 mild-law.h5", 1: "plant.h5 law.h5", 2: "plant.h5 absent.h5"},
    "simulate": {
        0: "mild-law.h5 --plant plant.h5 --tones 50 --duration 0.2",
        1: "law.h5 --plant plant.h5",
        2: "mild-law.h5",
    },
    "deploy": {
        0: "law.h5 --target none --steps 100 --out code",
        1: "slow-law.h5 --target none --steps 100 --form dense --out code",
        2: "absent.h5",
    },
    "convert": {0: "record.h5 record.csv", 2: "record.h5 record.xyz"},
    "inspect": {0: "record.h5", 2: "absent.h5"},
    "methods": {0: "design", 2: "cooking"},
    "doctor": {0: "", 2: "--absent"},
    "records": {0: "", 2: "nowhere"},
    "experiment": {0: "list.toml", 1: "dying.toml", 2: "absent.toml"},
    "run": {2: "absent.toml"},
    "demo": {2: "--seed -1"},
    "report": {2: "absent"},
    "campaign": {2: "absent.toml"},
    "serve": {2: "--port 70000"},
}


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("name", "code"), [(name, code) for name, cases in CASES.items() for code in cases])
def test_each_command_ends_with_its_code(run, name, code):
    if name == "deploy" and compiler() is None:
        pytest.skip("no C compiler (cc, gcc, clang) on this machine")
    ended, out, err = run(name, *CASES[name][code].split())
    print(out, err)
    assert ended == code
    assert "Traceback" not in err
    if code == ExitCode.REFUSED:
        assert err.strip()


@pytest.mark.draws(false_alarm=2e-3)  # two true models, each called wrong once in a thousand records
def test_a_state_space_is_validated_by_what_its_error_holds_of_the_inputs(run, folder, rng):
    right = uq.StateSpace([[0.8]], [[0.5]], [[1.0]], [[0.0]], RATE_HZ)
    u = rng.standard_normal((1, 1500))
    uq.files.save(uq.Record(u, right.simulate(u) + 0.5 * rng.standard_normal((1, 1500)), RATE_HZ), folder / "noisy.h5")
    near = uq.StateSpace([[0.6]], [[0.5]], [[1.0]], [[0.0]], RATE_HZ)
    forms = [uq.InnovationForm(x.A, x.B, x.C, x.D, [[0.0]], [[0.25]], RATE_HZ) for x in (right, near)]
    for name, model, word in (
        ("a", right, "ok"),
        ("b", near, "not white"),
        ("c", forms[0], "ok"),
        ("d", forms[1], "not white"),
    ):
        uq.files.save(model, folder / f"{name}.h5")
        ended, out, err = run("validate", f"{name}.h5", "noisy.h5")
        print(out, err)
        assert ended == (0 if word == "ok" else 1)
        assert out.splitlines()[-1].startswith(f"{word}: ")


def test_a_design_that_leaves_no_law_is_not_ok_or_refused_by_its_word(run, folder):
    for word, code in (("short", 1), ("refused", 2)):
        words = ("--method", "verdict", "--set", "law=false", "--set", f"word={word}", "--out", "K.h5")
        assert run("design", "plant.h5", *words)[0] == code
    assert not (folder / "K.h5").exists()


def test_a_needed_part_that_is_missing_is_not_ok(run, monkeypatch):
    monkeypatch.setattr("ultraquiet.cli.doctor.PYTHON_PARTS", ("numpy", "a-part-nobody-has"))
    code, _, err = run("doctor")
    assert (code, "a-part-nobody-has" in err) == (1, True)


@pytest.mark.parametrize("failures", [(), ("design one: refused: It cannot be.",)])
@pytest.mark.parametrize("words", [("demo",), ("run", "study.toml"), ("report", "out")])
def test_studies_end_with_one_where_a_stage_failed(run, tmp_path, monkeypatch, words, failures):
    class Walked:
        """What the command reads of a summary."""

        closed_loop, design = {}, {}
        requirements = None
        ok = not failures

    Walked.failures = failures
    suite = Path(uq.__file__).parent / "pipeline" / "suite.toml"
    (tmp_path / "study.toml").write_text(suite.read_text())
    monkeypatch.setattr("ultraquiet.pipeline.walk", lambda *_, **__: Walked)
    monkeypatch.setattr("ultraquiet.pipeline.reload_study", lambda _: uq.pipeline.packaged_study("suite"))
    code, out, _ = run(*words)
    assert code == bool(failures)
    assert all(f"failed: {sentence}" in out for sentence in failures)


@pytest.mark.parametrize("name", COMMANDS)
def test_ctrl_c_ends_every_command_alike(run, folder, monkeypatch, name):
    """Wherever it comes; a signal to a process is tried below, on what takes long."""

    def stopped(*_, **__):
        raise KeyboardInterrupt

    for place in (
        "files.load",
        "files.read_record",
        "files.survey",
        "experiments.load",
        "experiments.search",
        "pipeline.load_study",
        "pipeline.packaged_study",
        "pipeline.reload_study",
    ):
        monkeypatch.setattr(f"ultraquiet.{place}", stopped)
    monkeypatch.setattr("ultraquiet.cli.doctor.versions", stopped)
    monkeypatch.setattr("ultraquiet._base.registry.methods", stopped)
    if name == "serve":
        monkeypatch.setattr("ultraquiet.workbench.web.server.serve", stopped)
    words = {"convert": "record.h5 b.csv", "report": ".", "run": "list.toml", "demo": "", "campaign": "list.toml"}
    code, _, err = run(name, *words.get(name, CASES.get(name, {}).get(0, "")).split())
    print(err)
    assert code == 130
    assert err == "ultraquiet: stopped; finished stages and records are kept.\n"


def test_every_command_is_in_the_table_and_tells_its_codes(run):
    assert set(COMMANDS) == set(CASES), "a new command needs its cases here"
    text = DOCS.read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \| (.+?) \|$", text, re.MULTILINE))
    assert set(rows) == set(COMMANDS)
    for code in ExitCode:
        assert f"| {code.value} | {code.meaning} |" in text
    commands = typer.main.get_command(app).commands
    assert all(commands[name].epilog == EPILOG for name in COMMANDS)
    assert EPILOG in " ".join(run("records", "--help")[1].split())


def test_one_place_decides():
    good, bad = (Status(word, "So.") for word in (StatusWord.OK, StatusWord.NOT_WHITE))
    refused = Status(StatusWord.REFUSED, "No.")
    assert exit_code() == exit_code(None) == exit_code(good) == 0
    assert exit_code(good, None, bad) == 1
    assert exit_code(bad, refused) == 2
    assert exit_code(refused, KeyboardInterrupt()) == 130
    for kind, code in {
        InputError: 2,
        StorageError: 2,
        NumericalError: 1,
        BenchError: 1,
        ToolError: 1,
        StageError: 1,
    }.items():
        assert exit_code(kind("So.")) == code
    assert exit_code(StoppedError("The bench fell silent", [], asked=False)) == 1
    with pytest.raises(ZeroDivisionError):
        exit_code(ZeroDivisionError())


SIGNALLED = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
import ultraquiet as uq
import ultraquiet.{room}
real = uq.{room}.{kind}.{verb}
def told(self, *args, **kwargs):
    print("begun", flush=True)
    return real(self, *args, **kwargs)
uq.{room}.{kind}.{verb} = told
from ultraquiet.cli import main
main()
"""


def interrupted(script, words, cwd, begun, seconds=60.0, number=signal.SIGINT):
    """Start a command, wait until it is at work, send a signal; return exit code, errors and seconds until it ended.

    Ctrl-C is pressed for all its processes; a supervisor may mean the command alone, and a moment later all.
    """
    child = subprocess.Popen(
        [sys.executable, "-c", script, *map(str, words)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        end = time.monotonic() + seconds
        while not begun(child):
            assert child.poll() is None, child.communicate()
            assert time.monotonic() < end, "it does not begin"
            time.sleep(0.02)
        started = time.monotonic()
        if number != signal.SIGINT:
            os.kill(child.pid, number)
        os.killpg(child.pid, number)
        _, err = child.communicate(timeout=seconds)
        return child.returncode, err, time.monotonic() - started
    finally:
        if child.poll() is None:
            child.kill()
            child.communicate()


LONG = {
    "identify": ("identify", "BoxJenkins", "identify", "long.h5 --method box-jenkins --order 8 --out m.h5"),
    "design": ("design", "MixedSensitivity", "design", "large.h5 --method mixed-sensitivity --out K.h5"),
}


@pytest.mark.gate("identify")
@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX")
@pytest.mark.parametrize("name", LONG)
def test_a_signal_ends_what_takes_long(folder, rng, name):
    room, kind, verb, words = LONG[name]
    u = rng.standard_normal((2, 40_000))
    uq.files.save(uq.Record(u, rng.standard_normal((2, 40_000)), RATE_HZ), folder / "long.h5")
    n = 120
    large = uq.StateSpace(
        np.diag(rng.uniform(-0.99, 0.99, n)),
        rng.standard_normal((n, 6)),
        rng.standard_normal((6, n)),
        np.zeros((6, 6)),
        RATE_HZ,
    )
    uq.files.save(large, folder / "large.h5")
    script = SIGNALLED.format(room=room, kind=kind, verb=verb)
    code, err, seconds = interrupted(script, (name, *words.split()), folder, lambda child: child.stdout.readline())
    print(f"{name} ended after {seconds:.2f} s; {err}")
    assert code == 130
    assert "stopped" in err
    assert "Traceback" not in err
    assert not (folder / words.split()[-1]).exists()


def test_a_signal_that_comes_twice_at_once_interrupts_once(monkeypatch):
    clock, handler = [100.0], Interrupting()
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    with pytest.raises(KeyboardInterrupt):
        handler(signal.SIGTERM, None)
    clock[0] += 0.5
    handler(signal.SIGHUP, None)
    clock[0] += 1.5
    with pytest.raises(KeyboardInterrupt):
        handler(signal.SIGTERM, None)


STARTING = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
class Finder:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.{name})
sys.meta_path.insert(0, Finder())
sys.argv = ["ultraquiet", "methods"]
from ultraquiet.cli import main
main()
"""


@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX")
@pytest.mark.parametrize(
    ("module", "name"),
    [
        *((module, "SIGINT") for module in ("ultraquiet.cli.app", "typer", "ultraquiet.cli.workbench", "json")),
        ("ultraquiet.cli.app", "SIGTERM"),
        ("ultraquiet.cli.workbench", "SIGHUP"),
    ],
)
def test_a_signal_ends_what_has_not_begun(module, name):
    """Ctrl-C while modules are being imported, half a second in which an impatient user may press it."""
    script = STARTING.format(module=module, name=name)
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == 130, ended.stderr
    assert ended.stderr.startswith("ultraquiet: stopped")
    assert "Traceback" not in ended.stderr


STUDY = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from ultraquiet.cli import main
main()
"""


@pytest.mark.gate("SIGTERM")
@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", pytest.param("SIGHUP", marks=pytest.mark.slow)])
def test_a_signal_ends_a_study_and_keeps_what_was_recorded(tmp_path, name):
    first, words = tmp_path / "out" / "records" / "journal.txt", ("demo", "--out", tmp_path / "out")
    code, err, seconds = interrupted(STUDY, words, tmp_path, lambda _: first.exists(), number=getattr(signal, name))
    print(f"the study ended after {seconds:.2f} s; {err[-300:]}")
    assert code == 130
    assert err.count("stopped; finished stages and records are kept") == 1
    assert "Traceback" not in err
    assert "leaked" not in err
    assert first.exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX")
def test_a_study_can_be_ended_in_every_stage_and_goes_on(tmp_path):
    """Ctrl-C a moment after each stage is done, in the next one; then it is run to its end."""
    out = tmp_path / "out"
    words = ("demo", "--quick", "--out", out)
    slowest = 0.0
    for stage in (
        "identify",
        "plant",
        "validate",
        "analyse",
        "design-lqg-ltr",
        "loop-lqg-ltr",
        "deploy-lqg-ltr",
        "deploy-quiet",
    ):
        done = out / "stages" / f"{stage}.json"
        if done.exists():
            continue
        code, err, seconds = interrupted(STUDY, words, tmp_path, lambda _, done=done: done.exists(), 600.0)
        print(f"after {stage}: exit {code}, {seconds:.2f} s")
        slowest = max(slowest, seconds)
        assert code == 130, err
        assert "Traceback" not in err
    done = subprocess.run([sys.executable, "-c", STUDY, *map(str, words)], capture_output=True, text=True, check=False)
    print(done.stdout[-2000:], f"slowest to end: {slowest:.1f} s")
    assert done.returncode == 0, done.stderr


RIG = """
import os, signal
import numpy as np
import ultraquiet as uq

def put(u):
    with open("sent.txt", "a") as sent:
        print(*u, file=sent)

def make():
    read = []

    def get():
        read.append(0)
        if len(read) == 200:
            os.kill(os.getpid(), signal.NAME)
            read.append(0)
        return np.zeros(NY)

    forces = [uq.Channel(f"u{k}", "N", -1.0, 10.0) for k in range(NU)]
    return uq.bench.Hardware(put, get, 500.0, forces, [f"y{k}" for k in range(NY)],
                             uq.bench.Interlocks(frame_s=600.0), wait=lambda: 0)
"""
EXCITED = """
[[commands]]
do = "excite"
name = "rough"
actuator = "all"
samples = 600
signal = { method = "noise", peak = 0.5 }
"""
OF_THE_RIG = """
[study]
title = "The rig"
[bench]
object = "rig.py:make"
[experiment]
list = "list.toml"
[plant]
method = "rational"
records = ["rough"]
[controllers.calm.design]
method = "lqg"
"""


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGQUIT", "SIGINT"])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (4, 3), (3, 5)])
def test_a_signal_that_comes_while_a_bench_s_own_file_is_at_work_is_not_of_that_file(run, tmp_path, nu, ny, name):
    (tmp_path / "rig.py").write_text(RIG.replace("NAME", name).replace("NU", str(nu)).replace("NY", str(ny)))
    (tmp_path / "list.toml").write_text(EXCITED)
    (tmp_path / "study.toml").write_text(OF_THE_RIG)
    number = getattr(signal, name)
    usual = {"SIGINT": signal.default_int_handler, "SIGQUIT": signal.SIG_DFL}  # the command line leaves these
    before = signal.signal(number, usual.get(name, Interrupting()))
    try:
        code, _, err = run("run", "study.toml")
    finally:
        signal.signal(number, before)
    print(code, err)
    assert code == 130
    assert "ultraquiet: stopped; finished stages and records are kept." in err
    assert "rig.py" not in err
    assert set((tmp_path / "sent.txt").read_text().splitlines()[-1].split()) == {"0.0"}
