"""`ultraquiet spectra` on files: every kind of result, its averaging in words and in the picture."""

import re
import sys

import numpy as np
import pytest

from ultraquiet import files
from ultraquiet.cli.app import main
from ultraquiet.values import Channel, Record

RATE = 500.0
AVERAGING = "63 segments of 2048 samples, window hann, overlap 0.5, detrend constant, resolution 0.3662 Hz"


@pytest.fixture
def record(rng, tmp_path):
    """A base that shakes, a payload that gets a tenth of it, a command that does nothing but drive the base."""
    u = rng.standard_normal((1, 2**16))
    y = [5e-5 * u[0], 5e-6 * u[0] + 1e-8 * rng.standard_normal(2**16)]
    path = tmp_path / "run.h5"
    sensors = [Channel("base z", "m/s"), Channel("payload z", "m/s")]
    files.save(Record(u, y, RATE, ["drive"], sensors), path)
    return path


@pytest.fixture
def run(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "160")

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["ultraquiet", "spectra", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        printed = capsys.readouterr()
        return stop.value.code or 0, printed.out, printed.err

    return command


@pytest.mark.parametrize(
    ("show", "words"),
    [
        ("density", []),
        ("response", ["--estimator", "Hv"]),
        ("transmissibility", ["--base", "base z", "--payload", "payload z"]),
        ("octaves", []),
    ],
)
def test_every_kind_says_how_it_was_averaged(run, record, tmp_path, show, words):
    picture = tmp_path / "picture.svg"
    code, printed, err = run(record, "--show", show, "--segment", 2048, "--out", picture, *words)
    print(printed, err)
    assert code == 0
    assert AVERAGING in printed
    drawn = re.sub(r"<[^>]+>", " ", picture.read_text())
    assert AVERAGING in re.sub(r"\s+", " ", drawn)


def test_the_figures_are_right(run, record):
    printed = run(record, "--show", "transmissibility", "--base", "base z", "--payload", "payload z")[1]
    assert -20.1 < float(re.search(r"│\s+(-\d+\.\d+) dB", printed)[1]) < -19.8
    printed = run(record, "--show", "octaves", "--segment", 4096)[1]
    # 5 µm/s over 250 Hz leaves 1.36 µm/s in the octave third at 80 Hz; the base has ten times that.
    assert "payload z meets VC-F" in printed
    assert "base z meets VC-B" in printed


def test_sensitivity_turns_volts_into_velocity(run, rng, tmp_path):
    path = tmp_path / "volts.h5"
    files.save(Record(np.zeros((1, 2**15)), 100 * 5e-6 * rng.standard_normal((1, 2**15)), RATE), path)
    code, printed, _ = run(path, "--show", "octaves", "--segment", 4096, "--unit", "m/s", "--sensitivity", 100)
    assert code == 0
    assert "meets VC-F" in printed


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--show", "waterfall"], "must be one of 'density'"),
        (["--show", "transmissibility"], "needs '--base' and '--payload', sensors among base z, payload z"),
        (["--sensitivity", "3"], "needs '--unit'"),
        (["--segment", "100000"], "does not fit into 65536 samples"),
        (["--show", "octaves", "--quantity", "acceleration"], "is in m/s, which is no acceleration"),
    ],
)
def test_bad_words_are_one_sentence(run, record, words, sentence):
    code, _, err = run(record, *words)
    assert code == 2
    assert sentence in err
    assert err.count("\n") == 1
