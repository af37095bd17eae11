"""A process beside this one: its progress is shown, it is waited for, and it ends with the block."""

import fcntl
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from threading import Event

import pytest

from ultraquiet._base.beside import TICKS, Ticks, beside, numbered, turns
from ultraquiet._base.progress import listening, wanted_until

WORK = """
import sys, time
from ultraquiet._base.beside import Ticks
from ultraquiet._base.progress import listening, task
with listening(Ticks()), task("work", 7) as progress:
    for _ in range(7):
        progress.advance()
time.sleep(float(sys.argv[1]))
open(sys.argv[2], "w").close()
"""


class Heard:
    """Adds up what it is told."""

    def __init__(self):
        self.steps, self.open = 0, 0

    def start(self, title, total):
        self.open += 1
        return 0

    def advance(self, key, steps, note):
        self.steps += steps

    def finish(self, key):
        self.open -= 1


@pytest.fixture
def two_processors(monkeypatch):
    """Nothing is run beside on a machine with one."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)


@pytest.fixture
def work(tmp_path, monkeypatch):
    """Leaves the module `some_work` where Python finds it."""
    (tmp_path / "some_work.py").write_text(WORK)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    return tmp_path / "done"


def test_it_is_waited_for_and_its_progress_is_heard(work):
    heard = Heard()
    with listening(heard), beside("work", "some_work", "0", str(work)) as said:
        said.wait()
        assert work.exists()
    assert (heard.steps, heard.open) == (TICKS, 0)


def test_it_ends_with_the_block_whatever_happens_there(work):
    begun = time.perf_counter()
    with pytest.raises(ValueError, match="broken"), beside("work", "some_work", "60", str(work)):
        raise ValueError("broken")
    assert time.perf_counter() - begun < 20
    assert not work.exists()


def test_whoever_is_interrupted_waits_no_longer(work):
    interrupted = Event()
    interrupted.set()
    with beside("work", "some_work", "60", str(work)) as said, wanted_until(interrupted):
        with pytest.raises(KeyboardInterrupt):
            said.wait("a word that never comes")
        assert not said.ended


def test_what_cannot_be_run_leaves_no_trace_and_no_error(work):
    with beside("work", "no_such_module") as said:
        said.wait()
    with beside("work", "some_work", "0", str(work), wanted=False) as said:
        said.wait()
    assert not work.exists()


def test_ticks_never_exceed_the_bar(capsys):
    ticks = Ticks()
    for _ in range(3):  # the largest task counts, whatever came before
        ticks.start("some", 10)
        ticks.advance(0, 10, "")
    assert sum(map(int, capsys.readouterr().out.split())) == TICKS


READY = """
import sys
from ultraquiet._base.beside import end_with_parent
begun = end_with_parent()
print("ready", flush=True)
print("in time" if begun.wait(float(sys.argv[1])) else "on its own", flush=True)
"""


@pytest.mark.parametrize(("told", "word"), [(True, "in time"), (False, "on its own")])
def test_what_makes_itself_ready_begins_when_it_is_told(tmp_path, monkeypatch, told, word):
    (tmp_path / "ready_work.py").write_text(READY)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    with beside("work", "ready_work", "60" if told else "0.1") as said:
        said.wait("ready")
        assert not said.ended
        if told:
            said.begin()
        said.wait()
        said.begin()  # of one that has ended it is no error
        assert word in said._words


SHARED = """
import os, sys, time
from ultraquiet._base.beside import end_with_parent, turns
begun = end_with_parent()
for number in turns(int(sys.argv[1])):
    if number == int(sys.argv[2]):
        os._exit(3)
    print(f"job {number}", flush=True)
    time.sleep(0.05)  # so that the other comes to its turn
begun.wait()
"""


@contextmanager
def shared(tmp_path, monkeypatch, fatal):
    """Two processes that take forty numbers and then wait for a word; one ends where it comes to `fatal`."""
    (tmp_path / "shared_work.py").write_text(SHARED)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    with numbered(40) as numbers:
        words = str(numbers), str(fatal)
        with beside("work", "shared_work", *words, processes=2, holds=[numbers]) as said:
            yield said


@pytest.mark.usefixtures("two_processors")
def test_processes_take_every_number_once(tmp_path, monkeypatch):
    with shared(tmp_path, monkeypatch, -1) as said:
        for number in range(40):
            said.wait(f"job {number}")
        assert not said.ended  # both are there: one alone would wait as well, and one word would not end two
        said.begin()
        said.wait()
        assert said.ended
        assert said._words == {f"job {number}" for number in range(40)}


@pytest.mark.usefixtures("two_processors")
def test_nobody_waits_for_what_a_process_that_failed_had_taken(tmp_path, monkeypatch):
    with shared(tmp_path, monkeypatch, 30) as said:
        said.wait("job 30")
        assert said.ended
        assert "job 30" not in said._words


def test_numbers_come_in_order_and_end():
    with numbered(3) as numbers:
        assert list(turns(numbers)) == [0, 1, 2]
    with numbered(0) as numbers:
        assert list(turns(numbers)) == []


CHILD = """
import sys, time
from ultraquiet._base.beside import end_with_parent
end_with_parent()
open(sys.argv[1], "w").close()
time.sleep(600)
"""
PARENT = """
import fcntl, os, sys
from ultraquiet._base.beside import beside
lock = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT)
fcntl.flock(lock, fcntl.LOCK_EX)
with beside("work", "some_child", sys.argv[2], holds=[lock]) as said:
    said.wait()
"""


def test_a_killed_parent_s_lock_is_held_until_its_child_is_gone_too(tmp_path):
    (tmp_path / "some_child.py").write_text(CHILD)
    lock, up = tmp_path / "lock", tmp_path / "up"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", PARENT, str(lock), str(up)], env=environment) as parent:
        wait_for(up.exists)
        with lock.open("r+") as file:
            assert not free(file)
            parent.kill()
            parent.wait()
            wait_for(lambda: free(file))


def wait_for(happens, seconds=30.0):
    deadline = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def free(file):
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
