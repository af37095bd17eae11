"""HDF5 files of other programs: datasets as columns; archives of this package are read by `archive`."""

import io
import math
from typing import Any

import numpy as np

from ultraquiet._base.errors import StorageError
from ultraquiet.files.archive import MAGIC, SEAL
from ultraquiet.files.confined import announce
from ultraquiet.files.table import RATE_NAMES, STEP_NAMES, FileTable, from_arrays

SHA256_DIGITS = 64
FLOAT_BYTES = 8
OURS = (b"ultraquiet", b"format_version", b"kind")
UNITS = ("unit", "units", "Unit", "Units")
NAMES = ("names", "channels", "columns")


def is_ours(data: bytes) -> bool:
    """Return whether bytes are an archive of this package, whole or damaged."""
    if not data.startswith(MAGIC):
        return False
    # One that lost its seal still holds what only ours say at their root; HDF5 itself need not be asked for that.
    return SEAL in data[-len(SEAL) - SHA256_DIGITS :] or all(word in data for word in OURS)


def read_hdf5(name: str, data: bytes) -> FileTable:
    """Return the numeric datasets of an HDF5 file; one in a group is named `group.dataset`.

    Attributes of the file, a group or a dataset may say the rate (`fs`, `rate_hz`, `dt`, ...); those of a dataset its
    `unit` or `units`, and the `names` of its channels. The fields of a compound dataset are columns of their own.
    """
    import h5py

    arrays: dict[str, Any] = {}
    texts: dict[str, list[str]] = {}

    def visit(path: str, item: Any) -> None:
        place = path.replace("/", ".")
        arrays.update(_stated_rates(place, item))
        if not isinstance(item, h5py.Dataset):
            return
        if item.dtype.names:
            whole = item[()]
            arrays.update({f"{place}.{field}": whole[field] for field in item.dtype.names})
        elif item.dtype.kind in "fiu":
            arrays[place] = item[()]
            texts.update(_labels(place, item))
        elif h5py.check_string_dtype(item.dtype) is not None:
            texts[place] = _words(item.asstr()[()])

    with h5py.File(io.BytesIO(data), "r") as file:
        announce(name, declared_bytes(name, file), len(data))
        arrays.update(_stated_rates("", file))
        file.visititems(visit)
        return from_arrays(name, arrays, texts)


def declared_bytes(name: str, file: Any) -> int:
    """Return the bytes of float64 that all datasets of a file come to, as they say; foreign storage is refused.

    Raises:
        StorageError: a dataset whose samples lie in another file, or are drawn together from others.
    """
    import h5py

    total = 0

    def visit(path: str, item: Any) -> None:
        nonlocal total
        if not isinstance(item, h5py.Dataset):
            return
        if item.external or item.is_virtual:
            raise StorageError(
                f"read_record: '{name}' keeps '{path}' outside itself, in other files; such storage is not followed: "
                "copy the samples into one file first (h5repack)."
            )
        # A chunk is unpacked whole, however little of it is asked for.
        held = math.prod(item.chunks or ()) if item.chunks else 0
        total += max(math.prod(item.shape or ()), held) * max(item.dtype.itemsize, FLOAT_BYTES)

    file.visititems(visit)
    return total


def _stated_rates(place: str, item: Any) -> dict[str, Any]:
    """Return the scalars that attributes state: the rate, by any of its names."""
    known = {key: np.asarray(value) for key, value in item.attrs.items() if key.lower() in (*RATE_NAMES, *STEP_NAMES)}
    return {f"{place}.{key}".lstrip("."): value.reshape(-1)[0] for key, value in known.items() if value.size == 1}


def _labels(place: str, dataset: Any) -> dict[str, list[str]]:
    labels: dict[str, list[str]] = {}
    for kind, keys in (("names", NAMES), ("units", UNITS)):
        words = next((_words(dataset.attrs[key]) for key in keys if key in dataset.attrs), [])
        count = min(dataset.shape) if dataset.ndim == 2 else 1
        # One unit may hold for every channel of a matrix.
        labels[f"{place}_{kind}"] = words * count if kind == "units" and len(words) == 1 else words
    return {key: words for key, words in labels.items() if words}


def _words(value: Any) -> list[str]:
    items = np.atleast_1d(np.asarray(value, dtype=object)).ravel().tolist()
    return [item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item) for item in items]
