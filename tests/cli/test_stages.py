"""Single stages on files, as a user calls them: real records first."""

import re
from pathlib import Path

import numpy as np
import pytest

import ultraquiet as uq

DATA = Path(__file__).parents[1] / "data"


def held_out(printed):
    """The third column of the table: fit on the part of the record that the model has not seen, in percent."""
    return [float(row[1]) for row in re.findall(r"([-\d.]+) % +([-\d.]+) %", printed)]


def test_two_inertia_bench(run):
    """Two periods seen, the others held out; a BJ5 for both speeds."""
    record = next((DATA / "two_inertia").glob("*.*"))
    words = ("--inputs", "current", "--outputs", "motor_speed,load_speed", "--hold-out", "0.8", "--out", "model.h5")
    printed = run("identify", record, "--method", "box-jenkins", "--order", "5", *words)[1]
    print(printed)
    fits = held_out(printed)
    assert len(fits) == 2
    assert min(fits) >= 80


def test_hair_dryer(run):
    printed = run("identify", DATA / "hairdryer.mat", "--rate", "12.5", "--order", "5", "--out", "model.h5")[1]
    print(printed)
    assert min(held_out(printed)) >= 84


def test_doctor_and_dry_run(run):
    assert "numba" in run("doctor")[1]
    assert "records" in run("experiment", "suite", "--dry-run")[1]


@pytest.mark.draws(false_alarm=3e-2)  # nine verdicts, each worst of its outputs, that err once in a thousand
@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (4, 3), (3, 5)])
def test_what_the_part_not_seen_says_against_a_model_ends_with_one(run, tmp_path, rng, ny, nu):
    plant = uq.StateSpace([[0.8]], 1e6 * np.ones((1, nu)), 1e-3 * np.ones((ny, 1)), np.zeros((ny, nu)), 100.0)
    u = rng.standard_normal((nu, 2000))
    y = plant.simulate(u)
    y += 0.05 * y.std() * rng.standard_normal(y.shape)
    stuck, turned = y.copy(), y.copy()
    stuck[-1, 1000:] = stuck[-1, 1000]
    turned[0, 1000:] *= -1.0
    last, first = (f"output {k}" for k in (ny, 1))
    said = {"stuck": f"Output '{last}' does not move", "turned": f"The mean of output '{first}' serves better"}
    for name, outputs in (("ordinary", y), ("stuck", stuck), ("turned", turned)):
        uq.files.save(uq.Record(u, outputs, 100.0), tmp_path / f"{name}.h5")
        words = ("--method", "subspace", "--order", "1", "--set", "refine=true", "--out", f"{name}-model.h5")
        code, out, err = run("identify", f"{name}.h5", *words)
        print(out, err)
        seen, held = re.search("^ok: .*$", out, re.MULTILINE), re.search("^poor fit: (.*)$", out, re.MULTILINE)
        assert seen
        assert (code, held is None) == ((0, True) if name == "ordinary" else (1, False))
        assert held is None or held.group(1).startswith(f"On the part not seen: {said[name]}")
