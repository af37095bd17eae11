"""`convert` and `inspect`, as a user calls them."""

from pathlib import Path

import numpy as np
import pytest

from ultraquiet import files
from ultraquiet.values import Channel, Record

DATA = Path(__file__).parents[1] / "data"


def test_convert_with_a_mapping(run, tmp_path):
    (tmp_path / "map.toml").write_text(
        'rate_hz = 2048\n[[inputs]]\ncolumn = "1-2"\nunit = "V"\n'
        '[[outputs]]\ncolumn = 3\nname = "radial"\nunit = "µm"\n'
    )
    source = DATA / "daisy" / "CD_player_arm.dat"
    code, said, _ = run("convert", source, "arm.uff", "--mapping", "map.toml")
    print(said)
    assert code == 0
    assert "2 inputs and 1 output, 2048 samples at 2048 Hz" in said
    record = files.read_record(tmp_path / "arm.uff")
    assert record.sensors == (Channel("radial", "µm"),)
    assert np.array_equal(record.outputs[0], np.loadtxt(source)[:, 2])
    code, _, told = run("convert", source, "arm.uff", "--mapping", "map.toml")
    assert code == 2
    assert "exists already" in told
    assert run("convert", "arm.uff", "arm.csv", "--force")[0] == 0
    assert files.read_record(tmp_path / "arm.csv").hash == record.hash


def test_convert_refuses(run, tmp_path):
    source = DATA / "daisy" / "CD_player_arm.dat"
    (tmp_path / "map.toml").write_text('crop_s = 3\n[[inputs]]\ncolumn = "1"\n[[outputs]]\nname = "x"\n')
    code, _, told = run("convert", source, "arm.mat", "--mapping", "map.toml")
    print(told)
    assert code == 2
    assert "2 mistakes" in told
    for line in ("line 1: 'crop_s'", "line 4: 'column' is missing"):
        assert line in told
    code, _, told = run("convert", source, "arm.mat", "--inputs", "1-2", "--outputs", "3-4")
    assert (code, "states no sampling rate" in told) == (2, True)
    code, _, told = run("convert", source, "arm.wav", "--inputs", "1-2", "--outputs", "3-4", "--rate-hz", "2048")
    assert (code, "read only" in told) == (2, True)
    assert [path.name for path in tmp_path.iterdir()] == ["map.toml"]


def test_identify_and_validate_take_a_mapping(run, tmp_path, rng):
    """The same record by a mapping and by names: the same model and the same judgement, in the units of the mapping."""
    u = rng.standard_normal(2000)
    y = np.zeros(2000)
    for k in range(1, 2000):
        y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1] + 0.01 * rng.standard_normal()
    np.savetxt(tmp_path / "raw.txt", np.column_stack([y, u]))
    files.export_record(
        Record(u, 1000 * y, 250.0, [Channel("force", "N")], [Channel("arm", "mm")]), tmp_path / "told.csv"
    )
    (tmp_path / "map.toml").write_text(
        'rate_hz = 250\n[[inputs]]\ncolumn = 2\nname = "force"\nunit = "N"\n'
        '[[outputs]]\ncolumn = 1\nname = "arm"\nunit = "mm"\nscale = 1000.0\n'
    )
    models = []
    for source, words in (
        ("raw.txt", ["--mapping", "map.toml"]),
        ("told.csv", ["--inputs", "force", "--outputs", "arm"]),
    ):
        code, said, err = run("identify", source, "--method", "arx", "--order", 1, "--out", f"{source}.h5", *words)
        assert code == 0, err
        assert "mm²" in said
        models.append(files.load(tmp_path / f"{source}.h5"))
        code, said, err = run("validate", f"{source}.h5", source, *words)
        assert code == 0, err
    gains = [model.state_space().frequency_response(np.array([1.0]))[0, 0, 0] for model in models]
    print(f"gain at 1 Hz {abs(gains[0]):.6g} mm/N by mapping, {abs(gains[1]):.6g} by names")
    assert gains[0] == pytest.approx(gains[1], rel=1e-6)
    code, _, err = run("identify", "raw.txt", "--mapping", "map.toml", "--inputs", "1")
    assert (code, "a mapping says what goes in and out" in err) == (2, True)
    code, _, err = run("identify", "raw.txt", "--mapping", "absent.toml")
    assert (code, "'absent.toml' cannot be read" in err) == (2, True)


def test_convert_a_response(run, tmp_path):
    source = DATA / "kagra" / "BS_TML_exc_20200730a_frf.npz"
    code, said, _ = run("convert", source, "bs.uff", "--response", "--conjugated")
    assert (code, "1 input and 12 outputs at 1281 frequencies" in said) == (0, True)
    assert files.read_frf(tmp_path / "bs.uff").coherence is not None


def test_inspect(run, tmp_path, rng):
    y = np.clip(3 * rng.standard_normal((2, 1000)), -4, 4)
    record = Record(
        rng.standard_normal((1, 1000)), y, 3500.0, ["drive"], [Channel("limited", "V", -4, 4), Channel("x")]
    )
    clipped = int(np.count_nonzero(np.abs(y[0]) >= 4))
    files.save(record, tmp_path / "run.h5")
    code, said, _ = run("inspect", "run.h5")
    print(said)
    assert code == 0
    assert f"{clipped}" in next(line for line in said.splitlines() if "limited" in line).split()
    assert "3500 Hz, 0.285714 s" in said
    text = "time,u,y\n" + "".join(
        f"{k * 0.01 + (0.3 if k > 4 else 0)},{k},{'nan' if k == 2 else k}\n" for k in range(9)
    )
    (tmp_path / "gap.csv").write_text(text)
    code, said, _ = run("inspect", "gap.csv")
    print(said)
    assert "note: 'y' has 1 NaN" in said
    assert "is not evenly sampled: sample 5" in said
    (tmp_path / "no.wav").write_bytes(b"RIFF")
    assert run("inspect", "no.wav")[0] == 2


def test_inspect_finds_flat_tops_without_limits(tmp_path):
    """A sine beyond its converter: as many samples as lie above its limit."""
    sine = np.sin(2 * np.pi * 0.01 * np.arange(1000))
    np.savez(tmp_path / "a.npz", u=np.clip(sine, -0.8, 0.8), y=sine, fs=100.0)
    looks = {c.name: c for c in files.survey(tmp_path / "a.npz").channels}
    assert looks["u"].clipped == np.count_nonzero(np.abs(sine) >= 0.8)
    assert looks["y"].clipped == 0
