"""What is left of a measurement that did not come to its end: never nothing, never called whole, never written over."""

import errno
import json
import os
import zlib

import numpy as np
import pytest
from fakes import Fake

from ultraquiet import experiments, files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench import Block, Hexapod
from ultraquiet.experiments import journal
from ultraquiet.experiments.measure import Watch, measure, recover
from ultraquiet.files import LogWriter
from ultraquiet.files.frames import DATA, MAGIC

LIST = """\
[[commands]]
do = "record"
name = "first"
samples = 40
[[commands]]
do = "excite"
name = "push"
actuator = 1
samples = 200
signal = { method = "tone", frequency_hz = 60.0, amplitude_v = 10.0 }
"""


class Streamer(Fake):
    """Hands over blocks of twenty samples, counts overruns, and can be made to stop, break or stutter."""

    provenance = Provenance("streamer", {"colour": "red"}, 5)
    closed, offset = 0, 0.0

    def __init__(self, breaks_at=None, error=None, value=None, blocks=None):
        super().__init__()
        self.breaks_at, self.error, self.value, self.blocks = breaks_at, error, value, blocks

    def stream(self, actuation, disturbance=None, controller=None, *, run_index=None, stop=None, **_):
        record = self.run(actuation, disturbance, controller)
        try:
            for number, start in enumerate(range(0, record.samples, 20)):
                if stop() or number == self.blocks:
                    return
                if number == self.breaks_at and self.error:
                    raise self.error
                part = record.part(start, start + 20)
                readings = self.offset + part.outputs * (self.value if number == self.breaks_at and self.value else 1.0)
                yield Block(part.inputs, readings, np.array([1, 0]), np.array([0, 2, 0]), overruns=1)
        finally:
            self.closed += 1


def listed(bench):
    return experiments.parse(LIST, bench)


def run(folder, bench, **kwargs):
    return experiments.run(listed(bench), folder, sleep=lambda _: None, **kwargs)


def names(folder):
    return sorted(p.name for p in folder.iterdir() if p.name != journal.FILE)


def test_a_streamed_record_is_that_of_a_run(tmp_path):
    whole, streamed = run(tmp_path / "a", Fake()), run(tmp_path / "b", Streamer())
    assert {n: r.hash for n, r in whole.items()} == {n: r.hash for n, r in streamed.items()}
    assert names(tmp_path / "b") == ["first.h5", "push.h5"]
    made = streamed["push"].provenance
    assert made.seed == 5
    counted = {"limited_commands": [10, 0], "limited_readings": [0, 20, 0], "overruns": 10}
    assert made.settings["bench"] == {"made_by": "streamer", "colour": "red", "run_index": 1, **counted}
    assert files.load(tmp_path / "b" / "push.h5").provenance.to_json() == made.to_json()


def test_the_hexapod_streams_into_its_log(tmp_path):
    text = "seed = 3\n" + LIST
    bench = Hexapod(hysteresis=True)
    record = experiments.run(experiments.parse(text, bench), tmp_path)["push"]
    assert np.array_equal(record.outputs, bench.run(record.inputs, run_index=1).outputs)
    assert record.provenance.settings["bench"]["run_index"] == 1
    assert names(tmp_path) == ["first.h5", "push.h5"]


def test_stopped_softly_it_keeps_what_was_measured(tmp_path):
    bench, seen = Streamer(), []
    step = listed(bench).measurements[1]
    watch = Watch(stop=lambda: len(seen) == 3, block=seen.append, conditions={"temperature_c": 21.5})
    left = measure(listed(bench), step, 1, tmp_path, False, watch)
    assert (left.aborted, left.overruns, left.path.name, left.record.samples) == (True, 3, "push.partial.h5", 60)
    assert names(tmp_path) == ["push.partial.h5"]
    settings = files.load(left.path).provenance.settings
    print(settings["partial"])
    assert settings["partial"] == {"samples": 60, "of": 200, "reason": "it was stopped after 60 of 200 samples"}
    assert settings["conditions"] == {"temperature_c": 21.5}
    assert bench.closed == 1


def test_a_bench_that_ends_early_leaves_no_whole_record(tmp_path):
    bench = Streamer(blocks=4)
    left = measure(listed(bench), listed(bench).measurements[1], 1, tmp_path, False, Watch())
    assert left.aborted
    assert left.record.provenance.settings["partial"]["reason"] == "the bench handed over 80 of 200 samples"
    bench = Streamer(blocks=0)
    with pytest.raises(InputError, match="no samples of 'push'"):
        measure(listed(bench), listed(bench).measurements[1], 1, tmp_path, False, Watch())
    assert names(tmp_path) == ["push.partial.h5"]


@pytest.mark.parametrize(
    ("bench", "error"),
    [
        (Streamer(5, RuntimeError("cable")), RuntimeError),
        (Streamer(5, KeyboardInterrupt()), KeyboardInterrupt),
        (Streamer(5, value=np.nan), InputError),
    ],
    ids=["broken", "interrupted", "not a number"],
)
def test_what_breaks_leaves_its_log_and_is_not_repeated_unasked(bench, error, tmp_path):
    # The first measurement is too short to come to the block that breaks.
    with pytest.raises(error):
        run(tmp_path, bench)
    assert bench.closed == 2
    assert names(tmp_path) == ["first.h5", "push.log"]
    log = files.read_log(tmp_path / "push.log")
    print(log.reason)
    assert (log.ended, log.complete, log.samples.shape) == (True, False, (5, 100))
    sound = Streamer()
    with pytest.raises(StorageError, match=r"push in .* was begun before and left no record"):
        run(tmp_path, sound, resume=True)
    assert not sound.calls
    # The refusal has recovered it already.
    assert names(tmp_path) == ["first.h5", "push.partial.h5"]
    partial = files.load(tmp_path / "push.partial.h5")
    assert (partial.samples, partial.provenance.settings["partial"]["reason"]) == (100, log.reason)
    records = run(tmp_path, sound, resume=True, repeat=["push"])
    assert len(sound.calls) == 1
    assert np.array_equal(partial.outputs, records["push"].part(0, 100).outputs)
    assert names(tmp_path) == ["first.h5", "push.h5", "push.partial.h5"]


def test_each_attempt_is_kept(tmp_path):
    for attempt, at in enumerate((3, 4, 5)):
        with pytest.raises(RuntimeError):
            run(tmp_path, Streamer(at, RuntimeError("cable")), resume=True, repeat=["push"] * (attempt > 0))
    found = recover(tmp_path)
    assert found == {"push": tmp_path / "push.partial-3.h5"}
    kept = [files.load(tmp_path / f"push.partial{n}.h5").samples for n in ("", "-2", "-3")]
    assert kept == [60, 80, 100]
    assert not recover(tmp_path)


def left_behind(folder, bench, monkeypatch, **kwargs):
    """Run a list whose process dies between the end of its last log and the making of its record."""

    class Killed(BaseException):
        pass

    def dies(*_):
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr("ultraquiet.experiments.measure.finalise", dies)
        with pytest.raises(Killed):
            run(folder, bench, **kwargs)


def test_a_whole_log_is_a_whole_record_and_nothing_is_repeated(tmp_path, monkeypatch):
    expected = run(tmp_path / "a", Streamer())
    bench = Streamer()
    left_behind(tmp_path / "b", bench, monkeypatch)
    assert names(tmp_path / "b") == ["first.log"]
    records = run(tmp_path / "b", bench, resume=True)
    assert [len(c[0][0]) for c in bench.calls] == [40, 200]
    assert {n: r.hash for n, r in records.items()} == {n: r.hash for n, r in expected.items()}
    assert names(tmp_path / "b") == ["first.h5", "push.h5"]


def test_a_run_that_may_overwrite_still_may_after_a_kill(tmp_path, monkeypatch):
    run(tmp_path, Streamer())
    other = Streamer()
    other.offset = 1.0
    left_behind(tmp_path, other, monkeypatch, overwrite=True)
    assert names(tmp_path) == ["first.h5", "first.log", "push.h5"]
    assert not files.load(tmp_path / "first.h5").outputs.any()
    records = run(tmp_path, other, resume=True)
    assert len(other.calls) == 1
    assert (records["first"].outputs == 1.0).all()
    assert names(tmp_path) == ["first.h5", "push.h5"]


def test_a_log_of_nothing_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError):
        run(tmp_path, Streamer(0, RuntimeError("no power")))
    assert names(tmp_path) == ["first.log"]
    with pytest.raises(StorageError, match=r"first in .* was begun before"):
        run(tmp_path, Streamer(), resume=True)
    assert names(tmp_path) == []


def test_files_of_others_are_left_alone_and_a_ruined_log_is_told(tmp_path):
    (tmp_path / "notes.log").write_text("temperature was high today")
    with pytest.raises(RuntimeError):
        run(tmp_path, Streamer(5, RuntimeError("cable")))
    log, bench = tmp_path / "push.log", Streamer()
    whole = log.read_bytes()
    log.write_bytes(b"X" + whole[1:])
    with pytest.raises(StorageError, match=r"push.log' has no sound header: .* move it out of the folder") as caught:
        run(tmp_path, bench, resume=True, repeat=["push"])
    print(caught.value)
    assert not bench.calls
    log.write_bytes(whole)
    run(tmp_path, bench, resume=True, repeat=["push"])
    assert names(tmp_path) == ["first.h5", "notes.log", "push.h5", "push.partial.h5"]


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO], ids=errno.errorcode.get)
def test_a_full_disk_keeps_every_block_before(error, tmp_path, monkeypatch):
    bench, whole, blocks = Streamer(), os.write, 0

    def full(handle, data):
        nonlocal blocks
        blocks += bytes(data[:5]) == MAGIC + DATA
        if blocks > 2 + 6:
            raise OSError(error, os.strerror(error))
        return whole(handle, data)

    monkeypatch.setattr("os.write", full)
    with pytest.raises(StorageError) as caught:
        run(tmp_path, bench)
    monkeypatch.undo()
    print(caught.value)
    assert str(caught.value).startswith("experiment stopped at 'push', 1 records are finished and safe: ")
    assert f"'{tmp_path / 'push.log'}' could not be written ({os.strerror(error).lower()})" in str(caught.value)
    assert bench.closed == 2
    assert recover(tmp_path) == {"push": tmp_path / "push.partial.h5"}
    assert files.load(tmp_path / "push.partial.h5").samples == 120
    assert names(tmp_path) == ["first.h5", "push.partial.h5"]


def journal_of(folder, *entries):
    """Write a journal whose sums are right."""
    folder.mkdir(exist_ok=True)
    bodies = [json.dumps(entry, sort_keys=True).encode() for entry in entries]
    (folder / journal.FILE).write_bytes(b"".join(b"%08x %s\n" % (zlib.crc32(body), body) for body in bodies))


def tree(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def empty_log(path):
    with LogWriter(path, {"channels": [["a", "V", None, None]]}):
        pass


LEADING_OUT = [
    "../victim",
    "/victim",
    "..",
    ".",
    "",
    "sub/victim",
    "sub\\victim",
    "C:victim",
    "a\0b",
    "\ud800",
    "n" * 300,
]


@pytest.mark.parametrize("name", [*LEADING_OUT, 3, None, ["victim"]])
@pytest.mark.parametrize("event", ["begun", "planned"])
def test_a_name_in_a_journal_never_leaves_its_folder(name, event, tmp_path):
    folder = tmp_path / "records"
    empty_log(tmp_path / "victim.log")
    entry = {"name": name, "hash": "h"}
    journal_of(folder, {"event": event, **({"measurements": [entry]} if event == "planned" else entry)})
    before = tree(tmp_path)
    for act in (recover, lambda place: run(place, Streamer(), resume=True)):
        with pytest.raises(StorageError, match="is no name of a file in its folder; move") as told:
            act(folder)
        assert "\n" not in str(told.value)
    assert [e.name for e in experiments.find(folder)] == []
    assert {name: data for name, data in tree(tmp_path).items() if "catalogue" not in name} == before


@pytest.mark.parametrize(
    "entry", [{"event": "begun"}, "x", {"name": 3}, {"event": "begun", "name": "a", "hash": []}, []]
)
def test_a_sound_line_that_is_no_entry_is_one_sentence(entry, tmp_path):
    journal_of(tmp_path, entry)
    with pytest.raises(StorageError, match="holds at byte 0 what is no entry"):
        recover(tmp_path)


def test_a_link_out_of_the_folder_is_refused_and_a_folder_that_is_one_is_not(tmp_path):
    folder, outside = tmp_path / "records", tmp_path / "victim.log"
    empty_log(outside)
    journal_of(folder, {"event": "begun", "name": "push", "hash": "h"})
    (folder / "push.log").symlink_to(outside)
    before = tree(tmp_path)
    with pytest.raises(StorageError, match="is a link that leads out of its folder"):
        recover(folder)
    assert tree(tmp_path) == before
    assert (folder / "push.log").is_symlink()
    (folder / "push.log").unlink()
    empty_log(folder / "push.log")
    (tmp_path / "link").symlink_to(folder)
    assert recover(tmp_path / "link") == {}
    assert not (folder / "push.log").exists()
