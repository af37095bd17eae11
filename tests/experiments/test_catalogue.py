"""The catalogue tells what the records are, follows every change of the files, and may be thrown away."""

import hashlib
import json
import sqlite3
import subprocess
import sys
from collections import Counter
from contextlib import closing

import pytest

from ultraquiet import experiments, files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.experiments import catalogue, journal
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
    names = [(e.name, e.file != "") for e in experiments.find(folder)]
    assert names == [("loud", False), *((f"chirp-{k}", True) for k in range(1, 7)), ("own", True)]
    files.save(Record(rng.standard_normal((1, 9)), rng.standard_normal((1, 9)), 10.0), folder / "own.h5")
    assert [e.samples for e in experiments.find(folder, name="own")] == [9]
    before = experiments.find(folder)
    (folder / catalogue.FILE).unlink()
    assert experiments.find(folder) == before


@pytest.mark.parametrize("spoil", ["garbage behind the head", "no database", "torn pages", "another layout"])
def test_a_damaged_catalogue_is_made_anew(folder, spoil, rng):
    before = experiments.find(folder)
    path = folder / catalogue.FILE
    whole = path.read_bytes()
    if spoil == "another layout":
        with closing(sqlite3.connect(path)) as base, base:
            base.execute("DROP TABLE runs")
            base.execute("CREATE TABLE runs (nonsense)")
            base.execute("PRAGMA user_version = 1")
    else:
        path.write_bytes(
            {
                "garbage behind the head": b"SQLite format 3\0" + rng.bytes(5000),
                "no database": rng.bytes(5000),
                "torn pages": whole[:4096] + rng.bytes(len(whole) - 4096),
            }[spoil]
        )
    assert experiments.find(folder) == before
    assert experiments.find(folder) == before
    with closing(sqlite3.connect(path)) as base:
        assert base.execute("SELECT count(*) FROM runs").fetchone() == (7,)
        assert base.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_rows_say_what_was_measured_and_search_finds_them(folder):
    (loud,) = experiments.search(folder, what="LOUD")
    record = files.read_record(folder / loud.file)
    made = record.provenance.settings
    assert loud.status == "DONE"
    assert loud.bench == "hexapod"
    assert json.loads(loud.bench_settings)["unit"] == "ground"
    assert loud.list_hash == experiments.parse(LIST).hash == record.provenance.parents[0]
    assert loud.seeds == ",".join(str(d["seed"]) for d in made["measurement"]["excitation"])
    assert loud.sha256 == hashlib.sha256((folder / loud.file).read_bytes()).hexdigest()
    assert loud.when == made["conditions"]["begun"]
    assert (loud.overruns, loud.temperature_c, loud.comment) == (0, None, "")
    assert [e.name for e in experiments.search(folder, what="chirp")] == [f"chirp-{k}" for k in range(1, 7)]
    assert len(experiments.search(folder, bench="HEXA", list="catal", status="done", since="2000-01-01")) == 7
    assert len(experiments.search(folder, list=loud.list_hash[:8])) == 7
    for none in ({"since": "2999-01-01"}, {"bench": "lathe"}, {"list": "0000"}, {"status": "not-started"}):
        assert not experiments.search(folder, **none)
    for wrong in ({"since": "yesterday"}, {"status": "broken"}):
        with pytest.raises(InputError, match=next(iter(wrong.values()))):
            experiments.search(folder, **wrong)


def test_runs_without_a_record_are_known_from_the_journal(tmp_path):
    """Stopped in the third measurement: two done, one in part, the rest never begun; then one record is lost."""
    asked = 0

    def stop():
        nonlocal asked
        asked += 1
        return asked > 7  # each measurement asks once before it and once a block, its probe likewise

    with pytest.raises(experiments.StoppedError) as caught:
        experiments.run(experiments.parse(LIST), tmp_path, stop=stop)
    print(caught.value)
    rows = {e.name: e for e in experiments.find(tmp_path)}
    kinds = Counter(e.status for e in rows.values())
    assert kinds == Counter(s.status for s in caught.value.states)
    assert set(kinds) == {"DONE", "ABORTED", "NOT STARTED"}
    (aborted,) = (e for e in rows.values() if e.status == "ABORTED")
    assert aborted.file == f"{aborted.name}.partial.h5"
    assert 0 < aborted.samples < 300 + 350
    loud = rows["loud"]
    assert (loud.status, loud.file, loud.actuators, loud.samples, loud.when) == ("NOT STARTED", "", "1,4", 1000, "")
    assert (loud.list, loud.bench, loud.rate_hz) == ("catalogued", "hexapod", 3500.0)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "chirp-1.h5").rename(tmp_path / "elsewhere" / "mine.h5")
    assert [(e.name, e.file) for e in experiments.find(tmp_path, name="chirp-1")] == [("chirp-1", "elsewhere/mine.h5")]
    (tmp_path / "elsewhere" / "mine.h5").unlink()
    assert [(e.status, e.file) for e in experiments.find(tmp_path, name="chirp-1")] == [("DONE", "")]
    (tmp_path / journal.FILE).write_bytes(b"damaged\nbeyond\nreading\n")
    assert {e.name for e in experiments.find(tmp_path)} == {e.name for e in rows.values() if e.file} - {"chirp-1"}


def test_a_running_measurement_is_known_as_such(tmp_path):
    """Asked from inside the run, as another process would ask."""
    seen = []

    class Asks(experiments.Onlooker):
        def advances(self, step, levels):
            seen.append([(e.name, e.file) for e in experiments.find(tmp_path, status="RUNNING")])

    experiments.run(experiments.parse(LIST), tmp_path, onlooker=Asks())
    assert seen[0] == [("chirp-1", "chirp-1.log")]
    assert seen[-1] == [("loud", "loud.log")]
    assert not experiments.find(tmp_path, status="RUNNING")


ASK = """\
import sys
from ultraquiet import experiments
for _ in range(10):
    print(len(experiments.search(sys.argv[1], what="chirp")), flush=True)
"""


@pytest.mark.slow
def test_several_processes_may_ask_while_another_records(tmp_path):
    words = [sys.executable, "-c", ASK, str(tmp_path)]
    children = [subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    experiments.run(experiments.parse(LIST), tmp_path / "one")
    for child in children:
        said, complaint = child.communicate(timeout=120)
        assert child.returncode == 0, complaint
        counts = [int(line) for line in said.split()]
        print(counts)
        assert counts == sorted(counts)
    assert len(experiments.search(tmp_path, what="chirp")) == 6


def test_where_no_catalogue_can_be_kept_the_answer_is_the_same(folder):
    before = experiments.find(folder)
    (folder / catalogue.FILE).unlink()
    (folder / catalogue.FILE).mkdir()  # even the superuser cannot open a folder as a database
    assert experiments.find(folder) == before
