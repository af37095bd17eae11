"""Whole files or none: a file appears under its name only when every byte of it is on the disk."""

import contextlib
import os
import secrets
import stat
from pathlib import Path

from ultraquiet._base.errors import StorageError


def write_bytes(path: str | os.PathLike[str], data: bytes, overwrite: bool = True) -> Path:
    """Write `data` under `path` so that a reader finds the whole new file, or what was there before.

    The bytes go to a hidden file beside `path`, are forced to the disk and only then take the name.

    Args:
        path: where to write; its folder must exist.
        data: the content.
        overwrite: False refuses a name that is taken, even one taken while the bytes were on their way.

    Raises:
        StorageError: the disk is full, the folder is missing or closed, the name is taken or none that the system
            knows, or what has it is no file; nothing has changed then.
    """
    # A link stays a link: its target is what gets replaced.
    target = possible(path)
    if not overwrite and target.exists():
        raise name_taken(path)
    part = target.with_name(f".{target.name[:200]}.{secrets.token_hex(6)}.part")
    try:
        _write_through(part, data)
        _take_name(part, target, overwrite)
        sync_folder(target.parent)
    except FileExistsError:
        raise name_taken(path) from None
    except OSError as error:
        raise StorageError(
            f"files: '{path}' could not be written ({reason(error)}); what was there before is untouched."
        ) from error
    finally:
        # Also after an interrupt: a half-written file must not stay behind.
        with contextlib.suppress(OSError):
            part.unlink()
    return Path(path)


def possible(path: str | os.PathLike[str], who: str = "files") -> Path:
    """Return where a file would be written, links followed.

    Raises:
        StorageError: the system takes no such name, or what has it is a folder, a device or a pipe: none of these is
            replaced by a file.
    """
    try:
        target = Path(os.path.realpath(path))
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            mode = target.stat().st_mode
            if not stat.S_ISREG(mode):
                kind = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
                raise StorageError(f"{who}: '{path}' is {kind}, no file; choose another name.")
    except StorageError:
        raise
    except (OSError, ValueError) as error:
        raise StorageError(f"{who}: '{path}' cannot be written ({reason(error)}); choose another name.") from error
    return target


def name_taken(path: str | os.PathLike[str]) -> StorageError:
    """Return the refusal to write over an existing file."""
    return StorageError(
        f"files: '{path}' exists already and was not asked to be overwritten; choose another name, or ask for it "
        f"(--force, overwrite=True)."
    )


def reason(error: BaseException) -> str:
    """Return the system's words for an error, without numbers and paths."""
    words = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(words.split())[:200].rstrip(".").lower() or type(error).__name__


def _write_through(part: Path, data: bytes) -> None:
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    with os.fdopen(handle, "wb", buffering=0) as file:
        view = memoryview(data)
        while view:
            view = view[file.write(view) :]
        os.fsync(file.fileno())


def _take_name(part: Path, target: Path, overwrite: bool) -> None:
    if overwrite:
        part.replace(target)
        return
    try:
        # A hard link fails when the name is taken; a rename would replace what took it meanwhile.
        os.link(part, target)
    except FileExistsError:
        raise
    except OSError:
        # exFAT and some network shares know no hard links.
        if target.exists():
            raise FileExistsError(target) from None
        part.replace(target)


def sync_folder(folder: Path) -> None:
    """Wait until the disk has the names in a folder, where it can."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:
        # Some network shares refuse to sync a folder; the file itself is already safe and in place.
        pass
    finally:
        os.close(handle)
