"""Records for other programs; `read_record` reads them back."""

import os
from functools import partial
from pathlib import Path

from ultraquiet._base.errors import InputError
from ultraquiet.files.archive import save
from ultraquiet.files.atomic import write_bytes
from ultraquiet.files.formats import ARCHIVES, FORMATS, format_of
from ultraquiet.files.readers.uff import write_uff
from ultraquiet.values import Record


def export_record(record: Record, path: str | os.PathLike[str], overwrite: bool = True, text: bool = False) -> Path:
    """Write a record for another program, whole or not at all; the suffix decides the format.

    `.h5` is an archive and keeps everything, provenance too. `.csv` has time, inputs and outputs side by side, `.mat`
    (version 5) u, y, fs, names and units, `.uff` and `.unv` a data set 58b a channel, `.parquet` a column a channel.
    Every one keeps each bit of the samples, names, units, roles and the rate; limits survive in HDF5 and Parquet only.

    Args:
        record: what to write.
        path: the file.
        overwrite: False refuses a name that is taken.
        text: universal files as data set 58, in ASCII: numbers are rounded to twelve digits.

    Raises:
        InputError: another suffix, or a name or unit that the format cannot hold.
        StorageError: disk full, folder missing or closed, name taken; what was there before is untouched.
        ToolError: Parquet without pyarrow.

    >>> import tempfile
    >>> from ultraquiet.files import read_record
    >>> record = Record([[1.0, 0.0]], [[0.1, 0.3]], 3500.0, ["force"], ["speed"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = export_record(record, Path(folder) / "run.csv")
    ...     back = read_record(path)
    >>> back.rate_hz, back.sensors[0].name, back.outputs
    (3500.0, 'speed', array([[0.1, 0.3]]))
    """
    form = format_of("export_record", Path(path))
    if Path(path).suffix.lower() in ARCHIVES:
        return save(record, path, overwrite)
    write = partial(write_uff, text=text) if form.write is write_uff else form.write
    if write is None:
        known = ", ".join(s for other in FORMATS if other.write is not None for s in other.suffixes)
        raise InputError(f"export_record: {form.name} files are read only; write {', '.join(ARCHIVES)}, {known}.")
    return write_bytes(path, write(record), overwrite)
