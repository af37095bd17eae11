"""The catalogue of a folder tree of records: what was measured, how, and in which file; SQLite, made from the records.

The records are the truth: the catalogue is brought up to date whenever it is asked, and may be deleted at any time.
"""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files import load_many, reason
from ultraquiet.values import Record

FILE = "catalogue.sqlite"


@dataclass(frozen=True)
class Entry:
    """One record: its file below the folder, and what a person would look for.

    `signal` and `actuators` (counted from one, with commas) are empty for a record without excitation, `made_by` names
    what made a record that no list made; `clipped` counts readings at the limits of their sensors.
    """

    file: str
    name: str
    made_by: str
    list: str
    signal: str
    actuators: str
    disturbance: str
    controller: str
    rate_hz: float
    samples: int
    clipped: int
    hash: str


_COLUMNS = tuple(field.name for field in fields(Entry))


def find(folder: str | os.PathLike[str], **criteria: str | float) -> tuple[Entry, ...]:
    """Return the records below a folder that meet all criteria, by file name.

    Args:
        folder: where to look; records in folders inside it count too.
        criteria: fields of `Entry` and the values they must have, as in `signal="chirp", actuators="2"`.

    Raises:
        InputError: a criterion that is no field of an entry.
        StorageError: the folder or its catalogue cannot be read or written.

    >>> import tempfile
    >>> from ultraquiet.files import save
    >>> with tempfile.TemporaryDirectory() as place:
    ...     path = save(Record([[1.0, 0.0]], [[0.1, 0.3]], rate_hz=3500.0), Path(place) / "push.h5")
    ...     [(entry.name, entry.samples) for entry in find(place, rate_hz=3500.0)]
    [('push', 2)]
    """
    unknown = [key for key in criteria if key not in _COLUMNS]
    if unknown:
        raise InputError(f"catalogue: records are not known by '{unknown[0]}', only by {', '.join(_COLUMNS)}.")
    place = Path(folder)
    if not place.is_dir():
        raise StorageError(f"catalogue: '{folder}' is no folder.")
    asked = " AND ".join(["1", *(f'"{key}" = ?' for key in criteria)])
    with _opened(place) as base:
        _update(base, place)
        rows = base.execute(f"SELECT {_quoted()} FROM records WHERE {asked} ORDER BY file", tuple(criteria.values()))
        return tuple(Entry(*row) for row in rows)


@contextmanager
def _opened(place: Path) -> Iterator[sqlite3.Connection]:
    path = place / FILE
    try:
        with closing(sqlite3.connect(path)) as base, base:
            base.execute(f"CREATE TABLE IF NOT EXISTS records ({_quoted()}, stamp, PRIMARY KEY (file))")
            # A file that is no record is remembered too, or it would be opened again and again.
            base.execute("CREATE TABLE IF NOT EXISTS others (file PRIMARY KEY, stamp)")
            yield base
    except sqlite3.Error as error:
        raise StorageError(f"catalogue: '{path}' fails ({reason(error)}); it may be deleted, records stay.") from error


def _quoted() -> str:
    return ", ".join(f'"{column}"' for column in _COLUMNS)


def _update(base: sqlite3.Connection, place: Path) -> None:
    """Enter what is new or changed, drop what is gone."""
    there = {path.relative_to(place).as_posix(): _stamp(path) for path in place.rglob("*.h5") if path.is_file()}
    known = dict(base.execute("SELECT file, stamp FROM records UNION SELECT file, stamp FROM others"))
    for file in known.keys() - {f for f, stamp in there.items() if known.get(f) == stamp}:
        base.execute("DELETE FROM records WHERE file = ?", (file,))
        base.execute("DELETE FROM others WHERE file = ?", (file,))
    for file, stamp in there.items():
        if known.get(file) != stamp:
            entry = _entry(place, file)
            if entry is None:
                base.execute("INSERT INTO others VALUES (?, ?)", (file, stamp))
            else:
                marks = ", ".join("?" * (len(_COLUMNS) + 1))
                base.execute(f"INSERT INTO records VALUES ({marks})", (*astuple(entry), stamp))


def _stamp(path: Path) -> str:
    status = path.stat()
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ino}"


def _entry(place: Path, file: str) -> Entry | None:
    """Return the entry of a file, or None when it holds no single record."""
    try:
        held = list(load_many(place / file).values())
    except StorageError:
        return None
    if len(held) != 1 or not isinstance(held[0], Record):
        return None
    record, made = held[0], held[0].provenance
    measured = made.settings.get("measurement", {})
    drives = measured.get("excitation", [])
    return Entry(
        file,
        measured.get("name", Path(file).stem),
        made.made_by,
        made.settings.get("list", ""),
        ",".join(sorted({d["method"] for d in drives})),
        ",".join(str(d["actuator"]) for d in drives),
        ",".join(sorted({d["method"] for d in measured.get("disturbance", [])})),
        measured.get("controller", ""),
        record.rate_hz,
        record.samples,
        sum(record.clipped()),
        record.hash,
    )
