"""Single stages on files, as a user calls them: real records first."""

import re
from pathlib import Path

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
