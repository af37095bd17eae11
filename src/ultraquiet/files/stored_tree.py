"""The HDF5 inside an archive: what it must look like, checked item by item, as plain trees of arrays and texts."""

import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ultraquiet._base.errors import StorageError
from ultraquiet.files.confined import announce

FORMAT = "ultraquiet"
FORMAT_VERSION = 1
MOST_DEPTH = 16  # of groups in each other; a matrix of polynomials takes five
MOST_ITEMS = 1_000_000
FLOAT_BYTES = 8

Tree = dict[str, Any]


def stored(name: str, image: bytes, names: Sequence[str] | None = None) -> dict[str, tuple[str, Tree]]:
    """Return name -> kind and tree of the values in the HDF5 of an archive.

    Args:
        name: the archive, for the sentence.
        image: the bytes of HDF5.
        names: which values; None for all.

    Raises:
        StorageError: another layout or version, no value of a name; links, storage outside the file, groups that hold
            themselves: nothing of the kind is ever written, and nothing of it is followed.
    """
    import h5py

    with h5py.File(io.BytesIO(image), "r") as file:
        _check_version(name, file.attrs)
        known = [str(key) for key in file]
        missing = [key for key in names or () if key not in known]
        if missing:
            raise StorageError(f"archive: '{name}' holds no '{missing[0]}', only {', '.join(known)}.")
        walk = _Walk(name, len(image))
        groups = {key: walk.item(file, key) for key in (known if names is None else names)}
        for key, group in groups.items():
            walk.measure(key, group, 1)
        announce(name, walk.bytes, len(image))
        return {key: (_kind(name, key, group), _tree(group)) for key, group in groups.items()}


class _Walk:
    """One look at every item, before any is read."""

    def __init__(self, name: str, size: int) -> None:
        self.name, self.size, self.bytes, self._items = name, size, 0, 0

    def item(self, group: Any, key: str) -> Any:
        """Return what a name of a group stands for, which is in this file and under this name alone."""
        import h5py

        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            raise StorageError(f"archive: '{self.name}' holds under '{key}' a link, which no archive has.")
        return group[key]

    def measure(self, path: str, item: Any, depth: int) -> None:
        """Add up what an item says it comes to."""
        import h5py

        self._items += 1
        if depth > MOST_DEPTH or self._items > MOST_ITEMS:
            raise StorageError(f"archive: '{self.name}' holds at '{path[:60]}' groups that hold themselves, or no end.")
        if isinstance(item, h5py.Group):
            for key in map(str, item):
                self.measure(f"{path}/{key}", self.item(item, key), depth + 1)
        elif not isinstance(item, h5py.Dataset):
            raise StorageError(f"archive: '{self.name}' holds at '{path}' a type, which no archive has.")
        else:
            if item.external or item.is_virtual:
                raise StorageError(f"archive: '{self.name}' keeps '{path}' in other files, which no archive does.")
            text = h5py.check_string_dtype(item.dtype) is not None
            if not (item.dtype.kind in "fciu" or (text and item.shape == ())):
                raise StorageError(f"archive: '{self.name}' holds at '{path}' neither numbers nor a text.")
            count = max(item.size or 0, math.prod(item.chunks or (0,)))
            self.bytes += count * max(item.dtype.itemsize, FLOAT_BYTES)


def _check_version(name: str, attributes: Any) -> None:
    version = attributes.get("format_version")
    number = int(version) if hasattr(version, "__index__") else None
    if attributes.get("format") != FORMAT or number is None:
        raise StorageError(f"archive: '{name}' does not say of which format and version it is, as an archive does.")
    if number > FORMAT_VERSION:
        raise StorageError(
            f"archive: '{name}' has format version {number}, this version of ultraquiet reads up to {FORMAT_VERSION}."
        )


def _kind(name: str, key: str, group: Any) -> str:
    kind = group.attrs.get("kind")
    if not isinstance(kind, str):
        raise StorageError(f"archive: '{name}' does not say of which kind '{key}' is.")
    return kind


def _tree(group: Any) -> Tree:
    import h5py

    tree: Tree = {}
    if isinstance(group, h5py.Dataset):
        raise ValueError("it is an array by itself, of no kind")
    for key, item in group.items():
        if isinstance(item, h5py.Group):
            tree[key] = _tree(item)
        elif h5py.check_string_dtype(item.dtype):
            tree[key] = item[()].decode("ascii")
        else:
            tree[key] = item[()] if item.shape else np.array(item[()])
    return tree
