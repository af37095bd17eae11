"""Every call into the system fails, comes short or is the last one: nothing unreadable, nothing false is left."""

import json
import os
import shutil
import struct
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import siege_works as works
from test_killed_study import names, numbers

from ultraquiet import files
from ultraquiet.experiments.measure import recover
from ultraquiet.pipeline.store import contents, entry

HERE = Path(__file__).parent
MOST_CALLS = 2000
WALK = 50  # calls of a walk through the tiny study that the long run strikes in each way
KINDS = {"EIO": works.EIO, "ENOSPC": works.ENOSPC, "short": works.SHORT, "kill": works.KILL}
SIZES = {"first": 1400, "second": 700}
LOSS_S = 0.1
HEAD = struct.Struct("<c3xIIIQQd")

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux" or shutil.which("cc") is None, reason="needs LD_PRELOAD, cc"),
    pytest.mark.timeout(5400),
]


@contextmanager
def armed(folder, *what):
    """Yield a function that has a job done in a child of a warm process, armed."""
    library, warm = folder / "faulty.so", folder / "warm"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", HERE / "faulty.c", "-o", library, "-ldl"], check=True)
    warm.mkdir()
    words = [sys.executable, str(HERE / "siege_works.py"), str(warm), *what]
    environment = {**os.environ, "LD_PRELOAD": str(library), "PYTHONWARNINGS": "ignore"}
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"

        def done(work, place, at=0, kind=works.NOTHING, trace=""):
            job = {"work": work, "place": str(place), "at": at, "kind": kind, "trace": str(trace)}
            server.stdin.write(json.dumps(job) + "\n")
            server.stdin.flush()
            return json.loads(server.stdout.readline())

        yield done
        server.stdin.close()
        server.wait(30)


@pytest.fixture(scope="module")
def forked(tmp_path_factory):
    """A function that has a job done in a child of a warm process, armed."""
    with armed(tmp_path_factory.mktemp("faulty")) as done:
        yield done


@pytest.fixture
def tiny(tmp_path):
    """The same, warm for the tiny study, all of whose computing is done."""
    (tmp_path / "faulty").mkdir()
    with armed(tmp_path / "faulty", "tiny") as done:
        yield done


def sound(place):
    """Fail on a record that cannot be read or holds what was not measured; return name -> samples."""
    found = {}
    for path in place.glob("[!.]*.h5"):
        record, name = files.load(path), path.name.partition(".")[0]
        run = list(SIZES).index(name)
        assert np.array_equal(record.outputs, works.readings(run, SIZES[name])[:, : record.samples]), "phantom samples"
        partial = ".partial" in path.name
        assert partial == ("partial" in record.provenance.settings)
        assert partial or record.samples == SIZES[name]
        found[path.name] = record.samples
    return found


def goes_on(place):
    """Go on with a list as somebody would who reads what is said, without faults; the whole list is there then."""
    works.resume(place, between=sound)
    assert {name: files.load(place / f"{name}.h5").samples for name in SIZES} == SIZES
    sound(place)
    assert not list(place.glob(".*.part"))


def all_places(calls):
    """Return the numbers of the calls that are struck."""
    return range(1, min(calls, MOST_CALLS) + 1)


def struck(forked, work, folder, judge, kinds, every=1, before=None):
    """Let each call of a work fail in each way, or each n-th; return how many there are and how the works ended.

    Every one of them begins in a copy of the folder `before`, or in an empty one.
    """
    prepared(work, folder, before)
    calls = forked(work, folder, at=10**9, kind=works.EIO)["calls"]
    fates = Counter()
    for name, kind in kinds.items():
        for at in all_places(calls)[every // 2 :: every]:
            prepared(work, folder, before)
            fate = forked(work, folder, at, kind)
            word = "killed" if fate["code"] == -9 else fate["fate"]
            assert word != "TRACEBACK", (work, name, at, fate["said"])
            assert fate["code"] in (0, -9), (work, name, at, fate)
            fates[f"{name}: {word}"] += 1
            try:
                judge(folder, word)
            except BaseException as error:
                raise AssertionError(f"{work}, {name} at call {at} of {calls}, {fate}: {error!r}") from error
    return calls, fates


BEFORE = b"what was there before"


def prepared(work, folder, before):
    shutil.rmtree(folder, ignore_errors=True)
    if before is None:
        folder.mkdir()
    else:
        shutil.copytree(before, folder)
    files.save(works.source(), folder.parent / "source.h5")
    if work == "convert":
        (folder / "out.mat").write_bytes(BEFORE)


def converted(folder, word):
    data = (folder / "out.mat").read_bytes()
    if data != BEFORE:
        back = files.read_record(folder / "out.mat")
        assert np.array_equal(back.outputs, works.source().outputs)
    assert word != "done" or data != BEFORE
    assert word == "killed" or not list(folder.glob(".*.part"))


@pytest.mark.parametrize("every", [40, pytest.param(1, marks=pytest.mark.slow)])
def test_every_call_of_a_recording_fails(forked, tmp_path, every):
    place = tmp_path / "records"
    calls, fates = struck(forked, "record", place, lambda folder, _: goes_on(folder), KINDS, every)
    print(f"recording, {calls} calls, every {every}: {dict(fates)}")


@pytest.mark.gate("40-0.3")
@pytest.mark.parametrize("stopped_at", [0.3, 0.8])
@pytest.mark.parametrize("every", [40, pytest.param(1, marks=pytest.mark.slow)])
def test_every_call_of_a_resumed_recording_fails(forked, tmp_path, every, stopped_at):
    """Going on after a kill is struck like the recording itself: in its recovery, its journal, what it measures."""
    before, place = tmp_path / "before", tmp_path / "records"
    before.mkdir()
    calls = forked("record", before, at=10**9, kind=works.EIO)["calls"]
    shutil.rmtree(before)
    before.mkdir()
    assert forked("record", before, round(stopped_at * calls), works.KILL)["code"] == -9
    calls, fates = struck(forked, "resume", place, lambda folder, _: goes_on(folder), KINDS, every, before)
    print(f"recording resumed after {stopped_at:.0%}, {calls} calls, every {every}: {dict(fates)}")


def test_every_call_of_a_conversion_fails(forked, tmp_path):
    calls, fates = struck(forked, "convert", tmp_path / "out", converted, KINDS)
    print(f"convert, {calls} calls: {dict(fates)}")


STUDY_KINDS = {name: kind for name, kind in KINDS.items() if name != "short"}


@pytest.mark.slow
@pytest.mark.parametrize("strikes", [12])
def test_calls_of_a_study_fail(forked, tmp_path, strikes):
    """A study is struck at calls evenly spread over all of them, and run again: the same numbers, no stray file."""
    whole = tmp_path / "whole"
    assert forked("study", whole)["fate"] == "done"
    wanted, files_of_it = numbers(whole), names(whole)
    place, fates = tmp_path / "struck", Counter()
    calls = forked("study", place, at=10**9, kind=works.EIO)["calls"]
    for name, kind in STUDY_KINDS.items():
        for k in range(strikes):
            at = 1 + (2 * k + 1) * (min(calls, MOST_CALLS) - 1) // (2 * strikes)
            shutil.rmtree(place, ignore_errors=True)
            fate = forked("study", place, at, kind)
            word = "killed" if fate["code"] == -9 else fate["fate"]
            assert word != "TRACEBACK", (name, at, fate["said"])
            fates[f"{name}: {word}"] += 1
            again = forked("study", place)
            assert again.get("fate") == "done", (name, at, fate, again)
            assert names(place) == files_of_it, (name, at, sorted(names(place) ^ files_of_it))
            assert numbers(place) == wanted, (name, at)
    print(f"study, {calls} calls, {strikes} of them struck in each way: {dict(fates)}")


def require_whole_stages(folder):
    """Fail on a stage that says it is there while something that it left is neither in its place nor waiting whole."""
    for path in (folder / entry.STAGES).glob("[!.]*.json"):
        found = entry.read(folder, path.stem)
        assert found is not None, f"{path.name} has its name and is not whole"
        for name, hashes in found.left.items():
            there = [contents.hashes_of(where(folder, name)) for where in (contents.place, contents.staged)]
            assert not hashes or hashes in there, (path.name, name)


def stopped_study(tiny, folder, stopped_at):
    """Return a folder of the tiny study, killed after a share of its calls; none of one that was not begun."""
    if not stopped_at:
        return None
    calls = tiny("tiny", folder, at=10**9, kind=works.EIO)["calls"]
    shutil.rmtree(folder)
    assert tiny("tiny", folder, round(stopped_at * calls), works.KILL)["code"] == -9
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("stopped_at", [0.0, 0.25, 0.5, 0.9])
def test_every_call_of_a_tiny_study_fails(tiny, tmp_path, share, stopped_at):
    """Each of the first calls to write, sync and name fails or is the last one; what a run leaves serves the next.

    A study from its beginning, and one that goes on where a kill stopped it. A drawn share of the calls in each way;
    `pytest --whole` strikes them all.
    """
    whole, place, fates, stages = tmp_path / "whole", tmp_path / "struck", Counter(), Counter()
    assert tiny("tiny", whole)["fate"] == "done"
    wanted, files_of_it = numbers(whole), names(whole)
    before = stopped_study(tiny, tmp_path / "before", stopped_at)

    def begun():
        shutil.rmtree(place, ignore_errors=True)
        if before is not None:
            shutil.copytree(before, place)

    begun()
    calls = tiny("tiny", place, at=10**9, kind=works.EIO)["calls"]
    for name, kind in STUDY_KINDS.items():
        places = share(all_places(calls), WALK)
        for at in places:
            begun()
            fate = tiny("tiny", place, at, kind)
            word = "killed" if fate["code"] == -9 else fate["fate"]
            assert word != "TRACEBACK", (name, at, fate["said"])
            fates[f"{name}: {word}"] += 1
            require_whole_stages(place)
            stages[name] += len(list(place.glob("stages/[!.]*.json")))
            again = tiny("tiny", place)
            assert again.get("fate") == "done", (name, at, fate, again)
            assert names(place) == files_of_it, (name, at, fate, sorted(names(place) ^ files_of_it))
            assert numbers(place) == wanted, (name, at, fate)
        print(f"tiny study, {name}: {len(places)} of {calls} calls struck, {stages[name]} stages kept")
    print(f"{sum(fates.values())} strikes: {dict(fates)}")


# The power-cut model: what was done since a file's last fsync is lost, in part or whole, and in any order.


def operations(trace):
    """Yield what was done to files, as the library wrote it down; a number that is given again is another file's."""
    data, at, ages = trace.read_bytes(), 0, Counter()
    while at + HEAD.size <= len(data):
        op, length, other, _, file, place, when = HEAD.unpack_from(data, at)
        at += HEAD.size
        ages[file] += op == b"c"
        written, path = data[at : at + length], data[at + length : at + length + other].decode()
        yield op.decode(), (file, ages[file]), place, written, path, when
        at += length + other


class Disk:
    """Files by number, names by path; each with what is safe and what is under way."""

    def __init__(self, root):
        self.root = str(root)
        self.safe, self.names, self.loose, self.moves = {}, {}, {}, []

    def do(self, op, file, place, data, other):
        """Take one operation."""
        if op in "wt":
            self.loose.setdefault(file, []).append((op, place, data))
        elif op == "s":
            self._write(file, self.loose.pop(file, []))
            self._name(self.moves)  # a journalling file system commits names with any sync
            self.moves = []
        else:
            self.moves.append((op, file, data.decode(), other))

    def _write(self, file, writes):
        held = self.safe.setdefault(file, bytearray())
        for op, place, data in writes:
            if op == "t":
                del held[place:]
            else:
                held.extend(bytes(max(0, place - len(held))))
                held[place : place + len(data)] = data

    def _name(self, moves):
        for op, file, source, path in moves:
            if op == "r":
                self.names.pop(source, None)
            if op == "u":
                self.names.pop(path, None)
            else:
                self.names[path] = file

    def cut(self, rng, folder):
        """Lose the power: leave in a folder what a disk may hold then."""
        for file, writes in self.loose.items():
            kept = [w for w in writes if rng.random() < 0.5]
            if kept and rng.random() < 0.5 and kept[-1][0] == "w":  # the last one is torn
                op, place, data = kept[-1]
                kept[-1] = (op, place, data[: int(rng.integers(len(data) + 1))])
            if rng.random() < 0.3:
                rng.shuffle(kept)
            self._write(file, kept)
        self._name(self.moves[: int(rng.integers(len(self.moves) + 1))])
        for path, file in self.names.items():
            target = folder / Path(path).relative_to(self.root)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(self.safe.get(file, b""))


def due(trace, count, root):
    """Return how many samples of which record were handed to the system more than 0.1 s before a cut."""
    done = list(operations(trace))[:count]
    names, written = {}, {}
    for op, file, _, data, other, when in done:
        if op in "crl" and other.endswith(".log"):
            names[file] = Path(other).stem
        if op == "w" and data[4:5] == b"D" and file in names:
            written.setdefault(names[file], []).append((when, struct.unpack_from("<I", data, 32)[0]))
    return {n: sum(m for when, m in rows if when < done[-1][5] - LOSS_S) for n, rows in written.items()}


@pytest.mark.parametrize("cuts", [4, pytest.param(200, marks=pytest.mark.slow)])
def test_power_cuts_cost_a_tenth_of_a_second(forked, tmp_path, cuts):
    place, trace = tmp_path / "records", tmp_path / "trace"
    place.mkdir()
    assert forked("paced", place, trace=trace)["fate"] == "done"
    done, rng = list(operations(trace)), np.random.default_rng(16)
    counts = Counter(op for op, *_ in done)
    assert counts["w"] > 15
    assert counts["s"] > 5
    lost = []
    for k in range(cuts):
        after = 1 + k * (len(done) - 1) // max(cuts - 1, 1) if cuts < len(done) else int(rng.integers(1, len(done) + 1))
        disk, left = Disk(place), tmp_path / "left"
        for op, file, at, data, other, _ in done[:after]:
            disk.do(op, file, at, data, other)
        shutil.rmtree(left, ignore_errors=True)
        left.mkdir()
        disk.cut(rng, left)
        recover(left)
        found = sound(left)
        for name, samples in due(trace, after, place).items():
            there = max((n for file, n in found.items() if file.partition(".")[0] == name), default=0)
            lost.append(max(0, samples - there))
            # One block may stand between two syncs besides.
            assert there >= samples - works.BLOCK, (after, name, samples, found)
        goes_on(left)
    print(f"{cuts} power cuts over {len(done)} operations ({dict(counts)}): {max(lost, default=0)} samples older than")
    print(f"{LOSS_S} s lost at most, nothing false read")
