"""What every command prints: whole at 60 columns and in a pipe, as JSON, or nothing; brackets are words."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import typer.main

import ultraquiet as uq
from ultraquiet.cli.app import COMMANDS, app
from ultraquiet.cli.output.text_table import TextTable

BOX = re.compile("[\u2500-\u257f\u2026]")
RATE = 1000.0


@pytest.fixture
def files(tmp_path, rng):
    u = rng.standard_normal((1, 2000))
    plant = uq.StateSpace([[0.8]], [[0.5]], [[1.0]], [[0.0]], RATE, [uq.Channel("coil [1]", "N")], ["geo [2]"])
    y = plant.simulate(u) + 0.01 * rng.standard_normal((1, 2000))
    record = uq.Record(u, y, RATE, plant.actuators, [uq.Channel("geo [2]", "m/s")])
    law = uq.StateSpace([[0.5]], [[0.1]], [[-0.1]], [[0.0]], RATE)
    for name, value in (("record", record), ("plant", plant), ("law", law)):
        uq.files.save(value, tmp_path / f"{name}.h5")
    return tmp_path


WORDS = {
    "records": ".",
    "identify": "record.h5 --method arx --order 1 --out m.h5 --force",
    "validate": "plant.h5 record.h5",
    "spectra": "record.h5 --show response",
    "design": "plant.h5 --method lqg --out K.h5 --force",
    "analyse": "plant.h5 law.h5",
    "simulate": "law.h5 --plant plant.h5 --tones 50 --duration 0.2",
    "convert": "record.h5 record.csv --force",
    "inspect": "record.h5",
    "methods": "signals",
    "doctor": "",
}


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("name", WORDS)
def test_json_is_one_value_and_quiet_is_silence(run, name):
    words = WORDS[name].split()
    code, out, _ = run(name, *words, "--json")
    json.loads(out, parse_constant=pytest.fail)
    assert run(name, *words, "--quiet")[:2] == (code, "")


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("name", WORDS)
def test_sixty_columns_and_a_pipe_lose_nothing(run, monkeypatch, name):
    monkeypatch.delenv("COLUMNS")
    whole = run(name, *WORDS[name].split())[1]
    monkeypatch.setenv("COLUMNS", "60")
    narrow = run(name, *WORDS[name].split())[1]
    for out in (whole, narrow):
        assert not BOX.search(out), out
        assert "\x1b" not in out
    if name in ("records", "doctor"):  # what was written meanwhile; an interpreter's path
        return
    assert letters(whole) == letters(narrow)


def letters(out):
    """Every printed character but blanks and the heads of columns, which a narrow table repeats."""
    return set(re.findall(r"\w", out)), len(out) > 0


def test_a_bracket_in_a_name_is_a_bracket(run, files):
    assert "geo [2]" in run("identify", *WORDS["identify"].split())[1]
    assert "coil [1]" in run("spectra", *WORDS["spectra"].split())[1]
    assert "geo [2]" in run("inspect", "record.h5")[1]


def test_squares_are_squares(run, files):
    assert re.search(r" \(m/s\)²\n", run("identify", *WORDS["identify"].split())[1])
    assert "(m/s)²/Hz" in run("spectra", "record.h5")[1]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_keeps_its_brackets_and_every_option(run, name):
    for flag in ("-h", "--help"):
        code, out, _ = run(name, flag)
        assert code == 0
        assert not BOX.search(out)
    options = [p for p in typer.main.get_command(app).commands[name].params if getattr(p, "help", None)]
    flat = " ".join(out.split())
    for option in options:
        assert option.help in flat, option.name
    assert {"--json", "--quiet"} <= set(re.findall(r"--\w+", out))


def test_version_and_completion(run):
    code, out, _ = run("--version")
    assert (code, out) == (0, f"ultraquiet {uq.__version__}\n")
    assert re.fullmatch(r"ultraquiet \d+\.\d+\.\d+\S*\n", out)
    assert "--install-completion" in run("-h")[1]


def test_python_runs_the_package():
    words = [sys.executable, "-m", "ultraquiet", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"ultraquiet {uq.__version__}\n", "")


PROGRAM = "import sys; sys.argv[0] = 'ultraquiet'; from ultraquiet.cli import main; main()"


@pytest.mark.parametrize(
    ("words", "offered"),
    [("ultraquiet ana", "analyse"), ("ultraquiet design plant.h5 --method lq", "lqg")],
)
def test_the_shell_completes_commands_and_methods(words, offered):
    asked = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1), "_ULTRAQUIET_COMPLETE": "complete_bash"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env={**os.environ, **asked}, capture_output=True, text=True, check=False
    )
    assert offered in done.stdout.split(), done


def test_a_table_too_wide_for_its_terminal_is_told_cell_by_cell():
    table = TextTable(("sensor", "one", "two", "three"), "a title of more than twenty letters")
    table.add("geophone [1]", "1.5 dB", "3 Hz", "-")
    table.add("geophone [2]", "-0.25 dB", "30 Hz", "a long sentence that is folded")
    for width in (20, 40, 60, 200):
        lines = table.lines(width)
        print("\n".join(lines))
        assert max(map(len, lines)) <= width
        text = " ".join(" ".join(lines).split())
        for word in ("geophone", "[1]", "[2]", "1.5 dB", "-0.25 dB", "30 Hz", "sentence", "folded"):
            assert word in text
    assert len(table.lines()) == 4


def test_a_number_of_a_run_makes_other_noise(rng):
    """A reset that takes the run's number gets it; one that takes nothing is called as ever."""
    seen = []

    def noisy(step_of):
        state = {}

        def reset(run_index):
            seen.append(run_index)
            state["rng"] = np.random.default_rng(run_index)

        return uq.bench.Wrapped(lambda u, d: state["rng"].standard_normal(1), reset, RATE, ["u"], ["y"])

    bench = noisy(None)
    first, second = (bench.run(np.zeros((1, 20))).outputs for _ in range(2))
    assert not np.array_equal(first, second)
    assert np.array_equal(bench.run(np.zeros((1, 20)), run_index=0).outputs, first)
    assert seen == [0, 1, 0]
    calls = []
    plain = uq.bench.Wrapped(lambda u, d: [0.0], lambda: calls.append(1), RATE, ["u"], ["y"])
    default = uq.bench.Wrapped(lambda u, d: [0.0], lambda gain=1.0: calls.append(gain), RATE, ["u"], ["y"])
    named = uq.bench.Wrapped(lambda u, d: [0.0], lambda run_index=7: calls.append(run_index), RATE, ["u"], ["y"])
    for each in (plain, default, named):
        each.run(np.zeros((1, 5)), run_index=3)
    assert calls == [1, 1.0, 3]


@pytest.mark.parametrize("method", ["output-error", "arx", "subspace"])
def test_order_auto_finds_the_order_of_the_truth(run, tmp_path, rng, method):
    from scipy.signal import lfilter

    z = 0.95 * np.exp(0.3j)
    plant = uq.StateSpace(
        [[z.real, z.imag], [-z.imag, z.real]], [[1.0, 0.2], [0.0, 0.5]], [[1.0, 0.0]], [[0.0, 0.0]], RATE
    )
    u = rng.standard_normal((2, 3000))
    noise = 0.05 if method != "arx" else 0.0
    y = plant.simulate(u)
    e = rng.standard_normal(y.shape)
    if method == "arx":  # an equation error, which is what ARX is for
        y = y + 0.02 * lfilter([1.0], np.poly([z, z.conjugate()]).real, e)
    uq.files.save(uq.Record(u, y + noise * e, RATE), tmp_path / "two.h5")
    words = () if method != "subspace" else ("--set", "feedthrough=false")
    words = ("--method", method, "--order", "auto", "--hold-out", "0.3", "--out", "m.h5", "--json", *words)
    code, out, err = run("identify", "two.h5", *words)
    said = json.loads(out)
    print(said["order"], said["status"])
    assert code in (0, 1), err
    assert 2 <= said["order"] <= 3
    assert min(said["held_out_fit_percent"].values()) > 90
    told = run("identify", "two.h5", *(word for word in words if word != "--json"), "--force")[1]
    assert f"{method} of order {said['order']} from" in told


def test_a_clock_is_not_contradicted(run, tmp_path, rng):
    t = np.arange(400) / RATE
    rows = np.column_stack([t, rng.standard_normal((400, 2))])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="time,u,y", comments="")
    words = ("--method", "arx", "--order", "1", "--out", "m.h5", "--force")
    code, _, err = run("identify", "run.csv", *words, "--rate", "500")
    print(err)
    assert (code, "1000 Hz" in err, "500 Hz" in err) == (2, True, True)
    assert not (tmp_path / "m.h5").exists()
    for command in (("inspect", "run.csv"), ("convert", "run.csv", "a.h5"), ("spectra", "run.csv")):
        assert run(*command, "--rate", "500")[0] == 2, command
    assert run("identify", "run.csv", *words, "--rate", "1000.01")[0] in (0, 1)  # the same clock, rounded


def test_peaks_lie_where_there_was_excitation(run, tmp_path, rng):
    """Mains hum in command and reading alike is coherent, and no excitation."""
    from scipy.signal import butter, sosfilt

    n = 2**15
    t = np.arange(n) / RATE
    u = sosfilt(butter(8, 40.0, fs=RATE, output="sos"), rng.standard_normal(n))
    hum = np.sin(2 * np.pi * 250.0 * t)
    y = 2.0 * u + 10.0 * hum + 1e-3 * rng.standard_normal(n)
    wires = [uq.Channel("push", "N")], [uq.Channel("speed", "m/s")]
    uq.files.save(uq.Record([u + 1e-5 * hum], [y], RATE, *wires), tmp_path / "hum.h5")
    out = run("spectra", "hum.h5", "--show", "response", "--segment", "1024", "--json")[1]
    (row,) = json.loads(out)["rows"]
    print(row)
    assert float(row["at"].split()[0]) < 100.0
    assert abs(float(row["largest gain"].split()[0]) - 6.02) < 1.0
    assert row["re"] == "(m/s)/N"
