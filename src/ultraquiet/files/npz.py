"""NumPy's `.npz`: arrays by name."""

import io

import numpy as np

from ultraquiet.files.table import Table, from_arrays


def read_npz(name: str, data: bytes) -> Table:
    """Return the arrays of an `.npz` file; `u_names` and `u_units` name the rows of `u`; pickles are not opened."""
    arrays = npz_arrays(data)
    texts = {key: [str(t) for t in held.ravel()] for key, held in arrays.items() if held.dtype.kind == "U"}
    return from_arrays(name, {key: held for key, held in arrays.items() if held.dtype.kind in "fiu"}, texts)


def npz_arrays(data: bytes) -> dict[str, np.ndarray]:
    """Return all arrays of an `.npz` file that hold no Python objects."""
    with np.load(io.BytesIO(data), allow_pickle=False) as held:
        return {key: held[key] for key in held.files if _is_plain(held, key)}


def _is_plain(held: np.lib.npyio.NpzFile, key: str) -> bool:
    try:
        return held[key].dtype.kind != "O"
    except ValueError as error:
        # NumPy's word for an array of Python objects.
        if "allow_pickle" in str(error):
            return False
        raise
