"""A log on a disk that is full or failing: a clear sentence, and every finished block is kept and readable."""

import errno
import os
import resource
import signal
import subprocess
import sys

import numpy as np
import pytest

from ultraquiet._base.errors import StorageError
from ultraquiet._base.provenance import Provenance
from ultraquiet.files import LogWriter, finalise, log_header, read_log
from ultraquiet.values import Channel

WORDS = {errno.ENOSPC: "no space left on device", errno.EIO: "input/output error"}


@pytest.fixture
def header():
    return log_header([Channel("u")], [Channel("y")], 3500.0, 1750, Provenance())


def fails_after(calls, error, partly=0):
    """Return a stand-in for os.write or os.fdatasync that fails from the n-th call on, perhaps with half a write."""
    count = 0

    def stands_in(whole):
        def call(handle, *data):
            nonlocal count
            count += 1
            if count <= calls:
                return whole(handle, *data)
            if count == calls + 1 and partly and data:
                return whole(handle, bytes(data[0])[:partly])
            raise OSError(error, os.strerror(error))

        return call

    return stands_in


@pytest.mark.parametrize("error", WORDS, ids=errno.errorcode.get)
@pytest.mark.parametrize("partly", [0, 1, 51, 52, 600])
@pytest.mark.parametrize("calls", [0, 1, 5])
def test_writing_fails(calls, partly, error, header, rng, tmp_path, monkeypatch):
    path, whole = tmp_path / "a.log", rng.standard_normal((2, 10, 175))
    with LogWriter(path, header) as log:
        monkeypatch.setattr("os.write", fails_after(calls, error, partly)(os.write))
        for block in range(calls):
            log.append(whole[:, block])
        with pytest.raises(StorageError, match=WORDS[error]) as caught:
            log.append(whole[:, calls])
        assert str(path) in str(caught.value)
        assert f"{175 * calls} samples before are in it" in str(caught.value)
        monkeypatch.undo()
        # Once it has failed it takes nothing more: behind a gap the samples would stand in the wrong place.
        with pytest.raises(StorageError, match=WORDS[error]):
            log.append(whole[:, calls + 1])
        with pytest.raises(StorageError, match=WORDS[error]):
            log.close(complete=True)
    kept = read_log(path)
    assert (kept.ended, kept.complete, kept.lost_bytes) == (False, False, 0)
    assert np.array_equal(kept.samples, whole[:, :calls].reshape(2, -1))


@pytest.mark.parametrize("error", WORDS, ids=errno.errorcode.get)
def test_syncing_fails(error, header, rng, tmp_path, monkeypatch):
    path, whole = tmp_path / "a.log", rng.standard_normal((2, 10, 175))
    monkeypatch.setattr("ultraquiet.files.log.SYNC_S", 0.0)
    with LogWriter(path, header) as log:
        monkeypatch.setattr("os.fdatasync", fails_after(3, error)(os.fdatasync))
        for block in range(3):
            log.append(whole[:, block])
        with pytest.raises(StorageError, match=f"could not be forced to the disk \\({WORDS[error]}\\)") as caught:
            log.append(whole[:, 3])
    print(caught.value)
    kept = read_log(path)
    assert np.array_equal(kept.samples, whole[:, :4].reshape(2, -1))
    assert not kept.complete


@pytest.mark.parametrize("error", WORDS, ids=errno.errorcode.get)
def test_the_end_fails(error, header, rng, tmp_path, monkeypatch):
    path, block = tmp_path / "a.log", rng.standard_normal((2, 175))
    with LogWriter(path, header) as log:
        log.append(block)
        monkeypatch.setattr("os.write", fails_after(0, error, partly=70)(os.write))
        with pytest.raises(StorageError, match=WORDS[error]):
            log.close(complete=True)
    kept = read_log(path)
    assert (kept.complete, kept.ended, kept.lost_bytes) == (False, False, 0)
    assert np.array_equal(kept.samples, block)


@pytest.mark.parametrize("error", WORDS, ids=errno.errorcode.get)
def test_the_beginning_fails(error, header, tmp_path, monkeypatch):
    monkeypatch.setattr("os.fsync", fails_after(0, error)(os.fsync))
    with pytest.raises(StorageError, match=WORDS[error]):
        LogWriter(tmp_path / "a.log", header)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", WORDS, ids=errno.errorcode.get)
def test_finalise_fails_and_can_be_asked_again(error, header, rng, tmp_path, monkeypatch):
    path, block = tmp_path / "a.log", rng.standard_normal((2, 175))
    with LogWriter(path, header) as log:
        log.append(block)
        log.close(complete=True)
    monkeypatch.setattr("os.fsync", fails_after(0, error)(os.fsync))
    with pytest.raises(StorageError, match=WORDS[error]):
        finalise(path, tmp_path / "a.h5")
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == ["a.log"]
    assert np.array_equal(finalise(path, tmp_path / "a.h5").inputs, block[:1])


SCRIPT = """\
import sys
import numpy as np
from ultraquiet._base.provenance import Provenance
from ultraquiet.files import LogWriter, log_header
from ultraquiet.values import Channel
with LogWriter(sys.argv[1], log_header([Channel("u")], [Channel("y")], 3500.0, 17500, Provenance())) as log:
    for start in range(0, 17500, 175):
        log.append(np.arange(start, start + 175) + np.array([[0.0], [0.5]]))
        print(log.samples, flush=True)
"""


def test_a_disk_that_is_really_full(tmp_path):
    """The system itself refuses the byte after 100 000: what it took of that block is taken back."""

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    path = tmp_path / "a.log"
    words = [sys.executable, "-c", SCRIPT, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=limit, check=False)
    said, last = int(done.stdout.split()[-1]), done.stderr.strip().splitlines()[-1]
    print(last)
    assert f"'{path}' could not be written (file too large); {said} samples before are in it." in last
    kept = read_log(path)
    assert kept.samples.shape[1] == said >= 5775
    assert np.array_equal(kept.samples[0], np.arange(said))
    assert (kept.lost_bytes, kept.ended) == (0, False)
