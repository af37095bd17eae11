"""The catalogue of a folder tree of records: what was measured, how, and in which file; SQLite, made from the files.

Records and journals are the truth: the catalogue is brought up to date whenever it is asked, and may be deleted or
damaged at any time. Several processes may ask at once; where none can be kept, on a read-only folder for instance, it
is made in memory.
"""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import astuple, fields
from datetime import UTC, datetime
from pathlib import Path

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.experiments import journal
from ultraquiet.experiments.entry import RUNNING, Entry, of_file, of_journal
from ultraquiet.experiments.states import ABORTED, DONE, NOT_STARTED
from ultraquiet.files import reason

FILE = "catalogue.sqlite"
STATUSES = (DONE, ABORTED, NOT_STARTED, RUNNING)
ENDINGS = ("", "-wal", "-shm", "-journal")  # of the files that SQLite keeps
LAYOUT = 2  # of the tables; a catalogue of another layout is made anew
PATIENCE_S = 30.0  # how long to wait for another process that is writing

_COLUMNS = tuple(field.name for field in fields(Entry))


def find(folder: str | os.PathLike[str], **criteria: str | float) -> tuple[Entry, ...]:
    """Return the runs below a folder that meet all criteria, by file name.

    Args:
        folder: where to look; records in folders inside it count too.
        criteria: fields of `Entry` and the values they must have, as in `signal="chirp", actuators="2"`.

    Raises:
        InputError: a criterion that is no field of an entry.
        StorageError: the folder cannot be read.

    >>> import tempfile
    >>> from ultraquiet.files import save
    >>> from ultraquiet.values import Record
    >>> with tempfile.TemporaryDirectory() as place:
    ...     path = save(Record([[1.0, 0.0]], [[0.1, 0.3]], rate_hz=3500.0), Path(place) / "push.h5")
    ...     [(entry.name, entry.samples) for entry in find(place, rate_hz=3500.0)]
    [('push', 2)]
    """
    unknown = [key for key in criteria if key not in _COLUMNS]
    if unknown:
        raise InputError(f"catalogue: records are not known by '{unknown[0]}', only by {', '.join(_COLUMNS)}.")
    condition = " AND ".join(["1", *(f'"{key}" = ?' for key in criteria)])
    return _answer(folder, f"{condition} ORDER BY file, folder, name", tuple(criteria.values()))


def search(
    folder: str | os.PathLike[str], what: str = "", bench: str = "", since: str = "", status: str = "", list: str = ""
) -> tuple[Entry, ...]:
    """Return the runs below a folder in which all that is given is found, oldest first.

    Args:
        folder: where to look; folders inside it count too.
        what: a part of the run's name, signal, disturbance, controller, comment or file, in any case.
        bench: a part of the bench's name or settings.
        since: a date or time in ISO 8601, local unless it says otherwise; only runs that began then or later.
        status: DONE, ABORTED, NOT STARTED or RUNNING, in any case; hyphens stand for blanks.
        list: a part of the list's title, or the beginning of its hash.

    Raises:
        InputError: a time or status that is none.
        StorageError: the folder cannot be read.
    """
    conditions, values = ["1"], []
    for words, columns in (
        (what, ("name", "signal", "disturbance", "controller", "comment", "file")),
        (bench, ("bench", "bench_settings")),
        (list, ("list",)),
    ):
        if words:
            anywhere = " OR ".join(f'instr(lower("{column}"), lower(?))' for column in columns)
            hashed = " OR list_hash LIKE ? || '%'" if columns == ("list",) else ""
            conditions.append(f"({anywhere}{hashed})")
            values += [words] * (len(columns) + bool(hashed))
    if since:
        conditions.append('"when" >= ?')
        values.append(_utc(since))
    if status:
        conditions.append("status = ?")
        values.append(_status(status))
    return _answer(folder, " AND ".join(conditions) + ' ORDER BY "when" = \'\', "when", file, name', tuple(values))


def rebuild(folder: str | os.PathLike[str]) -> int:
    """Make the catalogue of a folder anew from its files and return how many runs it knows."""
    _remove(Path(folder))
    return len(find(folder))


def _utc(since: str) -> str:
    try:
        return datetime.fromisoformat(since).astimezone(UTC).isoformat(timespec="milliseconds")
    except (ValueError, OverflowError, OSError):
        raise InputError(
            f"catalogue: '{since}' is no time; write a date, as in 2026-03-31, or 2026-03-31T14:00."
        ) from None


def _status(status: str) -> str:
    meant = status.upper().replace("-", " ").replace("_", " ")
    if meant not in STATUSES:
        raise InputError(f"catalogue: there is no status '{status}', only {', '.join(STATUSES)}.")
    return meant


def _answer(folder: str | os.PathLike[str], condition: str, values: tuple[str | float, ...]) -> tuple[Entry, ...]:
    place = Path(folder)
    if not place.is_dir():
        raise StorageError(f"catalogue: '{folder}' is no folder.")
    if not _is_own(place):
        return _from(":memory:", place, condition, values)
    try:
        return _from(place / FILE, place, condition, values)
    except sqlite3.OperationalError:
        # A folder that may not be written, a full disk, a file system without locks: the answer needs none of them.
        return _from(":memory:", place, condition, values)
    except sqlite3.DatabaseError:
        # It is damaged, and nothing is lost with it.
        _remove(place)
        try:
            return _from(place / FILE, place, condition, values)
        except sqlite3.DatabaseError:
            return _from(":memory:", place, condition, values)


def _from(path: Path | str, place: Path, condition: str, values: tuple[str | float, ...]) -> tuple[Entry, ...]:
    with _opened(path) as base:
        _update(base, place)
        rows = base.execute(f"SELECT {_quoted()} FROM runs WHERE {condition}", values)
        return tuple(Entry(*row) for row in rows)


def _is_own(place: Path) -> bool:
    """Return whether nothing under the catalogue's names is a link, which SQLite would follow, or a pipe."""
    paths = [place / (FILE + ending) for ending in ENDINGS]
    return all(path.is_file() and not path.is_symlink() for path in paths if os.path.lexists(path))


def _remove(place: Path) -> None:
    for ending in ENDINGS:
        try:
            (place / (FILE + ending)).unlink(missing_ok=True)
        except OSError as error:
            raise StorageError(f"catalogue: '{place / FILE}' cannot be removed ({reason(error)}).") from error


@contextmanager
def _opened(path: Path | str) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path, timeout=PATIENCE_S, isolation_level=None)) as base:
        if base.execute("PRAGMA journal_mode").fetchone()[0] == "delete":
            # Whoever reads need not wait for whoever writes; a file system that cannot do so keeps its own way.
            with suppress(sqlite3.OperationalError):
                base.execute("PRAGMA journal_mode = WAL")
        with _writing(base):
            if base.execute("PRAGMA user_version").fetchone()[0] != LAYOUT:
                for table in ("runs", "others", "records"):
                    base.execute(f"DROP TABLE IF EXISTS {table}")
                base.execute(f"CREATE TABLE runs ({_quoted()}, stamp)")
                # A file that is no record is remembered too, or it would be opened again and again.
                base.execute("CREATE TABLE others (file PRIMARY KEY, stamp)")
                base.execute(f"PRAGMA user_version = {LAYOUT}")
        yield base


@contextmanager
def _writing(base: sqlite3.Connection) -> Iterator[None]:
    """Hold the catalogue for one process from its first look to its last change."""
    base.execute("BEGIN IMMEDIATE")
    try:
        yield
        base.execute("COMMIT")
    except BaseException:
        with suppress(sqlite3.Error):
            base.execute("ROLLBACK")
        raise


def _quoted() -> str:
    return ", ".join(f'"{column}"' for column in _COLUMNS)


def _update(base: sqlite3.Connection, place: Path) -> None:
    """Enter what is new or changed, drop what is gone."""
    stamps = {path.relative_to(place).as_posix(): _stamp(path) for path in place.rglob("*.h5") if path.is_file()}
    present = {file: stamp for file, stamp in stamps.items() if stamp}
    known = dict(base.execute("SELECT file, stamp FROM runs WHERE stamp != '' UNION SELECT file, stamp FROM others"))
    # Files are read before the catalogue is held: another process may do the same work, and none waits for it.
    fresh = {file: of_file(place, file) for file, stamp in present.items() if known.get(file) != stamp}
    with _writing(base):
        for file in (known.keys() - present.keys()) | fresh.keys():
            base.execute("DELETE FROM runs WHERE file = ?", (file,))
            base.execute("DELETE FROM others WHERE file = ?", (file,))
        for file, entry in fresh.items():
            if entry is None:
                base.execute("INSERT INTO others VALUES (?, ?)", (file, present[file]))
            else:
                _insert(base, entry, present[file])
        base.execute("DELETE FROM runs WHERE stamp = ''")
        filed = [Entry(*row) for row in base.execute(f"SELECT {_quoted()} FROM runs")]
        for path in place.rglob(journal.FILE):
            for entry in of_journal(place, path, filed):
                _insert(base, entry, "")


def _insert(base: sqlite3.Connection, entry: Entry, stamp: str) -> None:
    base.execute(f"INSERT INTO runs VALUES ({', '.join('?' * (len(_COLUMNS) + 1))})", (*astuple(entry), stamp))


def _stamp(path: Path) -> str:
    try:
        status = path.stat()
    except OSError:
        return ""  # gone since the folder was read
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ino}"
