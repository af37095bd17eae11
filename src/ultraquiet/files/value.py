"""One value to a file and back; the suffix says the format, and no file says it is what it is not."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet.files import archive
from ultraquiet.files.atomic import name_taken, write_bytes
from ultraquiet.files.formats import ARCHIVES, FORMATS
from ultraquiet.files.matlab_values import mat_image, read_mat_value
from ultraquiet.files.packing import Value

MATLAB = ".mat"
ELSEWHERE = {
    **{suffix: "records go there by export_record" for form in FORMATS if form.write for suffix in form.suffixes},
    **dict.fromkeys((".uff", ".unv"), "records go there by export_record, responses by export_frf"),
    **dict.fromkeys((".json", ".npz", ".pkl", ".pickle"), "this package does not write values so"),
}


def save(value: Value, path: str | os.PathLike[str], overwrite: bool = True) -> Path:
    """Write one value to a file, whole or not at all; the suffix says how.

    `.h5` and `.hdf5` are archives, which hold any value with every bit, limits and provenance. `.mat` holds models,
    laws, responses and records as MATLAB's `ss` and `frd` take them (`matlab_values.mat_image`), without provenance.

    Args:
        value: any value of `ultraquiet.values`.
        path: the file.
        overwrite: False refuses a name that is taken.

    Returns:
        The path.

    Raises:
        StorageError: disk full, folder missing or closed, name taken; what was there before is untouched.
        InputError: another suffix, or not a value that the format holds.

    >>> import tempfile
    >>> from ultraquiet.values import Record
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = save(Record([[1.0, 0.0]], [[0.1, 0.3]], rate_hz=3500.0), Path(folder) / "step.h5")
    ...     load(path).outputs
    array([[0.1, 0.3]])
    """
    if _suffix("save", path) == MATLAB:
        if not overwrite and os.path.lexists(path):
            raise name_taken(path)
        return write_bytes(path, mat_image(value), overwrite)
    return archive.save(value, path, overwrite)


def save_many(values: Mapping[str, Value], path: str | os.PathLike[str], overwrite: bool = True) -> Path:
    """Write several named values to one archive, whole or not at all; arguments and errors as in `save`."""
    if _suffix("save_many", path) == MATLAB:
        raise InputError("save_many: a MAT file holds one value here; save them one by one, or all to an .h5 archive.")
    return archive.save_many(values, path, overwrite)


def load(path: str | os.PathLike[str], name: str | None = None) -> Any:
    """Read one value of an archive, or of a MAT file (`matlab_values.read_mat_value`).

    Args:
        path: a file that `save` or `save_many` wrote, or a MAT file of MATLAB's.
        name: which one, needed when an archive holds several.

    Raises:
        StorageError: missing, foreign, damaged or newer than this version, or no value of that name.
        InputError: a MAT file without a model, a response or a record.
    """
    if Path(path).suffix.lower() == MATLAB:
        return read_mat_value(path)
    return archive.load(path, name)


def _suffix(who: str, path: str | os.PathLike[str]) -> str:
    """Return a suffix that says what will stand in the file."""
    suffix = Path(path).suffix.lower()
    if suffix in (*ARCHIVES, MATLAB):
        return suffix
    hint = f"; {ELSEWHERE[suffix]}" if suffix in ELSEWHERE else ""
    known = ", ".join((*ARCHIVES, MATLAB))
    raise InputError(f"{who}: '{path}' must end in one of {known}, which say what stands in the file{hint}.")
