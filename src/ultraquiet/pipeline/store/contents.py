"""What stands in the folder of a study, by content: hashes of files and folders, and what was changed by hand."""

import errno
import hashlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from ultraquiet._base.regular import check_regular
from ultraquiet.files.names import inside

Hashes = Mapping[str, str]
# A file is there and its bytes could not be had this time: the device, a server that went, too many open files.
REFUSED = {errno.EIO, errno.ESTALE, errno.ENOMEM, errno.EMFILE, errno.ENFILE}


def place(folder: Path, name: str) -> Path:
    """Return the path of something in the folder of a study by its name there, `models/plant.h5` for instance.

    Raises:
        StorageError: a name or link that leads out of the folder.
    """
    return inside("study", folder, *PurePosixPath(name).parts)


def staged(folder: Path, name: str) -> Path:
    """Return where something waits under a hidden name until its stage is complete."""
    path = place(folder, name)
    return path.with_name(f".{path.name}.part")


def hash_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes; empty where there is no file, or one that nobody may read.

    Raises:
        OSError: the disk refuses a file that is there: what it holds is not known then, and it counts neither as
            another one nor as none.
    """
    try:
        check_regular(path)  # the end of a pipe may never come
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        if error.errno in REFUSED:
            raise
        return ""


def hashes_of(path: Path) -> dict[str, str]:
    """Return name -> SHA-256 of every file below a folder, or of a file alone under the empty name.

    Raises:
        OSError: the disk refuses one of them.
    """
    if path.is_dir() and not path.is_symlink():
        files = sorted(p for p in path.rglob("*") if p.is_symlink() or not p.is_dir())
        return {p.relative_to(path).as_posix(): hash_of(p) for p in files}
    return {"": hash_of(path)} if path.is_symlink() or path.exists() else {}


def changes(was: Hashes, found: Hashes) -> str:
    """Return what was done by hand between two states, as the end of a sentence.

    >>> changes({"a.c": "1", "b.c": "2"}, {"a.c": "3", "d.c": "4"})
    'a.c edited, b.c deleted, d.c added'
    """
    edited = [f"{name} edited" for name in was if name in found and found[name] != was[name]]
    deleted = [f"{name} deleted" for name in was if name not in found]
    added = [f"{name} added" for name in found if name not in was]
    return ", ".join(change.strip() for change in (*edited, *deleted, *added))


def vouched(found: Hashes, *known: Hashes) -> bool:
    """Tell whether everything that is found is known to be this program's own."""
    return all(any(state.get(name) == digest for state in known) for name, digest in found.items())
