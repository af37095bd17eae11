"""One door for records from outside: the suffix decides who reads."""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files.archive import load_many
from ultraquiet.files.atomic import reason
from ultraquiet.files.matlab import read_mat
from ultraquiet.files.plain import read_npz, read_text
from ultraquiet.files.select import Choice, chosen, to_record
from ultraquiet.files.table import Column, Table
from ultraquiet.values import Channel, Record

_Path = str | os.PathLike[str]

ARCHIVES = (".h5", ".hdf5")
READERS: Mapping[str, Callable[[str, bytes], Table]] = MappingProxyType(
    {
        ".csv": read_text,
        ".tsv": read_text,
        ".txt": read_text,
        ".dat": read_text,
        ".asc": read_text,
        ".mat": read_mat,
        ".npz": read_npz,
    }
)


def read_record(path: _Path, rate_hz: float | None = None, inputs: Choice = None, outputs: Choice = None) -> Record:
    r"""Read a record from an archive, CSV, MAT or NPZ file.

    What goes in and what comes out is taken, in this order, from `inputs` and `outputs`; from names that say so
    (`u`, `y`, `inputs`, `output 2`, ...); from the order, when one table has just two columns. The rate is taken from
    `rate_hz`; from a scalar called `fs`, `rate_hz`, `dt`, ...; from a column called `time` or `t` (seconds unless its
    unit says otherwise), which must be even.

    Args:
        path: `.h5` (an archive), `.csv`, `.tsv`, `.txt`, `.dat`, `.mat` or `.npz`.
        rate_hz: samples per second, when the file does not say; it overrides what the file says.
        inputs: columns by name (`"iq_refx"`, `"motor,load"`, a list) or counted from one (`"1-2"`, `"data:3-30"`).
        outputs: likewise.

    Raises:
        StorageError: the file is missing or cannot be read.
        InputError: unknown suffix, no rate, uneven time, or no telling what goes in and what comes out; the message
            says what the file holds.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "run.csv"
    ...     size = path.write_text("time [s], force [N], strut 1 [V], strut 2 [V]\n0,1,0,0\n0.5,0,2,3\n")
    ...     record = read_record(path, inputs="force", outputs="strut 1, strut 2")
    >>> record.rate_hz, record.sensors[1].name, record.sensors[1].unit, record.outputs.tolist()
    (2.0, 'strut 2', 'V', [[0.0, 2.0], [0.0, 3.0]])
    """
    suffix = Path(path).suffix.lower()
    if suffix in ARCHIVES:
        return _archived(path, rate_hz, inputs, outputs)
    if suffix not in READERS:
        raise InputError(f"read_record: '{path}' has none of the suffixes {', '.join((*ARCHIVES, *READERS))}.")
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise StorageError(f"read_record: '{path}' cannot be read ({reason(error)}).") from error
    table = READERS[suffix](Path(path).name, data)
    return to_record(table, rate_hz, inputs, outputs, hashlib.sha256(data).hexdigest())


def _archived(path: _Path, rate_hz: float | None, inputs: Choice, outputs: Choice) -> Record:
    records = {name: value for name, value in load_many(path).items() if isinstance(value, Record)}
    if len(records) != 1:
        held = f"{len(records)} records ({', '.join(records)})" if records else "no record"
        raise InputError(f"read_record: '{path}' holds {held}; it would take a file with one record.")
    (record,) = records.values()
    picked = record.pick(_places(path, record.actuators, inputs), _places(path, record.sensors, outputs))
    if rate_hz is not None and rate_hz != record.rate_hz:
        raise InputError(
            f"read_record: '{path}' was recorded at {record.rate_hz:g} Hz; it cannot be read at {rate_hz:g} Hz."
        )
    return picked


def _places(path: _Path, held: Sequence[Channel], choice: Choice) -> list[int] | None:
    if choice is None:
        return None
    empty = np.zeros(0)
    table = Table(Path(path).name, tuple(Column(c.name, empty, c.unit) for c in held))
    return [table.columns.index(column) for column in chosen(table, choice)]
