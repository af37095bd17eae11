"""A study in modes from one file: a dead accelerometer is left out by name, the law runs at a fraction of the rate."""

import json

import numpy as np
import pytest

import ultraquiet as uq
from table_of_accelerometers import CONTROL_HZ, delayed, drawn_bench, drawn_table, matrices
from ultraquiet.pipeline.tables.blending import BlendingTable, blended, in_modes
from ultraquiet.values import Decimation

BENCH = '''
import numpy as np
import ultraquiet as uq

SHAPES = np.array([[0.6, 0.8], [0.8, -0.6], [0.5, 0.5], [0.3, -0.7]])
DRIVE = np.array([[0.9, 0.3], [0.2, 0.8]])


def make_bench(noise, seed):
    """Two shakers and four accelerometers at 2 kHz, the third of them dead."""
    rate_hz, w = 2000.0, 2 * np.pi * np.array([9.0, 31.0])
    blocks = [np.exp(-0.02 * w[k] / rate_hz) * turn(w[k] / rate_hz) for k in range(2)]
    state, rng = np.zeros((2, 2)), np.random.default_rng(seed)

    def reset():
        state[:] = 0.0

    def step(u, d):
        y = SHAPES @ state[:, 0]
        y[2] = 0.0
        for k in range(2):
            state[k] = blocks[k] @ state[k] + np.array([0.01 * DRIVE[k] @ (u + d), 0.0])
        return y + noise * rng.standard_normal(4)

    shakers = [uq.Channel(f"shaker {k}", "N", -30.0, 30.0) for k in range(2)]
    return uq.bench.Wrapped(step, reset, rate_hz, shakers, [uq.Channel(f"acc {k}", "m/s^2") for k in range(4)])


def turn(angle):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
'''
LIST = """
title = "shaken"
[[commands]]
do = "configure"
samples = 6000
[[commands]]
do = "excite"
name = "all"
actuator = "all"
signal = { method = "noise", stop_hz = 200.0, peak_v = 20.0 }
"""
STUDY = """
[study]
title = "Four accelerometers"
[bench]
object = "four.py:make_bench"
noise = 1e-4
[experiment]
list = "list.toml"
[blending]
sensors = {sensors}
names = ["first", "second"]
control_rate_hz = 1000.0
[plant]
method = "subspace"
order = 6
records = ["all"]
[controllers.quiet.design]
method = "mixed-sensitivity"
"""


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_study_in_modes_leaves_the_dead_sensor_out(tmp_path, run):
    shapes = np.array([[0.6, 0.8], [0.8, -0.6], [0.5, 0.5], [0.3, -0.7]])
    (tmp_path / "four.py").write_text(BENCH)
    (tmp_path / "list.toml").write_text(LIST)
    (tmp_path / "study.toml").write_text(STUDY.format(sensors=np.linalg.pinv(shapes).round(6).tolist()))
    code, _, said = run("run", "study.toml", "--out", "out")
    print(said)
    assert code == 0
    assert "'acc 2' is dead" in said
    assert "'acc 1' is" not in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    loop = summary["closed_loop"]["quiet"]["bench"]
    print({key: loop[key] for key in ("status", "band_hz", "worst_direction_band_db", "peak_amplification_db")})
    assert loop["stable"]
    assert summary["deployment"]["quiet"]["bit_exact"] is True


TABLE_BENCH = """
from table_of_accelerometers import drawn_bench, drawn_table


def make_bench(seed, dead):
    return drawn_bench(drawn_table(seed)[0], seed, dead)
"""
TABLE_STUDY = """
[study]
title = "Twenty accelerometers"
seed = 1
[bench]
object = "table.py:make_bench"
dead = 6
[experiment]
list = "list.toml"
[blending]
sensors = "Ts.csv"
actuators = "Ta.csv"
names = ["x", "y", "z", "rx", "ry", "rz"]
unit = "m/s^2"
actuator_names = ["push z", "push rx", "push ry", "push rz"]
actuator_unit = "N"
control_rate_hz = 2000.0
[plant]
method = "subspace"
order = 42
records = ["all"]
[controllers.quiet.design]
method = "lqg"
"""
TABLE_LIST = """
title = "shaken"
[[commands]]
do = "configure"
samples = 8192
[[commands]]
do = "excite"
name = "all"
actuator = "all"
signal = { method = "noise", start_hz = 2, stop_hz = 600, peak_v = PEAK }
"""


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_twenty_accelerometers_and_four_actuators_from_one_file(tmp_path, run):
    truth, p, d = drawn_table(1)
    Ts, Ta = matrices(p, d)
    seen = blended(drawn_bench(truth, 1, 6), BlendingTable(actuators=Ta.tolist(), control_rate_hz=CONTROL_HZ))
    (tmp_path / "table.py").write_text(TABLE_BENCH)
    peak = min(c.high for c in seen.actuators)
    (tmp_path / "list.toml").write_text(TABLE_LIST.replace("PEAK", f"{0.95 * peak:.6g}"))
    (tmp_path / "study.toml").write_text(TABLE_STUDY)
    np.savetxt(tmp_path / "Ts.csv", Ts, delimiter=",", fmt="%.17g")
    np.savetxt(tmp_path / "Ta.csv", Ta, delimiter=",", fmt="%.17g")
    code, _, said = run("run", "study.toml", "--out", "out")
    print(said)
    assert code == 0
    assert "'acc 7' is dead" in said
    loop = json.loads((tmp_path / "out" / "summary.json").read_text())["closed_loop"]["quiet"]["bench"]
    print({key: loop[key] for key in ("status", "band_hz", "worst_direction_band_db", "peak_amplification_db")})
    assert loop["status"].startswith("ok")
    law = uq.files.load(tmp_path / "out" / "controllers" / "quiet.h5")
    table = BlendingTable(sensors=Ts.tolist(), actuators=Ta.tolist())
    blending = in_modes(drawn_bench(truth, 1, 6), table, ("acc 7",)).blending
    exact = Decimation(4).plant(blending.plant(delayed(truth)))
    margin = uq.analyse.disk_margins(exact, law)
    print("on the true plant:", margin)
    assert margin.stable
    assert margin.alpha >= 0.2
