"""`simulate` on the bench of a study that a Python function makes: its names, units and limits, none of another's."""

import json

import numpy as np
import pytest

import ultraquiet as uq

BENCH = """
import numpy as np
import ultraquiet as uq

def make(noise=0.0, seed=0):
    z = np.exp(2 * np.pi * 20.0 / 500.0 * (-0.05 + 1j))
    A = np.array([[z.real, z.imag], [-z.imag, z.real]])
    state = {}

    def reset(run_index):
        state["x"], state["rng"] = np.zeros(2), np.random.default_rng([seed, run_index])

    def step(u, d):
        state["x"] = A @ state["x"] + np.array([0.1, 0.0]) * (u + d)
        return state["x"][:1] + noise * state["rng"].standard_normal(1)

    return uq.bench.Wrapped(step, reset, 500.0, [uq.Channel("coil", "N", -2.0, 2.0)], [uq.Channel("mass", "mm/s")])
"""
STUDY = """
[study]
title = "a mass on a spring"
[bench]
object = "mass.py:make"
noise = 1e-4
[records]
files = ["record.h5"]
[plant]
method = "subspace"
records = ["record"]
order = 2
[controllers.quiet.design]
method = "lqg"
"""


@pytest.fixture
def law(tmp_path):
    (tmp_path / "mass.py").write_text(BENCH)
    (tmp_path / "study.toml").write_text(STUDY)
    K = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-0.5]], 500.0)
    uq.files.save(K, tmp_path / "law.h5")


@pytest.mark.slow
@pytest.mark.usefixtures("law")
def test_a_function_is_the_bench(run):
    code, out, err = run("simulate", "law.h5", "--bench", "study.toml", "--tones", "20", "--step", "--json")
    assert code == 0, err
    said = json.loads(out)
    print(said["tones"], said["step"])
    (row,) = said["tones"]
    assert row["sensors"]["mass"]["unit"] == "mm/s"
    pole = np.exp(2 * np.pi * 20.0 / 500.0 * (-0.05 + 1j))
    A = [[pole.real, pole.imag], [-pole.imag, pole.real]]
    gain = uq.StateSpace(A, [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], 500.0).frequency_response([20.0])[0, 0, 0]
    assert row["sensors"]["mass"]["reduction_db"] == pytest.approx(20 * np.log10(abs(1 + 0.5 * gain)), abs=0.1)
    assert said["step"]["amplitude"] == pytest.approx(0.2)  # a tenth of the coil's range
    assert (
        said["step"]["actuators"]["coil"]["mass"]["closed_peak"]
        < said["step"]["actuators"]["coil"]["mass"]["open_peak"]
    )


@pytest.mark.usefixtures("law")
def test_what_this_bench_does_not_have_is_named(run):
    code, _, err = run("simulate", "law.h5", "--bench", "study.toml", "--unit", "flight", "--tones", "20")
    assert (code, "'flight'" in err) == (2, True), err
    code, _, err = run("simulate", "law.h5", "--bench", "study.toml", "--noise")
    assert (code, "--band" in err) == (2, True), err


@pytest.mark.slow
@pytest.mark.usefixtures("law")
def test_a_study_in_modes_is_simulated_in_its_modes(tmp_path, run):
    table = '[blending]\nsensors = [[2.0]]\nnames = ["heave"]\ncontrol_rate_hz = 250.0\n[plant]'
    (tmp_path / "study.toml").write_text(STUDY.replace("[plant]", table))
    uq.files.save(
        uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[0.0]], 250.0), tmp_path / "rest.h5"
    )
    code, out, err = run("simulate", "rest.h5", "--bench", "study.toml", "--tones", "20", "--json")
    assert code == 0, err
    assert "heave" in out
    assert "in the modes of [blending]" in run("simulate", "rest.h5", "--bench", "study.toml", "--tones", "20")[1]
    code, _, err = run("simulate", "law.h5", "--bench", "study.toml", "--tones", "20")
    assert code == 2
    assert "250 Hz" in err
