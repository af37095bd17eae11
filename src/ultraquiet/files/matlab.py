"""Tables from MATLAB files: version 5 to 7.2 by SciPy, version 7.3 by h5py."""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from ultraquiet._base.errors import StorageError
from ultraquiet.files.atomic import reason
from ultraquiet.files.table import Table, from_arrays


def read_mat(name: str, data: bytes) -> Table:
    """Return the numeric variables of a MAT file; fields of a structure are named `structure.field`.

    Objects that only MATLAB understands (transfer functions, tables) are passed over.
    """
    import scipy.io

    try:
        try:
            held = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
        except NotImplementedError:
            held = _version_73(data)
    except Exception as error:
        # Damaged bytes surface as whatever zlib, SciPy or HDF5 stumble over first.
        raise StorageError(f"read_record: '{name}' cannot be read as a MAT file ({reason(error)}).") from error
    return from_arrays(name, _flat(held))


def _flat(held: Mapping[Any, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in held.items():
        # SciPy enters objects it cannot read under None.
        if not isinstance(key, str) or key.startswith("__"):
            continue
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{before}{key}."))
        elif not isinstance(value, np.ndarray) or value.dtype.kind in "fiu":
            flat[before + key] = value
    return flat


def _version_73(data: bytes) -> dict[str, Any]:
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        return {name: held[()] for name, held in file.items() if isinstance(held, h5py.Dataset)}
