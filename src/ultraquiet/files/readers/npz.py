"""NumPy's `.npz`: arrays by name."""

import io
import math
import zipfile

import numpy as np

from ultraquiet._base.errors import StorageError
from ultraquiet.files.confined import announce
from ultraquiet.files.table import MOST_COLUMNS, FileTable, from_arrays

SUFFIX = ".npy"  # of a member that is an array
FLOAT_BYTES = 8


def read_npz(name: str, data: bytes) -> FileTable:
    """Return the arrays of an `.npz` file; `u_names` and `u_units` name the rows of `u`; pickles are not opened."""
    arrays = npz_arrays(name, data)
    texts = {key: [str(t) for t in array.ravel()] for key, array in arrays.items() if array.dtype.kind == "U"}
    return from_arrays(name, {key: array for key, array in arrays.items() if array.dtype.kind in "fiu"}, texts)


def npz_arrays(name: str, data: bytes) -> dict[str, np.ndarray]:
    """Return all arrays of an `.npz` file that hold no Python objects, after a look at what they say of their size."""
    if not data.startswith(b"PK"):
        raise StorageError(f"read_record: '{name}' is no NumPy archive: it does not begin like one.")
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [member for member in archive.infolist() if member.filename.endswith(SUFFIX)]
        _require_names(name, [member.filename for member in members])
        announce(name, sum(member.file_size for member in members), len(data))
        shapes = {member.filename: _declared(archive, member) for member in members}
        sizes = [math.prod(shape) * max(dtype.itemsize, FLOAT_BYTES) for shape, dtype in shapes.values()]
        announce(name, sum(sizes), len(data))
        for member in members:
            shape, dtype = shapes[member.filename]
            if dtype.hasobject:
                continue
            if math.prod(shape) * dtype.itemsize > member.file_size:
                raise StorageError(f"read_record: '{name}' says that '{member.filename}' has shape {shape}; it is cut.")
            with archive.open(member) as file:
                array = np.lib.format.read_array(file, allow_pickle=False)
                if file.read(1):
                    raise StorageError(f"read_record: '{name}' holds more in '{member.filename}' than it says.")
            arrays[member.filename.removesuffix(SUFFIX)] = array
    return arrays


def _require_names(name: str, members: list[str]) -> None:
    """Refuse more arrays than anybody records, and two of one name, of which nobody could say which is meant."""
    if len(members) > MOST_COLUMNS:
        raise StorageError(f"read_record: '{name}' holds {len(members)} arrays; up to {MOST_COLUMNS} are read.")
    if len(set(members)) < len(members):
        twice = next(member for member in members if members.count(member) > 1)
        raise StorageError(f"read_record: '{name}' holds '{twice}' more than once; keep the one that is meant.")


def _declared(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[tuple[int, ...], np.dtype]:
    """Return shape and type that an array says it has."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    return shape, dtype
