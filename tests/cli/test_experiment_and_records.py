"""`ultraquiet experiment` and `ultraquiet records`, as a user in a laboratory meets them."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from ultraquiet import experiments, files
from ultraquiet.cli.experiment.watch import Board, PlainLines, Steady, watching
from ultraquiet.experiments import journal

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "campaign.toml"

LIST = """\
title = "three short ones"
[bench]
method = "hexapod"
[[commands]]
do = "configure"
samples = 400
[[commands]]
do = "excite"
name = "loud"
actuator = 2
signal = { method = "tone", frequency_hz = 60.0, amplitude_v = 25.0 }
[[commands]]
do = "wait"
seconds = 3600.0
[[commands]]
do = "excite"
name = "low"
actuator = "strut 3"
comment = "hardly there"
signal = { method = "tone", frequency_hz = 60.0, amplitude_v = 0.01 }
[[commands]]
do = "record"
name = "quiet"
"""


@pytest.fixture(autouse=True)
def listed(run, tmp_path):
    (tmp_path / "short.toml").write_text(LIST)


def test_a_dry_run_shows_every_step_and_touches_nothing(run, tmp_path):
    code, out, _ = run("experiment", "short.toml", "--dry-run")
    print(out)
    assert code == 0
    for row in (
        r"7 +0.00 s +0.11 s +excite loud +strut 2: tone, peak 25 V, RMS 18 V, 43.75-122.5 Hz +off",
        r"12 +0.11 s +3600.00 s +wait",
        r"excite low +strut 3: tone, peak 0.01 V",
        r"3600.23 s +0.11 s +record quiet",
        r"3 records, 3600.3 s on the bench, 3600.0 s of them waits \(simulated: .*\), at most \d+\.\d MB on the disk",
    ):
        assert re.search(row, out), row
    assert [p.name for p in tmp_path.iterdir()] == ["short.toml"]


def test_the_disk_estimate_holds(run, tmp_path):
    run("experiment", "short.toml")
    planned = experiments.dry_run(experiments.load(tmp_path / "short.toml"))
    taken = sum(p.stat().st_size for p in (tmp_path / "short").glob("*.h5"))
    print(f"estimate {planned.disk_bytes} bytes, taken {taken}")
    assert taken <= planned.disk_bytes
    assert not planned.real_time
    assert (planned.waits_s, len(planned.steps)) == (3600.0, 4)


def test_lines_in_a_pipe_tell_levels_and_warnings(run):
    code, out, err = run("experiment", "short.toml", "--out", "out")
    print(err)
    assert code == 0
    assert "3 records in out, 2 warnings" in out
    assert re.search(
        r"\[1/3\] loud +DONE +400 samples, strut 2: RMS \S+ V, peak 10 \(100 % of range\), clipped \d+", err
    )
    assert re.search(r"warning: readings clipped: strut 2 in \d+ of 400 samples", err)
    assert "wait of 3600 s skipped: a simulated bench is at rest" in err
    assert re.search(r"warning: the level is low: the loudest reading, '.*', uses 0\.\d+ % of its range", err)
    assert err.count("warning") == 2  # silence is no fault of a measurement without excitation
    assert "\x1b" not in err
    events = {(e["event"], e.get("name")): e for e in journal.entries(Path("out"))}
    assert "clipped" in events["finished", "loud"]["warnings"][0]
    assert events["finished", "quiet"]["warnings"] == []


def test_a_terminal_gets_a_table(tmp_path):
    """Drawn on a terminal of our own: a row for each sensor while it is measured, the lines above it stay."""
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=120, highlight=False)

    class Live:
        def update(self, board, refresh):
            assert refresh
            console.print(board)

    onlooker = Board(console, lambda: True, Live())  # type: ignore[arg-type]
    experiments.run(experiments.parse(LIST), tmp_path, onlooker=onlooker)
    drawn = Text.from_ansi(screen.getvalue()).plain
    print(drawn[:1500])
    assert re.search(r"\[1/3\] loud: \d+ %, 0:\d\d left, frames too late: 0; stopping, the bench goes to zero", drawn)
    assert re.search(r"strut 2 +\S+ V +\S+ V +10 V +100 % +#{20} +\d+", drawn)
    assert "warning: readings clipped" in drawn


def test_a_reader_that_has_gone_stops_nothing(tmp_path):
    class Gone(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    onlooker = PlainLines(Steady(file=Gone()), lambda: False)
    assert len(experiments.run(experiments.parse(LIST), tmp_path, onlooker=onlooker)) == 3
    with contextlib.redirect_stderr(io.StringIO()), watching(lambda: False) as chosen:
        assert type(chosen) is PlainLines


PLANT = """\
import sys, time
log = open(sys.argv[1], "w")
begun, frames = 0.0, 0
for line in sys.stdin:
    word, *rest = line.split()
    if word == "hello":
        print("ultraquiet-plant 1\\nrate 1000\\nactuator V -10 10 force\\nsensor V -10 10 speed\\nready")
    elif word == "step":
        if not frames:
            begun = time.monotonic()
        frames += 1
        time.sleep(max(0.0, begun + frames / 1000 - time.monotonic()))
        print(float(rest[0]), file=log, flush=True)
        print("y", 0.5 * float(rest[0]))
    else:
        # Every other word, at the latest the end of a run, finds the actuators at zero: docs/line-protocol.md.
        frames = 0
        print(0.0, file=log, flush=True)
        print("ok")
    sys.stdout.flush()
"""
SLOW = """\
[[commands]]
do = "excite"
name = "short"
actuator = 1
samples = 200
signal = { method = "tone", frequency_hz = 10.0, amplitude_v = 1.0 }
[[commands]]
do = "excite"
name = "long"
actuator = "force"
samples = 60000
signal = { method = "step", level_v = 8.0, rise_s = 0.0, fall_s = 59.9 }
[[commands]]
do = "wait"
seconds = 3600.0
[[commands]]
do = "record"
name = "never"
"""


def begun(out, name):
    return any(e["event"] == "begun" and e["name"] == name for e in journal.entries(out))


def in_time(condition, child, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert child.poll() is None, f"it ended before its time: {child.communicate()}"
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.02)


@pytest.fixture
def laboratory(tmp_path):
    """A bench in real time in another process, which keeps what it was sent."""
    (tmp_path / "plant.py").write_text(PLANT)
    words = [sys.executable, str(tmp_path / "plant.py"), str(tmp_path / "sent.txt")]
    bench = f'[bench]\nmethod = "process"\ncommand = {json.dumps(words)}\n'

    children = []

    def start(text, *more, ends="SIG_DFL"):
        (tmp_path / "list.toml").write_text(bench + text)
        words = ["experiment", str(tmp_path / "list.toml"), "--out", str(tmp_path / "out"), *more]
        handling = "\n".join(f"signal.signal(signal.{name}, signal.{ends})" for name in ("SIGHUP", "SIGQUIT"))
        script = f"import signal\n{handling}\nfrom ultraquiet.cli import main\nmain()"
        # A session of its own, so that a signal to all of it is what Ctrl-C in a terminal is.
        child = subprocess.Popen(
            [sys.executable, "-c", script, *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={**os.environ, "COLUMNS": "120"},
        )
        children.append(child)
        return child

    yield start
    for child in children:
        child.kill()
        child.communicate()


@pytest.mark.skipif(os.name != "posix", reason="process groups are POSIX")
@pytest.mark.gate("2")
@pytest.mark.parametrize("wish", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_ctrl_c_ramps_to_zero_and_says_where_everything_stands(laboratory, tmp_path, wish):
    """Asked twice, with 8 V on the actuator: no step of the way down is larger than the ramp's."""
    child = laboratory(SLOW)
    log, sent = tmp_path / "out" / "long.log", tmp_path / "sent.txt"
    in_time(lambda: log.exists() and sent.read_text().count("8.0") > 300, child)
    for _ in range(2):
        os.killpg(child.pid, wish) if wish is signal.SIGINT else os.kill(child.pid, wish)
        time.sleep(0.1)
    out, err = child.communicate(timeout=60)
    print(out, err)
    assert child.returncode == 130
    for name, state, file in (
        ("short", "DONE", "short.h5"),
        ("long", "ABORTED", "long.partial.h5"),
        ("never", "NOT STARTED", ""),
    ):
        assert re.search(rf"^{name} +{state} *{file}$", out, re.MULTILINE), name
    assert "Traceback" not in err
    sent = np.array([float(line) for line in (tmp_path / "sent.txt").read_text().split()])
    down = sent[np.flatnonzero(sent == 8.0)[-1] :]
    largest = float(np.abs(np.diff(down)).max())
    print(f"way down: {down.size - 1} samples, largest step {largest:.4f} V, ends at {down[-1]:g} V")
    assert down[-1] == 0.0
    assert largest <= 8.0 / 100 + 1e-12  # a tenth of a second at 1 kHz
    kept = files.read_record(tmp_path / "out" / "long.partial.h5")
    assert kept.samples < 60000
    assert kept.provenance.settings["partial"]["of"] == 60000
    rows = {e.name: (e.status, e.file) for e in experiments.find(tmp_path / "out")}
    assert rows["long"] == ("ABORTED", "long.partial.h5")
    assert rows["never"] == ("NOT STARTED", "")


ASKED_AGAIN = """
import atexit, os, signal, sys
from ultraquiet.cli.experiment.halt import halting
signal.signal(signal.{name}, signal.{usual})
ask = lambda: os.kill(os.getpid(), signal.{name})
with halting(ends_program=True):
    {asked}
atexit.register(ask)
ask()
sys.exit(130)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals to processes are POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_a_program_that_is_on_its_way_out_is_not_ended_by_the_same_wish_again(name):
    """Nor while Python takes itself apart; before the first wish a signal is what it was."""
    usual = "default_int_handler" if name == "SIGINT" else "SIG_DFL"

    def ended(asked):
        words = [sys.executable, "-c", ASKED_AGAIN.format(name=name, usual=usual, asked=asked)]
        return subprocess.run(words, capture_output=True, text=True, check=False)

    twice = ended("ask()")
    assert (twice.returncode, twice.stderr) == (130, "")
    assert ended("pass").returncode == -getattr(signal, name)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals to processes are POSIX")
def test_under_nohup_a_run_outlives_its_terminal(laboratory, tmp_path):
    child = laboratory(SLOW, ends="SIG_IGN")
    log, sent = tmp_path / "out" / "long.log", tmp_path / "sent.txt"
    in_time(log.exists, child)
    for number in (signal.SIGHUP, signal.SIGQUIT):
        os.kill(child.pid, number)
    before = sent.read_text().count("\n")
    in_time(lambda: sent.read_text().count("\n") > before + 2000, child)  # several ramps later
    child.terminate()
    out, err = child.communicate(timeout=60)
    assert child.returncode == 130, err
    assert re.search(r"long +ABORTED", out)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals to processes are POSIX")
def test_a_wait_in_real_time_is_waited_for_and_can_be_ended(laboratory, tmp_path):
    """And --resume then asks by name before it excites again what was begun, and goes on with what never began."""
    child = laboratory(SLOW.replace("60000", "100").replace("59.9", "0.05"))
    in_time((tmp_path / "out" / "long.h5").exists, child)
    time.sleep(0.5)
    assert child.poll() is None
    assert not begun(tmp_path / "out", "never")
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=30)
    assert child.returncode == 130, err
    assert re.search(r"never +NOT STARTED", out)
    child = laboratory(SLOW.replace("60000", "100").replace("59.9", "0.05").replace("3600.0", "0.3"), "--resume")
    out, err = child.communicate(timeout=30)
    print(out, err)
    assert child.returncode == 0
    assert "2 records are there already and kept; 1 to go" in err
    assert "3 records" in out


def test_resume_repeats_what_was_broken_off_only_by_name(run, tmp_path):
    run("experiment", "short.toml")
    (tmp_path / "short" / "low.h5").unlink()
    code, out, err = run("experiment", "short.toml", "--resume")
    print(out, err)
    assert code == 2
    assert "low in 'short' was begun before and left no record" in err
    assert re.search(r"low +ABORTED", out)
    assert re.search(r"quiet +DONE +quiet.h5", out)
    code, out, err = run("experiment", "short.toml", "--resume", "--repeat", "low")
    assert (code, "3 records" in out, "2 records are there already" in err) == (0, True, True)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["absent.toml"], "'absent.toml' cannot be read (no such file or directory)"),
        (["."], "'.' cannot be read (is a directory)"),
        (["bytes.toml"], "'bytes.toml' cannot be read"),
        (["short.toml", "--out", os.devnull], f"the folder '{os.devnull}' cannot be made"),
        (["short.toml", "--repeat", "never"], "has no measurement 'never' to repeat"),
    ],
)
def test_bad_words_are_one_sentence(run, tmp_path, words, sentence):
    (tmp_path / "bytes.toml").write_bytes(b"\xb6\x00")
    code, _, err = run("experiment", *words)
    print(err)
    assert (code, err.count("\n")) == (2, 1)
    assert sentence in err
    assert "Errno" not in err


def test_records_are_found_on_the_command_line(run, tmp_path, monkeypatch):
    run("experiment", "short.toml")
    code, out, _ = run("records")
    print(out)
    assert code == 0
    assert "3 runs" in out
    assert re.search(r"loud +DONE +hexapod +tone 2 +400 +\d+ +0 +- +short/loud.h5", out)
    assert out.count("three short ones") == 3
    monkeypatch.setenv("COLUMNS", "80")
    narrow = run("records")[1]
    print(narrow)
    assert "…" not in narrow
    assert max(map(len, narrow.splitlines())) <= 80
    assert "hardly there" in out
    code, out, _ = run("records", "short", "--what", "hardly", "--json")
    (row,) = json.loads(out)
    assert (row["name"], row["status"], row["actuators"], row["samples"]) == ("low", "DONE", "3", 400)
    for words, count in (
        (("--status", "done"), 3),
        (("--status", "aborted"), 0),
        (("--bench", "hexapod", "--list", "short ones"), 3),
        (("--since", "2999-01-01"), 0),
    ):
        assert f"{count} runs" in run("records", *words)[1], words
    assert "\n1 run\n" in run("records", "--what", "QUIET")[1]
    (tmp_path / "catalogue.sqlite").write_bytes(b"damaged" * 1000)
    assert "3 runs" in run("records")[1]
    assert "3 runs" in run("records", "--rebuild")[1]
    code, _, err = run("records", "--since", "tomorrow")
    assert (code, "'tomorrow' is no time" in err) == (2, True)
    code, _, err = run("records", "nowhere")
    assert (code, "'nowhere' is no folder" in err) == (2, True)
