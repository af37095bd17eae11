"""Archives: every value to one HDF5 file and back, exactly, with kind, format version and checksum.

The layout is open to any HDF5 reader: each value is a group with the attribute `kind`, its arrays are datasets of
float64 or complex128, its texts (channels, provenance) are JSON; the root says `format` and `format_version`. Behind
the last byte of HDF5 stands a SHA-256 of all before it: HDF5 itself may crash on damaged bytes, so none reach it.
"""

import hashlib
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.regular import read_regular
from ultraquiet.files.atomic import name_taken, reason, write_bytes
from ultraquiet.files.confined import confined
from ultraquiet.files.packing import Tree, Value, pack, unpack
from ultraquiet.files.stored_tree import FORMAT, FORMAT_VERSION, stored

if TYPE_CHECKING:
    import h5py

ALONE = "value"  # the name of a value that has a file to itself
MAGIC = b"\x89HDF\r\n\x1a\n"  # the first bytes of every HDF5 file, HDF5 File Format Specification III.A
SEAL = b"\nultraquiet-sha256:"

MOST_SOUND = 4096  # digests

_Path = str | os.PathLike[str]

_sound: dict[bytes, None] = {}  # digests of what this process wrote, or understood in a child


def save(value: Value, path: _Path, overwrite: bool = True) -> Path:
    """Write one value to an HDF5 file of any suffix; arguments and errors as in `ultraquiet.files.save`."""
    return save_many({ALONE: value}, path, overwrite)


def save_many(values: Mapping[str, Value], path: _Path, overwrite: bool = True) -> Path:
    """Write several named values to one HDF5 file, whole or not at all; arguments and errors as in `save`."""
    if not overwrite and os.path.lexists(path):
        raise name_taken(path)
    for name in values:
        if not name or "/" in name or "\0" in name or name == "." or not name.isprintable():
            raise InputError(f"archive: {name!r} cannot name a value; use printable characters without '/'.")
    return write_bytes(path, _image({name: pack(value) for name, value in values.items()}), overwrite)


def load(path: _Path, name: str | None = None) -> Any:
    """Read one value.

    Args:
        path: a file that `save` or `save_many` wrote.
        name: which one, needed when the file holds several.

    Raises:
        StorageError: missing, foreign, damaged or newer than this version, no value of that name, or content that no
            archive has, however well it is sealed.
    """
    values = load_many(path, None if name is None else (name,))
    if len(values) != 1:
        raise StorageError(f"archive: '{path}' holds {len(values)} values ({', '.join(values)}); name one of them.")
    return next(iter(values.values()))


def load_many(path: _Path, names: tuple[str, ...] | None = None) -> dict[str, Any]:
    """Read all values of a file, or the named ones, as a mapping in the order they were saved."""
    values: dict[str, Any] = {}
    for name, (kind, tree) in _read(path, names).items():
        try:
            values[name] = unpack(kind, tree)
        except Exception as error:  # whatever a value makes of content that no value has
            raise StorageError(f"archive: '{name}' in '{path}' is no valid {kind} ({reason(error)}).") from error
    return values


def contents(path: _Path) -> dict[str, str]:
    """Return name -> kind of the values in a file, without building them."""
    return {name: kind for name, (kind, _) in _read(path, None).items()}


def is_archive(path: _Path) -> bool:
    """Return whether a file is an archive of this package."""
    try:
        contents(path)
    except StorageError:
        return False
    return True


def _image(packed: Mapping[str, tuple[str, Tree]]) -> bytes:
    import h5py

    # Built in memory: HDF5 itself does not survive a full disk (a failed close cannot be repeated), plain writes do.
    memory = io.BytesIO()
    with h5py.File(memory, "w", track_order=True) as file:
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        for name, (kind, tree) in packed.items():
            group = file.create_group(name)
            group.attrs["kind"] = kind
            _write(group, tree)
    image = memory.getvalue()
    _sound[hashlib.sha256(image).digest()] = None
    return image + _seal(image)


def _seal(image: bytes) -> bytes:
    return SEAL + hashlib.sha256(image).hexdigest().encode()


def _write(group: "h5py.Group", tree: Tree) -> None:
    import h5py

    for key, item in tree.items():
        if isinstance(item, dict):
            _write(group.create_group(key), item)
        elif isinstance(item, str):
            # Plain ASCII: JSON has escaped what HDF5 strings cannot hold (NUL, lone surrogates).
            group.create_dataset(key, data=item, dtype=h5py.string_dtype("ascii"))
        else:
            group.create_dataset(key, data=item)


def _image_of(path: _Path) -> bytes:
    """Return the HDF5 of an archive, its seal checked."""
    try:
        data = read_regular(path)
    except OSError as error:
        raise StorageError(f"archive: '{path}' cannot be read ({reason(error)}).") from error
    if not data.startswith(MAGIC):
        raise StorageError(f"archive: '{path}' is not an HDF5 file; read_record reads other formats.")
    end = len(data) - len(_seal(b""))
    if not data.startswith(SEAL, end):
        raise StorageError(f"archive: '{path}' was cut short, changed, or written by another program.")
    if _seal(data[:end]) != data[end:]:
        raise StorageError(f"archive: '{path}' is damaged: its content does not match its checksum.")
    return data[:end]


def _read(path: _Path, names: tuple[str, ...] | None) -> dict[str, tuple[str, Tree]]:
    """Return kinds and trees.

    Anybody can compute a checksum: bytes that this process neither wrote nor read before are understood by a child.
    """
    import h5py  # noqa: F401  the child can load nothing

    image, name = _image_of(path), os.fspath(path)
    digest = hashlib.sha256(image).digest()
    if digest in _sound:
        return stored(name, image, names)
    trees = confined(lambda: stored(name, image), os.path.basename(name), "HDF5", len(image), who="archive")
    _sound[digest] = None
    while len(_sound) > MOST_SOUND:
        del _sound[next(iter(_sound))]
    missing = [key for key in names or () if key not in trees]
    if missing:
        raise StorageError(f"archive: '{path}' holds no '{missing[0]}', only {', '.join(trees)}.")
    return {key: trees[key] for key in (trees if names is None else names)}
