"""A C++ program and a functional mock-up unit, each a bench that one study file takes to verified code."""

import json
import subprocess
from pathlib import Path

import pytest

from fmu_archive import compiled, pack
from report_words import foreign_words, small_openings, visible

PLANT = Path(__file__).parents[2] / "docs" / "examples" / "plant.c"
LIST = """
title = "two masses"
[[commands]]
do = "configure"
samples = 8000
[[commands]]
do = "excite"
name = "rough"
actuator = "each"
signal = { method = "noise", stop_hz = 400.0, peak_v = 20.0 }
[[commands]]
do = "excite"
name = "sines"
actuator = "each"
signal = { method = "multisine", start_hz = 10.0, stop_hz = 500.0, period_samples = 2000, peak_v = 20.0 }
"""
STUDY = """
[study]
title = "Two masses"
seed = 2
[bench]
BENCH
[experiment]
list = "list.toml"
[identify]
structures = ["arx"]
orders = [4]
[plant]
method = "rational"
records = ["sines"]
period_samples = 2000
[controllers.quiet.design]
method = "lqg"
[closed_loop]
tones_hz = [47.0]
"""


def cpp(folder):
    """Compile the documentation's plant as C++."""
    command = ["g++", "-O2", "-ffp-contract=off", "-x", "c++", "-o", str(folder / "plant"), str(PLANT)]
    subprocess.run(command, check=True)
    return f'method = "process"\ncommand = ["{folder / "plant"}"]'


def fmu(folder):
    """Pack the tests' own FMU, two inputs and two outputs."""
    path = pack(compiled(folder), folder / "plant.fmu", 2)
    return f'method = "fmu"\npath = "{path}"'


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("bench", "rate_hz"), [(cpp, 2000), (fmu, 4096)])
def test_a_bench_of_another_language_walks_the_whole_study(bench, rate_hz, tmp_path, run):
    (tmp_path / "list.toml").write_text(LIST)
    (tmp_path / "study.toml").write_text(STUDY.replace("BENCH", bench(tmp_path)))
    code, _, said = run("run", "study.toml", "--out", "out")
    print(said[-2500:])
    assert code == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    loop = summary["closed_loop"]["quiet"]["bench"]
    print({key: loop[key] for key in ("status", "band_hz", "worst_direction_band_db", "peak_amplification_db")})
    assert loop["stable"]
    assert set(loop["tones"]) == {"47"}
    assert summary["deployment"]["quiet"]["bit_exact"] is True
    page = (tmp_path / "out" / "report.html").read_text()
    assert not foreign_words(page)
    assert not small_openings(page)
    assert all(name in visible(page) for name in ("push 1", "speed 2", "(m/s)/N", f"{rate_hz} Hz"))
