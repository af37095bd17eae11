"""`ultraquiet deploy` with its options for other programs."""

import numpy as np
import pytest
from deploy_laws import random_law

from ultraquiet import files
from ultraquiet.cli import main
from ultraquiet.deploy import FmuController, read_law


def called(monkeypatch, *words):
    """Run the command; return its exit code."""
    monkeypatch.setattr("sys.argv", ["ultraquiet", "deploy", *map(str, words), "--target", "none", "--steps", "200"])
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
        (["--fmu", "law.zip"], "--fmu needs a file that ends in '.fmu'"),
        (["--fmi", "1.0"], "'--fmi' must be one of '2.0', '3.0'"),
        (["--export", "law.xls"], "--export writes .mat, .h5, .csv, .txt"),
        (["--export", "law.txt"], "this law couples its channels"),
    ]:
        assert called(monkeypatch, tmp_path / "law.h5", *words) == 2
        assert said in " ".join(capsys.readouterr().err.split())
    assert [p.name for p in tmp_path.iterdir()] == ["law.h5"]
