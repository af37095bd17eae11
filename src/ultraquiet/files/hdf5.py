"""HDF5 files of other programs: datasets as columns; archives of this package are read by `archive`."""

import io
from typing import Any

import numpy as np

from ultraquiet.files.archive import FORMAT, MAGIC, SEAL
from ultraquiet.files.table import RATE_NAMES, STEP_NAMES, Table, from_arrays

SHA256_DIGITS = 64
UNITS = ("unit", "units", "Unit", "Units")
NAMES = ("names", "channels", "columns")


def is_ours(data: bytes) -> bool:
    """Return whether bytes are an archive of this package, whole or damaged."""
    if not data.startswith(MAGIC):
        return False
    if SEAL in data[-len(SEAL) - SHA256_DIGITS :]:
        return True
    import h5py

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            return file.attrs.get("format") == FORMAT
    except Exception:
        # Let the reader say what is wrong with the file.
        return False


def read_hdf5(name: str, data: bytes) -> Table:
    """Return the numeric datasets of an HDF5 file; one in a group is named `group.dataset`.

    Attributes of the file, a group or a dataset may say the rate (`fs`, `rate_hz`, `dt`, ...); those of a dataset its
    `unit` or `units`, and the `names` of its channels. The fields of a compound dataset are columns of their own.
    """
    import h5py

    arrays: dict[str, Any] = {}
    texts: dict[str, list[str]] = {}

    def visit(path: str, held: Any) -> None:
        place = path.replace("/", ".")
        arrays.update(_told(place, held))
        if not isinstance(held, h5py.Dataset):
            return
        if held.dtype.names:
            whole = held[()]
            arrays.update({f"{place}.{field}": whole[field] for field in held.dtype.names})
        elif held.dtype.kind in "fiu":
            arrays[place] = held[()]
            texts.update(_labels(place, held))
        elif h5py.check_string_dtype(held.dtype) is not None:
            texts[place] = _words(held.asstr()[()])

    with h5py.File(io.BytesIO(data), "r") as file:
        arrays.update(_told("", file))
        file.visititems(visit)
        return from_arrays(name, arrays, texts)


def _told(place: str, held: Any) -> dict[str, Any]:
    """Return the scalars that attributes state: the rate, by any of its names."""
    known = {key: np.asarray(value) for key, value in held.attrs.items() if key.lower() in (*RATE_NAMES, *STEP_NAMES)}
    return {f"{place}.{key}".lstrip("."): value.reshape(-1)[0] for key, value in known.items() if value.size == 1}


def _labels(place: str, held: Any) -> dict[str, list[str]]:
    labels: dict[str, list[str]] = {}
    for kind, keys in (("names", NAMES), ("units", UNITS)):
        words = next((_words(held.attrs[key]) for key in keys if key in held.attrs), [])
        count = min(held.shape) if held.ndim == 2 else 1
        # One unit may hold for every channel of a matrix.
        labels[f"{place}_{kind}"] = words * count if kind == "units" and len(words) == 1 else words
    return {key: words for key, words in labels.items() if words}


def _words(value: Any) -> list[str]:
    items = np.atleast_1d(np.asarray(value, dtype=object)).ravel().tolist()
    return [item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item) for item in items]
