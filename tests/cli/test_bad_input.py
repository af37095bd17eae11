"""Bad input: one sentence that names the culprit, exit code 2, nothing written over."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.lines import line_numbers


def record(rng, n=400, **changes):
    u = rng.standard_normal((1, n))
    y = np.stack([np.convolve(u[0], [0.0, 1.0, 0.5])[:n]]) + 0.01 * rng.standard_normal((1, n))
    return {"inputs": u, "outputs": y, "rate_hz": np.array(100.0)} | changes


def put(folder, arrays):
    path = folder / "record.npz"
    np.savez(path, **arrays)
    return path


def with_nan(arrays):
    y = arrays["outputs"].copy()
    y[0, 7] = np.nan
    return arrays | {"outputs": y}


CULPRITS = {
    "NaN": (with_nan, (), "NaN"),
    "unequal lengths": (lambda a: a | {"outputs": a["outputs"][:, :-3]}, (), "400"),
    "wrong shape": (lambda a: a | {"inputs": np.zeros((2, 3, 4))}, (), "(2, 3, 4)"),
    "constant input": (lambda a: a | {"inputs": np.full((1, 400), 2.5)}, (), "constant at 2.5"),
    "too short": (lambda a: a | {k: a[k][:, :40] for k in ("inputs", "outputs")}, (), "samples"),
    "unknown method": (lambda a: a, ("--method", "box-jenkin"), "box-jenkins"),
    "unknown setting": (lambda a: a, ("--set", "ordr=3"), "ordr"),
    "method as a setting": (lambda a: a, ("--set", "method=arx"), "--method"),
    "order not whole": (lambda a: a, ("--set", "order=2.5"), "order"),
}


@pytest.mark.parametrize("culprit", CULPRITS)
def test_identify_refuses(run, tmp_path, rng, culprit):
    change, words, named = CULPRITS[culprit]
    path = put(tmp_path, change(record(rng)))
    target = tmp_path / "model.h5"
    target.write_bytes(b"mine")
    method = () if "--method" in words else ("--method", "arx")
    order = () if "order=2.5" in words else ("--order", "2")
    code, _, said = run("identify", path, *method, *order, "--out", target, "--force", *words)
    print(said)
    assert code == 2
    assert named in said
    assert target.read_bytes() == b"mine"


def test_every_setting_that_is_wrong_is_named_at_once(run, tmp_path, rng):
    path = put(tmp_path, record(rng))
    words = ("--set", "order=2.5", "--set", "dleay=1", "--set", "clipped=maybe")
    code, _, said = run("identify", path, "--method", "arx", *words)
    print(said)
    assert code == 2
    for named in ("'order'", "no setting 'dleay'; did you mean 'delay'?", "'clipped'", "3 mistakes"):
        assert named in said


# Two tests of its residual at the level of a thousandth, here and in `validate`: 14 and 2 of 4000 fits were refused.
@pytest.mark.draws(false_alarm=5e-3)
def test_a_rate_that_contradicts_is_refused(run, tmp_path, rng):
    """The record's own rate against --rate, and a model's rate against a record's."""
    held = record(rng)
    uq.files.save(uq.Record(held["inputs"], held["outputs"], 100.0), tmp_path / "a.h5")
    uq.files.save(uq.Record(held["inputs"], held["outputs"], 250.0), tmp_path / "b.h5")
    code, _, said = run("identify", "a.h5", "--method", "arx", "--order", "2", "--rate", "50", "--out", "m.h5")
    print(said)
    assert code == 2
    assert "100 Hz" in said
    assert "50 Hz" in said
    assert not (tmp_path / "m.h5").exists()
    assert run("identify", "a.h5", "--method", "arx", "--order", "2", "--out", "m.h5")[0] == 0
    assert run("validate", "m.h5", "a.h5")[0] == 0
    code, _, said = run("validate", "m.h5", "b.h5")
    print(said)
    assert code == 2
    assert "250 Hz" in said


def test_identify_does_not_write_over_a_model(run, tmp_path, rng):
    path = put(tmp_path, record(rng))
    target = tmp_path / "model.h5"
    target.write_bytes(b"mine")
    code, _, said = run("identify", path, "--method", "arx", "--order", "2", "--out", target)
    assert code == 2
    assert "model.h5" in said
    assert target.read_bytes() == b"mine"


WRONG_SETTINGS = {
    "one corner": ("band_hz=[1]", "band_hz"),
    "a number": ("band_hz=5", "band_hz"),
    "words": ("band_hz=abc", "band_hz"),
    "falling": ("band_hz=[100.0, 10.0]", "rising frequencies"),
    "beyond Nyquist": ("band_hz=[10.0, 2000.0]", "1750 Hz"),
    "a tone beyond Nyquist": ("tones_hz=[1e9]", "1750 Hz"),
}


@pytest.mark.parametrize("culprit", WRONG_SETTINGS)
def test_design_refuses_settings(run, tmp_path, culprit):
    setting, named = WRONG_SETTINGS[culprit]
    uq.files.save(uq.StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], 3500.0), tmp_path / "plant.h5")
    code, _, said = run("design", "plant.h5", "--method", "band-attenuation", "--set", setting, "--out", "law.h5")
    print(said)
    assert code == 2
    assert named in said
    assert not (tmp_path / "law.h5").exists()


def test_a_controller_of_another_rate_is_refused_by_the_bench():
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((6, 0)), np.zeros((6, 6)), rate_hz=1000.0)
    with pytest.raises(uq.errors.RateError, match="1000 Hz"):
        uq.bench.Hexapod().run(np.zeros((6, 10)), controller=law)


STUDY = """
[study]
title = "three mistakes"
[bench]
method = "hexapodd"
[plant]
method = "rational"
records = ["low"]
period = 7000
[controllers.one.design]
method = "lqg"
sensor_nois = 0.1
[closed_loop]
tones_hz = [-5.0]
"""


def test_a_study_file_tells_all_its_mistakes(run, tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    code, _, said = run("run", path)
    print(said)
    assert code == 2
    for culprit in ("hexapodd", "period", "sensor_nois", "tones_hz"):
        assert culprit in said
    assert not (tmp_path / "study").exists()


def test_ctrl_c_says_what_is_kept(run, tmp_path, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(uq.files, "load", stopped)
    code, _, said = run("deploy", tmp_path / "law.h5")
    assert code == 130
    assert "stopped" in said


def test_a_missing_file_is_named(run, tmp_path):
    code, _, said = run("run", tmp_path / "absent.toml")
    assert code == 2
    assert "absent.toml" in said


FULL_DISK = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
sys.argv = ["ultraquiet", "experiment", "suite", "--out", sys.argv[1]]
from ultraquiet.cli import main
main()
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="file-size limits are POSIX")
def test_a_full_disk_while_recording(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path / "records")], capture_output=True, text=True, check=False
    )
    print(done.stderr.splitlines()[-1])
    assert done.returncode == 2
    assert "ultraquiet:" in done.stderr
    for path in (tmp_path / "records").glob("*.h5"):
        assert uq.files.load(path).samples > 0


def test_what_a_sentence_quotes_commands_no_terminal(run, tmp_path):
    (tmp_path / "odd.csv").write_text("u,y\n1,2\n\x1b]0;owned\x07\x1b[31m\u202e,4\n5,6\n")
    code, _, err = run("convert", "odd.csv", "out.csv", "--inputs", "u", "--outputs", "y", "--rate", "100")
    assert code == 2
    assert "line 3" in err
    assert not {"\x1b", "\x07", "\u202e"} & set(err)


def test_a_name_that_no_file_has_is_a_sentence(run, tmp_path):
    (tmp_path / "study.toml").write_text(
        '[study]\ntitle = "mine"\n[records]\nfiles = ["a\\u0000b.h5"]\n[plant]\nmethod = "subspace"\norder = 2\n'
        '[controllers.quiet.design]\nmethod = "lqg"\n'
    )
    code, _, err = run("run", "study.toml", "--out", "out")
    assert code == 2
    assert "is no name of a file" in err


def test_names_out_of_an_archive_command_no_terminal(run, tmp_path):
    wires = [uq.Channel("u\x1b]0;owned\x07", "V")], [uq.Channel("y\x1b[31m", "m\x1b[2J")]
    uq.files.save(uq.Record(np.arange(50.0)[None], np.arange(50.0)[None], 100.0, *wires), tmp_path / "odd.h5")
    for words in (("inspect", "odd.h5"), ("spectra", "odd.h5"), ("convert", "odd.h5", "new.csv")):
        _, out, err = run(*words)
        assert out + err
        assert not {"\x1b", "\x07"} & set(out + err)


@pytest.mark.parametrize("text", [".".join("a" * 60_000) + " = 1", "a = " + "[" * 100_000 + "]" * 100_000])
@pytest.mark.parametrize(
    "words", ["run odd.toml --out out", "experiment odd.toml --out out", "convert odd.csv out.csv --mapping odd.toml"]
)
def test_tables_beyond_any_depth_are_a_mistake_at_once(run, tmp_path, words, text):
    (tmp_path / "odd.toml").write_text(text)
    (tmp_path / "odd.csv").write_text("u,y\n1,2\n3,4\n")
    begun = time.process_time()
    code, _, err = run(*words.split())
    print(err)
    assert code == 2
    assert "too deep inside one another" in err or "more than 64 parts" in err
    assert time.process_time() - begun < 5.0


def test_lines_are_found_in_one_walk():
    text = "".join(f"[t{k}]\nx.y = 1\n" for k in range(20_000))
    begun = time.process_time()
    assert line_numbers(text)["t19999", "x", "y"] == 40_000
    assert time.process_time() - begun < 5.0  # not with the square of the lines


def test_of_very_many_mistakes_the_first_are_told(run, tmp_path):
    (tmp_path / "odd.toml").write_text("".join(f"[t{k}]\n" for k in range(2000)) + f"[{'x' * 50_000}]\n")
    (tmp_path / "odd.csv").write_text("u,y\n1,2\n3,4\n")
    for words in ("run odd.toml --out o", "experiment odd.toml --out o", "convert odd.csv o.csv --mapping odd.toml"):
        code, _, err = run(*words.split())
        assert code == 2
        assert len(err) < 60_000
        assert "more." in err.splitlines()[-1]
