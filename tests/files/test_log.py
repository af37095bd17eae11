"""Logs give back every bit they took; any damage is noticed, and nothing is ever read that was not written."""

import math
import os
import struct
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from ultraquiet import files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import Provenance
from ultraquiet.files import LogWriter, finalise, log_header, read_log
from ultraquiet.files.frames import DATA, HEAD_BYTES, UNBOUND, LogFrame, UnsoundError, frame_at
from ultraquiet.files.log import EARLY, FRAME_SAMPLES, SYNC_S
from ultraquiet.values import Channel

ACTUATORS = [Channel("force ü", "N", -25.0, 25.0)]
SENSORS = [Channel("speed", "V", -10.0, 10.0), Channel("free", "m/s")]
PLANNED = 100


def header(samples=PLANNED):
    settings = {"list": "a list", "measurement_hash": "abc", "bench": {"unit": "ground"}}
    return log_header(ACTUATORS, SENSORS, 3500.0, samples, Provenance("experiment", settings, 7, ("parent",)))


def written(path, blocks, close=True):
    with LogWriter(path, header()) as log:
        for block in blocks:
            log.append(block)
        if close:
            log.close(complete=True, notes={"bench": {"overruns": 2}})
    return path


def frames(data):
    """The frames of a log, each as its bytes."""
    found, at = [], 0
    while at < len(data):
        size = frame_at(data, at).size
        found.append(data[at : at + size])
        at += size
    return found


@pytest.fixture
def blocks(rng):
    return [rng.standard_normal((3, m)) for m in (40, 1, 59)]


def test_every_bit_comes_back(blocks, tmp_path):
    blocks[0][:, :5] = [[-0.0, 5e-324, 1.7e308, np.pi, -1e-300]] * 3
    log = read_log(written(tmp_path / "a.log", blocks))
    whole = np.concatenate(blocks, axis=1)
    assert log.samples.tobytes() == whole.tobytes()
    assert (log.header, log.ended, log.complete, log.reason, log.lost_bytes) == (header(), True, True, "", 0)
    record = log.record()
    assert np.array_equal(record.inputs, whole[:1])
    assert np.array_equal(record.outputs, whole[1:])
    assert (list(record.actuators), list(record.sensors), record.rate_hz) == (ACTUATORS, SENSORS, 3500.0)
    made = record.provenance
    assert (made.made_by, made.seed, made.parents) == ("experiment", 7, ("parent",))
    assert made.settings["bench"] == {"unit": "ground", "overruns": 2}
    assert "partial" not in made.settings


def test_long_blocks_are_cut_and_empty_ones_pass(rng, tmp_path):
    long = rng.standard_normal((3, 2 * FRAME_SAMPLES + 5))
    path = written(tmp_path / "a.log", [long[:, :0], long])
    assert np.array_equal(read_log(path).samples, long)
    assert len(frames(path.read_bytes())) == 5


def test_a_log_is_never_written_over(blocks, tmp_path):
    path = written(tmp_path / "a.log", blocks)
    before = path.read_bytes()
    with pytest.raises(StorageError, match="exists already"):
        LogWriter(path, header())
    assert path.read_bytes() == before


def test_what_is_no_block_is_refused_and_nothing_of_it_written(blocks, tmp_path):
    with LogWriter(tmp_path / "a.log", header()) as log:
        log.append(blocks[0])
        for wrong, said in ((blocks[0][:2], "3 rows"), ([[np.nan]] * 3, "NaN"), ([1.0, 2.0], "dimensions")):
            with pytest.raises(InputError, match=said):
                log.append(wrong)
        log.append(blocks[1])
        log.close(complete=True)
        log.close(complete=True)
        with pytest.raises(StorageError, match="is closed"):
            log.append(blocks[2])
    assert np.array_equal(read_log(tmp_path / "a.log").samples, np.hstack(blocks[:2]))
    for wrong in ({}, {"channels": []}, {"channels": ["a"], "rate_hz": math.inf}):
        with pytest.raises(InputError, match="LogWriter: the header"):
            LogWriter(tmp_path / "b.log", wrong)
    assert not (tmp_path / "b.log").exists()


def test_a_run_broken_off_says_why(blocks, tmp_path):
    def broken():
        with LogWriter(tmp_path / "a.log", header()) as log:
            log.append(blocks[0])
            raise RuntimeError("the cable\ncame loose")

    with pytest.raises(RuntimeError):
        broken()
    with LogWriter(tmp_path / "b.log", header()) as log:
        log.append(blocks[0])
        log.close(complete=False, reason="stopped by hand")
    written(tmp_path / "c.log", blocks[:1], close=False)
    said = {}
    for name in "abc":
        log = read_log(tmp_path / f"{name}.log")
        assert (log.ended, log.complete, log.samples.shape) == (True, False, (3, 40))
        said[name] = log.reason
    print(said)
    assert said["a"] == "RuntimeError: the cable came loose"
    assert said["b"] == "stopped by hand"
    assert "without closing" in said["c"]
    partial = read_log(tmp_path / "b.log").record().provenance.settings["partial"]
    assert partial == {"samples": 40, "of": PLANNED, "reason": "stopped by hand"}


def test_an_interrupt_in_the_middle_of_a_write_leaves_no_half_block(blocks, tmp_path, monkeypatch):
    whole, path = os.write, tmp_path / "a.log"

    def interrupted(handle, data):
        whole(handle, bytes(data)[:100])
        monkeypatch.setattr("os.write", whole)
        raise KeyboardInterrupt

    with LogWriter(path, header()) as log:
        log.append(blocks[0])
        monkeypatch.setattr("os.write", interrupted)
        with pytest.raises(KeyboardInterrupt):
            log.append(blocks[2])
        log.close(complete=False, reason="interrupted")
    log = read_log(path)
    assert (log.ended, log.lost_bytes, log.reason) == (True, 0, "interrupted")
    assert np.array_equal(log.samples, blocks[0])


def sound(path, data, whole):
    """Read a changed log; whatever it holds must be what was written, from the first sample on."""
    path.write_bytes(data)
    log = read_log(path)
    n = log.samples.shape[1]
    assert log.samples.tobytes() == np.ascontiguousarray(whole[:, :n]).tobytes(), "phantom samples"
    return log, n


@pytest.mark.parametrize("end", [False, True], ids=["killed", "ended"])
def test_truncation_at_every_byte_of_the_last_block(blocks, end, tmp_path):
    data = written(tmp_path / "a.log", blocks).read_bytes()
    parts = frames(data)
    whole, tail = np.hstack(blocks), sum(map(len, parts[-1 - end :]))
    data = data if end else data[: -len(parts[-1])]
    tail = len(parts[-2]) + end * len(parts[-1])
    boundary = len(data) - tail + len(parts[-2])
    for cut in range(1, tail + 1):
        left = len(data) - cut
        log, n = sound(tmp_path / "b.log", data[:left], whole)
        assert n == (100 if left >= boundary else 41)
        last = boundary if left >= boundary else len(data) - tail
        assert (log.complete, log.ended, log.damaged, log.lost_bytes) == (False, False, False, left - last)
        assert ("cut short" in log.reason) == (left > last)
        assert f"{n} samples" in log.reason
    print(f"{tail} truncations, {tail} noticed")


@pytest.mark.slow
def test_every_bit_of_the_last_block_flipped(rng, tmp_path):
    blocks = [rng.standard_normal((3, 40)), rng.standard_normal((3, 17))]
    whole, path = np.hstack(blocks), tmp_path / "b.log"
    data = written(tmp_path / "a.log", blocks).read_bytes()
    end = len(frames(data)[-1])
    # Once as a killed run leaves it, once with the end behind it, once in that end.
    for name, content, first, last in (
        ("last block", data[:-end], len(data) - end - len(frames(data)[-2]), len(data) - end),
        ("block before the end", data, len(data) - end - len(frames(data)[-2]), len(data) - end),
        ("end", data, len(data) - end, len(data)),
    ):
        for at in range(first, last):
            for bit in range(8):
                changed = bytearray(content)
                changed[at] ^= 1 << bit
                log, n = sound(path, changed, whole)
                assert n == (57 if name == "end" else 40)
                assert not log.complete
                assert not log.ended
                assert log.lost_bytes == len(content) - first
                assert "unsound" in log.reason
        print(f"{name}: {8 * (last - first)} single bits flipped, each noticed")


def test_a_damaged_header_is_refused(blocks, rng, tmp_path):
    data = written(tmp_path / "a.log", blocks).read_bytes()
    size = len(frames(data)[0])
    changed = bytearray(data)
    for at in range(size):
        changed[at] ^= 1 << int(rng.integers(8))
        (tmp_path / "b.log").write_bytes(changed)
        with pytest.raises(StorageError, match="has no sound header"):
            read_log(tmp_path / "b.log")
        changed[at] = data[at]
    for cut in range(size):
        (tmp_path / "b.log").write_bytes(data[:cut])
        with pytest.raises(StorageError, match="has no sound header"):
            read_log(tmp_path / "b.log")
    (tmp_path / "b.log").write_bytes(data[size:])
    with pytest.raises(StorageError, match="does not begin with a header"):
        read_log(tmp_path / "b.log")
    with pytest.raises(StorageError, match="cannot be read"):
        read_log(tmp_path / "absent.log")


def test_blocks_missing_doubled_swapped_or_of_another_log(rng, tmp_path):
    """Blocks of one length, so that only number, place and run tell them apart."""
    blocks = [rng.standard_normal((3, 20)) for _ in range(4)]
    whole = np.hstack(blocks)
    h, a, b, c, d, e = frames(written(tmp_path / "a.log", blocks).read_bytes())
    other = frames(written(tmp_path / "o.log", blocks).read_bytes())
    for name, kept, parts in (
        ("missing", 20, (h, a, c, d, e)),
        ("doubled", 40, (h, a, b, b, c, d, e)),
        ("swapped", 20, (h, a, c, b, d, e)),
        ("the end too early", 60, (h, a, b, c, e)),
        ("without a last block before its end", 60, (h, a, b, c, e)),
        ("of another log", 40, (h, a, b, other[3], d, e)),
        ("end of another log", 80, (h, a, b, c, d, other[5])),
        ("a second header", 20, (h, a, h, b, c, d, e)),
        ("zeros in between", 40, (h, a, b, bytes(len(c)), d, e)),
        ("zeros behind", 80, (h, a, b, c, d, bytes(4096))),
    ):
        log, n = sound(tmp_path / "b.log", b"".join(parts), whole)
        assert (name, n, log.ended, log.complete, log.damaged) == (name, kept, False, False, True)
        print(f"{name}: {log.reason}")
    for behind in (e, d, b"x", bytes(60)):
        log, n = sound(tmp_path / "b.log", b"".join((h, a, b, c, d, e, behind)), whole)
        assert (n, log.ended, log.complete, log.damaged, log.lost_bytes) == (80, True, False, True, len(behind))


def test_random_damage_anywhere_is_noticed(blocks, rng, tmp_path):
    """Bursts, cuts, insertions and removals at random places: at most fewer samples, never other ones."""
    data = written(tmp_path / "a.log", blocks).read_bytes()
    whole, refused = np.hstack(blocks), 0
    for _ in range(1000):
        at, length = int(rng.integers(len(data))), int(rng.integers(1, 64))
        noise = rng.bytes(length)
        changed = [
            data[:at] + noise + data[at + length :],
            data[:at] + noise + data[at:],
            data[:at] + data[at + length :],
        ][rng.integers(3)]
        if changed == data:
            continue
        try:
            log, _ = sound(tmp_path / "b.log", changed, whole)
            assert not log.complete
            assert log.reason
        except StorageError:
            refused += 1
    print(f"1000 damaged logs: {refused} refused for their header, none with a phantom sample or taken for complete")


def test_finalise_makes_the_archive_and_removes_the_log(blocks, tmp_path):
    path, made = written(tmp_path / "a.log", blocks), tmp_path / "a.h5"
    record = finalise(path, made)
    assert files.load(made).hash == record.hash
    assert files.load(made).provenance.to_json() == record.provenance.to_json()
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]
    assert finalise(path, made).hash == record.hash


class Killed(BaseException):
    """Stands for the end of the process."""


def test_finalise_goes_on_wherever_it_was_killed(blocks, tmp_path, monkeypatch):
    """Die before each call of the system that finalise makes; the next call ends with record and no log."""
    calls = ("open", "fsync", "link", "unlink", "close")
    whole = np.hstack(blocks)
    for stop in range(100):
        place = tmp_path / str(stop)
        place.mkdir()
        path = written(place / "a.log", blocks)
        left = stop

        def dying(call):
            def called(*args, **kwargs):
                nonlocal left
                left -= 1
                if left < 0:
                    raise Killed
                return call(*args, **kwargs)

            return called

        with monkeypatch.context() as patched:
            for name in calls:
                patched.setattr(f"os.{name}", dying(getattr(os, name)))
            try:
                finalise(path, place / "a.h5")
                break
            except Killed:
                pass
        record = finalise(path, place / "a.h5")
        assert np.array_equal(np.vstack([record.inputs, record.outputs]), whole)
        assert files.load(place / "a.h5").hash == record.hash
        assert not path.exists()
    print(f"killed before each of {stop} calls of the system: always one record, no log, no sample lost")
    assert 5 < stop < 100


def test_finalise_writes_over_nothing(blocks, tmp_path):
    first, second = written(tmp_path / "a.log", blocks), written(tmp_path / "b.log", blocks[:1])
    kept = finalise(first, tmp_path / "a.h5")
    for precious in (tmp_path / "a.h5", tmp_path / "c.h5"):
        (tmp_path / "c.h5").write_bytes(b"precious")
        before = precious.read_bytes()
        with pytest.raises(StorageError, match="exists already"):
            finalise(second, precious)
        assert precious.read_bytes() == before
        assert read_log(second).complete
    assert finalise(second, tmp_path / "a.h5", overwrite=True).samples == 40 != kept.samples
    assert not second.exists()


def test_a_log_that_makes_no_record_stays(tmp_path, blocks):
    empty = written(tmp_path / "a.log", [])
    with pytest.raises(InputError, match="no samples"):
        finalise(empty, tmp_path / "a.h5")
    with LogWriter(tmp_path / "b.log", {"channels": ["x"]}) as log:
        log.append([[1.0]])
    with pytest.raises(InputError, match="its header describes no record"):
        finalise(tmp_path / "b.log", tmp_path / "b.h5")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.log", "b.log"]


def test_a_damaged_log_is_kept_beside_its_partial_record(blocks, tmp_path):
    data = bytearray(written(tmp_path / "a.log", blocks).read_bytes())
    data[-len(frames(bytes(data))[-1]) - 9] ^= 4
    (tmp_path / "a.log").write_bytes(data)
    record = finalise(tmp_path / "a.log", tmp_path / "a.h5")
    print(record.provenance.settings["partial"])
    assert record.samples == 41
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.h5", "a.log.damaged"]


def test_the_disk_is_synced_at_most_every_tenth_of_a_second(tmp_path, monkeypatch):
    synced, whole, now = [], os.fdatasync, [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("os.fdatasync", lambda handle: (synced.append(now[0]), whole(handle))[1])
    with LogWriter(tmp_path / "a.log", header()) as log:
        for _ in range(200):
            now[0] += 0.05
            log.append(np.zeros((3, 175)))
        log.close(complete=True)
    gaps = np.diff([100.0, *synced[:-1]])
    print(
        f"10 s of 50 ms blocks: {len(synced)} syncs, at least {gaps.min():.3f} s and at most {gaps.max():.3f} s apart"
    )
    assert gaps.min() > (1.0 - EARLY) * SYNC_S
    assert gaps.max() < SYNC_S + 1e-6


def appended(path, block, repeats):
    """Return the rate in MB/s and the seconds of each append."""
    rows, costs = [Channel(f"c{k}") for k in range(len(block))], []
    with LogWriter(path, log_header(rows[:6], rows[6:], 3500.0, block.shape[1] * repeats, Provenance())) as log:
        began = time.perf_counter()
        for _ in range(repeats):
            started = time.perf_counter()
            log.append(block)
            costs.append(time.perf_counter() - started)
        log.close(complete=True)
        seconds = time.perf_counter() - began
    assert read_log(path).samples.shape == (len(block), block.shape[1] * repeats)
    return repeats * block.nbytes / seconds / 1e6, costs


def test_rate_and_cost_of_appending(tmp_path, rng, monkeypatch):
    """3.5 kHz on twelve channels of doubles are 0.34 MB/s, in blocks of 50 ms."""
    block, needed = rng.standard_normal((12, 175)), 12 * 8 * 3500 / 1e6
    rate, costs = appended(tmp_path / "a.log", block, 2000)
    monkeypatch.setattr("ultraquiet.files.log.SYNC_S", 0.0)
    synced, waits = appended(tmp_path / "b.log", block, 200)
    for how, mb, seconds in (("at most every 0.1 s", rate, costs), ("after every block", synced, waits)):
        us = np.percentile(seconds, [50, 99, 100]) * 1e6
        print(
            f"synced {how}: {mb:.1f} MB/s of {needed:.2f} MB/s needed; an append takes {us[0]:.0f} us (median), "
            f"{us[1]:.0f} us (99 of 100), {us[2]:.0f} us (longest)"
        )
    assert rate > 10 * needed
    assert synced > needed


def test_the_reader_of_the_documentation_needs_no_package(blocks, rng, tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "log-format.md").read_text()
    scope = {}
    exec(text.split("```python\n")[1].split("```")[0], scope)
    path = written(tmp_path / "a.log", blocks)
    data = path.read_bytes()
    for cut in (len(data), *rng.integers(len(frames(data)[0]) + len(frames(data)[1]), len(data), 20)):
        path.write_bytes(data[:cut])
        told, samples = scope["read"](path)
        assert told == header()
        assert np.array_equal(samples, read_log(path).samples)


def test_no_head_stands_before_the_payload_of_another_frame():
    """A disk may give back a block of a log that was removed, behind a head that is new."""
    new, old = LogFrame(DATA, 3, b"a" * 8, 350, 1, 2, bytes(16)), LogFrame(DATA, 3, b"b" * 8, 350, 1, 2, b"x" * 16)
    torn = new.packed()[:HEAD_BYTES] + old.packed()[HEAD_BYTES:]
    with pytest.raises(UnsoundError, match="checksum"):
        frame_at(torn, 0)


def test_frames_of_the_version_before_are_read():
    frame = LogFrame(DATA, 3, b"abcdefgh", 175, 1, 2, bytes(16))
    data = bytearray(frame.packed())
    data[5] = UNBOUND
    data[48:52] = struct.pack("<I", zlib.crc32(data[:48]))
    data[-4:] = struct.pack("<I", zlib.crc32(data[:-4]))
    assert frame_at(bytes(data), 0) == frame
