"""Names of new files, looked at before any work is done."""

import os
from pathlib import Path

from ultraquiet._base.errors import InputError, StorageError

ARCHIVES = (".h5", ".hdf5")


def require_free(who: str, target: Path, force: bool, suffixes: tuple[str, ...] = ARCHIVES) -> None:
    """Refuse a target of another suffix, in a folder that is not there, or one that is taken and may not be replaced.

    What takes minutes to compute would be lost for a name.
    """
    if target.suffix.lower() not in suffixes:
        raise InputError(f"{who}: the result is written as {' or '.join(suffixes)}, got --out '{target}'.")
    if not target.parent.is_dir():
        raise StorageError(f"{who}: there is no folder '{target.parent}' for '{target.name}'; make it first.")
    if os.path.lexists(target) and not force:
        raise StorageError(f"{who}: '{target}' exists already; choose another --out, or write over it with --force.")
