"""Records for other programs: text columns and MATLAB files, which `read_record` reads back bit for bit."""

import csv
import io
import os
from pathlib import Path

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.files.atomic import write_bytes
from ultraquiet.values import Channel, Record


def export_record(record: Record, path: str | os.PathLike[str], overwrite: bool = True) -> Path:
    """Write a record as `.csv` (time, inputs, outputs side by side) or `.mat` (u, y, fs, names and units).

    Channels, limits and provenance survive in an archive only; see `save`.

    Args:
        record: what to write.
        path: the file; its suffix decides the format.
        overwrite: False refuses a name that is taken.

    Raises:
        InputError: another suffix.
        StorageError: disk full, folder missing or closed, name taken; what was there before is untouched.

    >>> import tempfile
    >>> from ultraquiet.files import read_record
    >>> record = Record([[1.0, 0.0]], [[0.1, 0.3]], 3500.0, ["force"], ["speed"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = export_record(record, Path(folder) / "run.csv")
    ...     read_record(path, record.rate_hz, "force", "speed").outputs
    array([[0.1, 0.3]])
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".csv":
        return write_bytes(path, _csv(record), overwrite)
    if suffix == ".mat":
        return write_bytes(path, _mat(record), overwrite)
    raise InputError(f"export_record: '{path}' has neither of the suffixes .csv and .mat.")


def _header(channel: Channel) -> str:
    return f"{channel.name} [{channel.unit}]" if channel.unit else channel.name


def _csv(record: Record) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    # Input and output may share a name: a strut has an actuator and a sensor.
    names = [f"{kind} {_header(c)}" for kind, cs in (("u", record.actuators), ("y", record.sensors)) for c in cs]
    twins = {c.name for c in record.actuators} & {c.name for c in record.sensors}
    plain = [_header(c) for c in (*record.actuators, *record.sensors)]
    writer.writerow(["time [s]", *(names if twins else plain)])
    columns = np.vstack([record.time_s, record.inputs, record.outputs]).T
    writer.writerows([[repr(v) for v in row] for row in columns.tolist()])
    return text.getvalue().encode()


def _mat(record: Record) -> bytes:
    import scipy.io

    held = {
        "u": record.inputs.T,
        "y": record.outputs.T,
        "fs": record.rate_hz,
        "u_names": _cells([c.name for c in record.actuators]),
        "y_names": _cells([c.name for c in record.sensors]),
        "u_units": _cells([c.unit for c in record.actuators]),
        "y_units": _cells([c.unit for c in record.sensors]),
    }
    memory = io.BytesIO()
    scipy.io.savemat(memory, held, do_compression=True)
    return memory.getvalue()


def _cells(texts: list[str]) -> np.ndarray:
    cells = np.empty(len(texts), dtype=object)
    cells[:] = texts
    return cells
