"""Full disks, kills and torn journals: what is finished stays, and nothing is lost."""

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from threading import Timer

import pytest
from fakes import LIST, Fake, run

from ultraquiet import files
from ultraquiet._base.errors import StorageError
from ultraquiet.experiments import journal

FAKES = Path(__file__).with_name("fakes.py")


@pytest.fixture
def bench():
    return Fake()


@pytest.mark.parametrize("at", [1, 2, 3, 5, 6])
def test_a_full_disk_keeps_what_is_finished(at, bench, tmp_path, monkeypatch):
    """The disk is full at the n-th fsync; a measurement takes five (journal, record, folder, journal)."""
    whole, count = os.fsync, 0

    def full(handle):
        nonlocal count
        count += 1
        if count >= at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        whole(handle)

    (tmp_path / "other.h5").write_bytes(b"precious")
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(StorageError, match="no space left on device") as caught:
        run(LIST, tmp_path, bench)
    monkeypatch.undo()
    print(caught.value)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "other.h5").read_bytes() == b"precious"
    kept = sorted(p.name for p in tmp_path.glob("*.h5") if p.name != "other.h5")
    assert not list(tmp_path.glob(".*.part"))
    for name in kept:
        assert files.read_record(tmp_path / name).samples == 256
    assert len(kept) >= len(bench.calls) - 1


SCRIPT = """\
import sys, h5py, importlib.util as u
from ultraquiet import experiments
spec = u.spec_from_file_location("experiment_fakes", sys.argv[1])
fakes = u.module_from_spec(spec)
spec.loader.exec_module(fakes)
folder, repeat = sys.argv[3], sys.argv[4:]
listed = experiments.parse(open(sys.argv[2]).read(), fakes.Fake())
print("ready", flush=True)
experiments.run(listed, folder, resume=True, repeat=repeat, sleep=lambda _: None)
"""


def test_a_really_full_disk(bench, tmp_path):
    """The system itself refuses to let a file grow beyond 20 kB: records of 256 samples fit, one of 4096 does not."""
    (tmp_path / "list.toml").write_text(LIST + '[[commands]]\ndo = "record"\nname = "long"\nsamples = 4096\n')
    words = [sys.executable, "-c", SCRIPT, str(FAKES), str(tmp_path / "list.toml"), str(tmp_path / "out")]

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))

    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=limit, check=False)
    last = done.stderr.strip().splitlines()[-1]
    print(last)
    assert "experiment stopped at 'long', 4 records are finished and safe" in last
    assert sorted(p.name for p in (tmp_path / "out").glob("*.h5")) == [
        "chirp-1.h5",
        "chirp-2.h5",
        "quiet.h5",
        "tone.h5",
    ]
    for path in (tmp_path / "out").glob("*.h5"):
        files.read_record(path)


def test_too_little_space_is_told_before_anything_moves(bench, tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: os.terminal_size((0, 0)) and type("U", (), {"free": 1000})())
    with pytest.raises(StorageError, match=r"need 0\.3 MB, .* has 0\.0 MB free; nothing was executed"):
        run(LIST, tmp_path, bench)
    assert not bench.calls


def test_a_torn_journal_line_is_dropped_and_a_damaged_one_refused(bench, tmp_path):
    run(LIST, tmp_path, bench)
    path = tmp_path / journal.FILE
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for cut in range(1, len(lines[-1])):
        path.write_bytes(whole[:-cut])
        assert len(journal.entries(tmp_path)) == len(lines) - 1
    run(LIST, tmp_path, bench, resume=True)
    assert path.read_bytes() == b"".join(lines[:-1])
    path.write_bytes(whole[:20] + b"X" + whole[21:])
    with pytest.raises(StorageError, match="damaged at byte 0"):
        run(LIST, tmp_path, bench, resume=True)


def test_two_lists_do_not_share_a_folder_at_once(bench, tmp_path):
    with journal.opened(tmp_path), pytest.raises(StorageError, match="another process"):
        run(LIST, tmp_path, bench)


HELD = """
import fcntl, os, signal, subprocess, sys
handle = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT)
fcntl.flock(handle, fcntl.LOCK_EX)
subprocess.Popen(["cat"], pass_fds=(handle,))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_lock_that_outlives_its_process_for_a_moment_is_waited_for(bench, tmp_path):
    """What reads files for a process begins with all that one holds, and lets go of it once it runs."""
    words = [sys.executable, "-c", HELD, str(tmp_path / journal.FILE)]
    with subprocess.Popen(words, stdin=subprocess.PIPE) as killed:
        assert killed.wait() == -signal.SIGKILL
        assert killed.stdin is not None
        assert journal.busy(tmp_path)
        Timer(0.2, killed.stdin.close).start()
        assert run(LIST, tmp_path, bench)
