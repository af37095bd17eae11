"""`ultraquiet spectra` on files: every kind of result, its averaging in words and in the picture."""

import re

import numpy as np
import pytest

from ultraquiet import files, spectra
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
    code, printed, err = run("spectra", record, "--show", show, "--segment", 2048, "--out", picture, *words)
    print(printed, err)
    assert code == 0
    assert AVERAGING in printed
    drawn = re.sub(r"<[^>]+>", " ", picture.read_text())
    assert AVERAGING in re.sub(r"\s+", " ", drawn)


def test_the_figures_are_right(run, record):
    printed = run("spectra", record, "--show", "transmissibility", "--base", "base z", "--payload", "payload z")[1]
    assert -20.1 < float(re.search(r"  (-\d+\.\d+) dB", printed)[1]) < -19.8
    printed = run("spectra", record, "--show", "octaves", "--segment", 4096)[1]
    # 5 µm/s over 250 Hz leaves 1.36 µm/s in the octave third at 80 Hz; the base has ten times that.
    assert "payload z meets VC-F" in printed
    assert "base z meets VC-B" in printed


def test_sensitivity_turns_volts_into_velocity(run, rng, tmp_path):
    path = tmp_path / "volts.h5"
    files.save(Record(np.zeros((1, 2**15)), 100 * 5e-6 * rng.standard_normal((1, 2**15)), RATE), path)
    code, printed, _ = run(
        "spectra", path, "--show", "octaves", "--segment", 4096, "--unit", "m/s", "--sensitivity", 100
    )
    assert code == 0
    assert "meets VC-F" in printed


def test_without_a_velocity_the_levels_are_shown_and_the_criteria_are_not(run, rng, tmp_path):
    path = tmp_path / "volts.h5"
    files.save(Record(np.zeros((1, 2**13)), rng.standard_normal((1, 2**13)), RATE, sensors=[Channel("a", "V")]), path)
    code, printed, _ = run("spectra", path, "--show", "octaves")
    assert (code, "no vibration criterion: channel 'a' is in V" in printed) == (0, True)
    scaled = ("--unit", "m/s", "--sensitivity", 1, "--segment", 256)
    code, printed, _ = run("spectra", path, "--show", "octaves", *scaled)
    assert (code, "cover no criterion; they need 4 to 80 Hz" in printed) == (0, True)


@pytest.mark.parametrize(
    ("stated", "asked", "agree"),
    [("um", "mm/s", False), ("um", "µm", True), ("m/s^2", "m/s²", True), ("", "mm/s", True), ("V", "mV", False)],
)
def test_a_unit_that_contradicts_the_files_own_is_refused(run, rng, tmp_path, stated, asked, agree):
    path = tmp_path / "run.h5"
    sensors = [Channel("free"), Channel("place", stated)]
    files.save(Record(np.zeros((1, 2**10)), rng.standard_normal((2, 2**10)), RATE, sensors=sensors), path)
    code, printed, err = run("spectra", path, "--unit", asked)
    print(err)
    if agree:
        assert code == 0
        assert printed.count(f" {asked} ") >= 2
    else:
        assert code == 2
        assert f"'place' is recorded in {stated}, which '--unit {asked}' contradicts" in err
        assert run("spectra", path, "--unit", asked, "--sensitivity", 1000)[0] == 0


def test_a_dozen_channels_can_be_read_in_a_narrow_terminal(run, rng, tmp_path, monkeypatch):
    path = tmp_path / "many.h5"
    sensors = [Channel(f"geophone {k}", "m/s") for k in range(12)]
    files.save(Record(np.zeros((1, 2**12)), rng.standard_normal((12, 2**12)), RATE, sensors=sensors), path)
    monkeypatch.setenv("COLUMNS", "80")
    printed = run("spectra", path, "--show", "octaves", "--out", tmp_path / "many.svg")[1]
    assert "…" not in printed
    assert all(f"geophone {k}" in printed for k in range(12))


def test_noise_beyond_the_excitation_is_no_largest_gain(run, rng, tmp_path):
    """An input of 20 Hz width; above it the output holds noise alone, and their quotient is beyond all measure."""
    from scipy.signal import butter, sosfilt

    u = sosfilt(butter(8, 20.0, fs=RATE, output="sos"), rng.standard_normal(2**15))
    y = 2.0 * u + 1e-3 * rng.standard_normal(2**15)
    path = tmp_path / "narrow.h5"
    files.save(Record([u], [y], RATE, ["drive"], ["arm"]), path)
    printed = run("spectra", path, "--show", "response", "--segment", 1024)[1]
    gain_db, at_hz = map(float, re.search(r"  (-?\d+\.\d+) dB +\S+ +(\S+) Hz", printed).groups())
    found = spectra.frf(files.read_record(path), segment_samples=1024).magnitude_db.max()
    print(f"largest trusted gain {gain_db} dB at {at_hz} Hz, 6.02 dB true; the largest of all would be {found:.1f} dB")
    assert gain_db < 9.1  # a coherence of one half leaves the gain within its own size
    assert 0.0 < at_hz < 60.0
    assert found > 20.0


def test_channels_by_a_mapping(run, rng, tmp_path):
    np.savetxt(tmp_path / "run.txt", rng.standard_normal((4096, 3)))
    text = 'rate_hz = 500.0\n[[inputs]]\ncolumn = 1\n[[outputs]]\ncolumn = 3\nname = "arm"\nunit = "g"\nscale = 2.0\n'
    (tmp_path / "map.toml").write_text(text)
    code, printed, err = run("spectra", tmp_path / "run.txt", "--mapping", tmp_path / "map.toml")
    assert code == 0, err
    rms = float(re.search(r"arm +(\S+) g", printed)[1])
    assert rms == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--show", "waterfall"], "must be one of 'density'"),
        (["--show", "transmissibility"], "needs '--base' and '--payload', sensors among base z, payload z"),
        (["--sensitivity", "3"], "needs '--unit'"),
        (["--segment", "100000"], "does not fit into 65536 samples"),
        (["--show", "octaves", "--quantity", "acceleration"], "is in m/s, which is no acceleration"),
        (["--show", "octaves", "--fraction", "0"], "'fraction' must be between 1 and 24, got 0"),
        (["--out", "absent/picture.svg"], "there is no folder 'absent' for 'picture.svg'"),
        (["--out", "picture.jpg"], "'--out' must end in .svg or .png"),
    ],
)
def test_bad_words_are_one_sentence(run, record, words, sentence):
    code, _, err = run("spectra", record, *words)
    assert code == 2
    assert sentence in err
    assert err.count("\n") == 1
