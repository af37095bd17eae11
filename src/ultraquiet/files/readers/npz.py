"""NumPy's `.npz`: arrays by name."""

import io

import numpy as np

from ultraquiet.files.table import FileTable, from_arrays


def read_npz(name: str, data: bytes) -> FileTable:
    """Return the arrays of an `.npz` file; `u_names` and `u_units` name the rows of `u`; pickles are not opened."""
    arrays = npz_arrays(data)
    texts = {key: [str(t) for t in array.ravel()] for key, array in arrays.items() if array.dtype.kind == "U"}
    return from_arrays(name, {key: array for key, array in arrays.items() if array.dtype.kind in "fiu"}, texts)


def npz_arrays(data: bytes) -> dict[str, np.ndarray]:
    """Return all arrays of an `.npz` file that hold no Python objects."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files if _is_plain(archive, key)}


def _is_plain(archive: np.lib.npyio.NpzFile, key: str) -> bool:
    try:
        return archive[key].dtype.kind != "O"
    except ValueError as error:
        # NumPy's word for an array of Python objects.
        if "allow_pickle" in str(error):
            return False
        raise
