"""The catalogue tells what the records are, follows every change of the files, and may be thrown away."""

import pytest

from ultraquiet import experiments, files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.experiments import catalogue
from ultraquiet.values import Record, Status

LIST = """\
title = "catalogued"
[bench]
method = "hexapod"
[[commands]]
do = "configure"
samples = 300
[[commands]]
do = "excite"
name = "chirp"
signal = { method = "chirp" }
[[commands]]
do = "excite"
name = "loud"
actuator = [1, 4]
samples = 1000
signal = { method = "tone", frequency_hz = 60.0, amplitude_v = 25.0 }
"""


@pytest.fixture
def folder(tmp_path):
    experiments.run(experiments.parse(LIST), tmp_path / "first")
    return tmp_path


def test_records_are_found_by_what_they_are(folder):
    everything = experiments.find(folder)
    assert [e.file for e in everything] == [*(f"first/chirp-{k}.h5" for k in range(1, 7)), "first/loud.h5"]
    assert [e.name for e in experiments.find(folder, signal="chirp", actuators="2")] == ["chirp-2"]
    (loud,) = experiments.find(folder, samples=1000)
    assert (loud.actuators, loud.list, loud.controller, loud.rate_hz) == ("1,4", "catalogued", "", 3500.0)
    record = files.read_record(folder / loud.file)
    assert (loud.hash, loud.clipped) == (record.hash, sum(record.clipped()))
    with pytest.raises(InputError, match="not known by 'colour'"):
        experiments.find(folder, colour="red")
    with pytest.raises(StorageError, match="is no folder"):
        experiments.find(folder / "nowhere")


def test_the_catalogue_follows_the_files(folder, rng):
    assert len(experiments.find(folder)) == 7
    files.save(Record(rng.standard_normal((1, 5)), rng.standard_normal((1, 5)), 10.0), folder / "own.h5")
    files.save(Status("ok", ""), folder / "status.h5")
    (folder / "foreign.h5").write_bytes(b"not an archive")
    (folder / "first" / "loud.h5").unlink()
    names = [e.name for e in experiments.find(folder)]
    assert names == [*(f"chirp-{k}" for k in range(1, 7)), "own"]
    files.save(Record(rng.standard_normal((1, 9)), rng.standard_normal((1, 9)), 10.0), folder / "own.h5")
    assert [e.samples for e in experiments.find(folder, name="own")] == [9]
    before = experiments.find(folder)
    (folder / catalogue.FILE).unlink()
    assert experiments.find(folder) == before


def test_a_damaged_catalogue_says_so(folder):
    (folder / catalogue.FILE).write_bytes(b"SQLite format 3\0" + bytes(range(256)) * 20)
    with pytest.raises(StorageError, match="may be deleted, records stay"):
        experiments.find(folder)
