"""`ultraquiet deploy` with its options for other programs."""

import numpy as np
import pytest
from deploy_laws import random_law

from ultraquiet import files
from ultraquiet.cli import main
from ultraquiet.deploy import FmuController, read_law


def called(monkeypatch, *words):
    """Run the command; return its exit code."""
    here = [] if "q31" in words else ["--target", "none"]
    monkeypatch.setattr("sys.argv", ["ultraquiet", "deploy", *map(str, words), *here, "--steps", "200"])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code or 0


@pytest.mark.usefixtures("cc")
def test_one_command_leaves_unit_coefficients_and_project(rng, tmp_path, monkeypatch, capsys):
    law = random_law(rng, 6, 1, 1)
    files.save(law, tmp_path / "law.h5")
    wanted = [tmp_path / name for name in ("law.mat", "law.csv", "law.txt")]
    asked = [word for path in wanted for word in ("--export", path)]
    unit, project = tmp_path / "law.fmu", tmp_path / "project"
    assert called(monkeypatch, tmp_path / "law.h5", "--fmu", unit, "--fmi", "2.0", *asked, "--project", project) == 0
    told = capsys.readouterr().out
    assert "FMI 2.0" in told
    f_hz = np.geomspace(1.0, 1700.0, 40)
    for path in wanted:
        found, right = (x.frequency_response(f_hz) for x in (read_law(path), law))
        assert np.abs(found - right).max() < 1e-6 * np.abs(right).max()
    assert np.isfinite(FmuController(unit).step(np.ones(1))).all()
    assert (project / "CMakeLists.txt").exists()


def test_what_could_not_be_written_stops_the_command_before_it_writes_anything(law_of, tmp_path, monkeypatch, capsys):
    files.save(law_of(6), tmp_path / "law.h5")
    for words, said in [
        (["--fmu", "law.zip"], "written as .fmu, got --fmu 'law.zip'"),
        (["--fmi", "1.0"], "'--fmi' must be one of '2.0', '3.0'"),
        (["--export", "law.xls"], "written as .mat or .h5 or .csv or .txt, got --export"),
        (["--export", "law.txt"], "this law couples its channels"),
    ]:
        assert called(monkeypatch, tmp_path / "law.h5", *words) == 2
        assert said in " ".join(capsys.readouterr().err.split())
    assert [p.name for p in tmp_path.iterdir()] == ["law.h5"]


@pytest.mark.slow
@pytest.mark.usefixtures("cc")
def test_what_is_there_is_written_over_only_when_that_was_asked_for(rng, tmp_path, monkeypatch, capsys):
    files.save(random_law(rng, 4, 1, 1), tmp_path / "law.h5")
    project = tmp_path / "project"
    words = ("--fmu", tmp_path / "law.fmu", "--export", tmp_path / "law.csv", "--project", project)
    for path in (tmp_path / "law.fmu", tmp_path / "law.csv"):
        path.write_bytes(b"mine")
    for option, path in (words[:2], words[2:4]):
        assert called(monkeypatch, tmp_path / "law.h5", option, path) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert f"choose another {option}, or write over it with --force" in said
        assert path.name in said
        assert path.read_bytes() == b"mine"
    assert not (tmp_path / "law").exists()
    stranger = tmp_path / "stranger"
    stranger.mkdir()
    (stranger / "notes.txt").write_text("mine")
    assert called(monkeypatch, tmp_path / "law.h5", "--project", stranger, "--force") == 2
    assert "did not write" in capsys.readouterr().err
    assert [p.name for p in stranger.iterdir()] == ["notes.txt"]
    assert not (tmp_path / "law").exists()
    assert called(monkeypatch, tmp_path / "law.h5", *words, "--force") == 0
    assert (tmp_path / "law.fmu").read_bytes() != b"mine"
    assert read_law(tmp_path / "law.csv").states == 4
    assert called(monkeypatch, tmp_path / "law.h5", "--out", tmp_path / "new", "--project", project) == 2
    assert "not empty" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("precision", ["q31", pytest.param("float32", marks=pytest.mark.slow)])
def test_code_is_written_over_only_when_that_was_asked_for(rng, tmp_path, monkeypatch, capsys, precision):
    source, code = files.save(random_law(rng, 2, 1, 1), tmp_path / "law.h5"), tmp_path / "law"
    words = (source, "--precision", precision, "--limits", "25", *(["--range", "10"] if precision == "q31" else []))
    assert called(monkeypatch, *words) == 0
    written = code / "controller.c"
    written.write_text(written.read_text() + "/* by hand */\n")
    assert called(monkeypatch, *words) == 2
    assert "law' exists already and is not empty" in " ".join(capsys.readouterr().err.split())
    assert "by hand" in written.read_text()
    inner = source.rename(code / "law.h5")
    assert called(monkeypatch, inner, "--out", code, "--force") == 2
    assert "stands in it" in capsys.readouterr().err
    inner.rename(source)
    assert called(monkeypatch, *words, "--force") == 0
    assert "by hand" not in written.read_text()
