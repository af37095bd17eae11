"""The journal of a folder of records: what was begun is written down before the bench moves.

So no excitation of a run that was killed is repeated by mistake. Each line is the CRC-32 of an entry in hexadecimal,
a blank, and the entry as JSON. A line that was being written when the power went lacks its end; it is the last one,
and is dropped: what it announces had not begun.
"""

import json
import os
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import StorageError
from ultraquiet._base.regular import check_regular, parse_json, read_regular
from ultraquiet.files import reason
from ultraquiet.files.names import inside, is_plain, quoted

FILE = "journal.txt"
# What reads a file for a process lets go of that one's locks as soon as it runs. Where the process is killed before,
# its lock is held until then.
PATIENCE_S, PAUSE_S = 1.0, 0.01


def entries(folder: Path) -> list[dict[str, Any]]:
    """Return the entries of a folder's journal, oldest first; none when there is no journal.

    Raises:
        StorageError: the journal cannot be read, is damaged before its last line, or holds a sound line that is no
            entry: another layout, or a name that is no file's name.
    """
    path = folder / FILE
    try:
        data = read_regular(path)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StorageError(f"journal: '{path}' cannot be read ({reason(error)}).") from error
    return [entry for entry, _ in _sound(path, data)]


def begun(folder: Path) -> dict[str, str]:
    """Return name -> hash of every measurement that was ever begun in a folder."""
    return {e["name"]: e["hash"] for e in entries(folder) if e["event"] == "begun"}


def shares(folder: Path) -> dict[str, float]:
    """Return hash -> share of its level at which a measurement is sent, of those whose level was found."""
    return {e["hash"]: float(e["share"]) for e in entries(folder) if e["event"] == "levelled"}


def busy(folder: Path) -> bool:
    """Return whether a process is executing a list into a folder now."""
    try:
        check_regular(folder / FILE)
        handle = os.open(folder / FILE, os.O_RDWR)
    except OSError:
        return False
    try:
        _lock(folder / FILE, handle)
    except StorageError:
        return True
    finally:
        os.close(handle)
    return False


class Journal:
    """An open journal; use `opened`."""

    def __init__(self, path: Path, handle: int) -> None:
        self._path = path
        self._handle = handle

    def write(self, event: str, **what: Any) -> None:
        """Append an entry and wait until the disk has it.

        Raises:
            StorageError: the disk is full or gone; what was written before stays.
        """
        body = json.dumps({"event": event, **what}, sort_keys=True).encode()
        line = memoryview(_framed(body))
        try:
            while line:
                line = line[os.write(self._handle, line) :]
            os.fsync(self._handle)
        except OSError as error:
            raise StorageError(f"journal: '{self._path}' cannot be written ({reason(error)}).") from error


@contextmanager
def opened(folder: Path) -> Iterator[Journal]:
    """Open the journal of a folder for one process alone, after dropping a last line that was cut short.

    Raises:
        StorageError: another process executes a list into this folder, or the journal cannot be opened.
    """
    path = inside("journal", folder, FILE)
    try:
        if os.path.lexists(path):
            check_regular(path)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    except OSError as error:
        raise StorageError(f"journal: '{path}' cannot be opened ({reason(error)}).") from error
    try:
        _lock(path, handle, PATIENCE_S)
        try:
            ends = [end for _, end in _sound(path, read_regular(path))]
            os.truncate(handle, max(ends, default=0))
        except OSError as error:
            if isinstance(error, StorageError):
                raise
            raise StorageError(f"journal: '{path}' cannot be read ({reason(error)}).") from error
        yield Journal(path, handle)
    finally:
        os.close(handle)


def _framed(body: bytes) -> bytes:
    return b"%08x %s\n" % (zlib.crc32(body), body)


def _sound(path: Path, data: bytes) -> Iterator[tuple[dict[str, Any], int]]:
    """Yield each sound entry and where it ends."""
    end = 0
    for line in data.splitlines(keepends=True):
        body = line[9:-1]
        if _framed(body) != line:
            # A line with an end was whole once: it is damaged, not torn, and dropping it would forget a run.
            if b"\n" in data[end:]:
                raise StorageError(f"journal: '{path}' is damaged at byte {end}; move the folder's records elsewhere.")
            return
        entry = _entry(path, body, end)
        end += len(line)
        yield entry, end


def _entry(path: Path, body: bytes, at: int) -> dict[str, Any]:
    """Return the entry of a sound line, whose names become paths: a sum says that it is whole, not who wrote it."""
    try:
        entry = parse_json(body)
        names = _names(entry)
    except (ValueError, KeyError, TypeError):
        raise StorageError(
            f"journal: '{path}' holds at byte {at} what is no entry; move the folder's records elsewhere."
        ) from None
    for name in names:
        if not is_plain(name):
            raise StorageError(
                f"journal: '{path}' names {quoted(name)} at byte {at}, which is no name of a file in its folder; move "
                "the folder's records elsewhere."
            )
    return entry


def _names(entry: Any) -> list[Any]:
    """Return the names of measurements in an entry."""
    event = entry["event"]
    if event == "planned":
        return [measurement["name"] for measurement in entry["measurements"]]
    if event not in ("begun", "aborted", "finished", "levelled"):
        return []
    if not isinstance(entry["hash"], str):
        raise TypeError(entry["hash"])
    return [entry["name"]]


def _lock(path: Path, handle: int, patience_s: float = 0.0) -> None:
    if os.name == "nt":
        return
    import fcntl

    started = time.monotonic()
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() - started >= patience_s:
                raise StorageError(f"journal: another process is executing a list into '{path.parent}'.") from None
        time.sleep(PAUSE_S)
