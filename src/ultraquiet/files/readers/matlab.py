"""MATLAB files: version 5 to 7.2 by SciPy, version 7.3 by h5py; written as version 5."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.files.confined import announce
from ultraquiet.files.readers import mat_sizes
from ultraquiet.files.readers.hdf5 import declared_bytes
from ultraquiet.files.table import FileTable, from_arrays
from ultraquiet.values import Record

MOST_DEPTH = 32  # of groups, structures and cells in each other
MOST_BYTES = 2**31  # of one variable in version 5, whose lengths are 32 bits with a sign


def read_mat(name: str, data: bytes) -> FileTable:
    """Return the numeric variables of a MAT file; fields of a structure are named `structure.field`.

    Cells of text called `u_names` and `u_units` name the columns of `u`. Objects that only MATLAB understands (transfer
    functions, tables) are passed over.
    """
    import scipy.io

    announce(name, mat_sizes.declared_bytes(name, data), len(data))
    try:
        variables = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    except NotImplementedError:
        variables = _version_73(name, data)
    flat = _flat(variables)
    texts = {key: words for key, value in flat.items() if (words := _words(value)) is not None}
    arrays = {key: value for key, value in flat.items() if key not in texts}
    return from_arrays(name, arrays, texts)


def write_mat(record: Record) -> bytes:
    """Return a record as variables u, y (time goes down), fs, and the names and units of their columns."""
    import scipy.io

    if max(record.inputs.nbytes, record.outputs.nbytes) >= MOST_BYTES:
        raise InputError("export_record: a variable of a MAT file ends at 2 GiB; write .h5, which knows no such end.")
    variables = {
        "fs": record.rate_hz,
        "u_names": _cells([c.name for c in record.actuators]),
        "y_names": _cells([c.name for c in record.sensors]),
        "u_units": _cells([c.unit for c in record.actuators]),
        "y_units": _cells([c.unit for c in record.sensors]),
        # Last, so that a file cut short between two variables lacks signals, not names alone.
        "u": record.inputs.T,
        "y": record.outputs.T,
    }
    memory = io.BytesIO()
    scipy.io.savemat(memory, variables, do_compression=True)
    return memory.getvalue()


def _cells(texts: Sequence[str]) -> np.ndarray:
    cells = np.empty(len(texts), dtype=object)
    cells[:] = texts
    return cells


def _words(value: Any) -> list[str] | None:
    """Return a text, or a cell of texts, as a list; None for anything else."""
    if isinstance(value, str):
        return [value]
    items = value.ravel().tolist() if isinstance(value, np.ndarray) and value.dtype.kind in "OU" else value
    if not isinstance(items, list):
        return None
    # SciPy gives an empty text as an empty array.
    words = ["" if isinstance(item, np.ndarray) and item.size == 0 else item for item in items]
    texts = [item for item in words if isinstance(item, str)]
    return texts if texts and len(texts) == len(words) else None


def _flat(variables: Mapping[Any, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in variables.items():
        # SciPy enters objects it cannot read under None.
        if not isinstance(key, str) or key.startswith(("__", "#")):
            continue
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{before}{key}."))
        else:
            flat[before + key] = value
    return flat


def _version_73(name: str, data: bytes) -> dict[str, Any]:
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        announce(name, declared_bytes(name, file), len(data))
        return _group(file, file)


def _group(group: Any, file: Any, depth: int = 0) -> dict[str, Any]:
    import h5py

    _check_depth(depth)
    variables: dict[str, Any] = {}
    for name in group:
        # A link to another file, or to a name that may be a group further up, is not followed.
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            variables[name] = _group(item, file, depth + 1)
        elif isinstance(item, h5py.Dataset):
            variables[name] = _variable(item, file, depth + 1)
    return variables


def _check_depth(depth: int) -> None:
    if depth > MOST_DEPTH:
        raise ValueError("its groups or cells hold each other in a circle")


def _variable(dataset: Any, file: Any, depth: int) -> Any:
    _check_depth(depth)
    kind = dataset.attrs.get("MATLAB_class", b"")
    if dataset.attrs.get("MATLAB_empty", 0):
        return "" if kind == b"char" else np.zeros(0)
    # MATLAB writes its columns as the rows of HDF5.
    array = np.asarray(dataset[()]).T
    if kind == b"char":
        return "".join(map(chr, array.ravel().tolist()))
    if kind == b"cell":
        return [_variable(file[reference], file, depth + 1) for reference in array.ravel(order="F")]
    return array
