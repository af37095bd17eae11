"""Names of new files, looked at before any work is done."""

import os
import tempfile
from pathlib import Path

from ultraquiet._base.errors import InputError, StorageError

ARCHIVES = (".h5", ".hdf5")


def require_free(
    who: str, target: Path, force: bool, suffixes: tuple[str, ...] = ARCHIVES, option: str = "--out"
) -> None:
    """Refuse a target of another suffix, in a folder that is not there, or one that is taken and may not be replaced.

    What takes minutes to compute would be lost for a name.
    """
    if target.suffix.lower() not in suffixes:
        raise InputError(f"{who}: the result is written as {' or '.join(suffixes)}, got {option} '{target}'.")
    from ultraquiet.files import possible

    possible(target, who)
    if not target.parent.is_dir():
        raise StorageError(f"{who}: there is no folder '{target.parent}' for '{target.name}'; make it first.")
    if not target.resolve().parent.is_dir():
        raise StorageError(f"{who}: '{target}' is a link to '{target.resolve()}', and that folder is not there.")
    if os.path.lexists(target) and not force:
        raise StorageError(f"{who}: '{target}' exists already; choose another {option}, or write over it with --force.")
    require_writable_place(who, target.resolve(), option)


def beside(who: str, source: Path, ending: str) -> Path:
    """Return the name of a result that is to stand beside what it is made of, STEM-ENDING.

    Raises:
        InputError: the source is a folder.
    """
    if source.is_dir():
        raise InputError(f"{who}: '{source}' is a folder; name a file in it.")
    return source.with_name(f"{source.stem}-{ending}")


def is_folder(who: str, folder: Path, option: str) -> bool:
    """Return whether a folder is there; refuse a name that the system does not take, or that cannot be looked at."""
    from ultraquiet.files import reason

    try:
        return folder.is_dir()
    except (OSError, ValueError) as error:
        why = reason(error)
        raise StorageError(f"{who}: '{folder}' cannot be written ({why}); choose another {option}.") from error


def require_writable_place(who: str, named: Path, option: str) -> None:
    """Refuse a name in a place that takes no files, by the nearest one that is there; nothing is left in it."""
    from ultraquiet.files import reason

    place = next((each for each in named.absolute().parents if os.path.lexists(each)), Path())
    if not place.is_dir():
        raise StorageError(f"{who}: '{place}' is no folder that could hold '{named.name}'; choose another {option}.")
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        why = reason(error)
        raise StorageError(f"{who}: nothing can be written in '{place}' ({why}); choose another {option}.") from error


def require_free_folder(who: str, folder: Path, force: bool, option: str) -> None:
    """Refuse a folder that holds something and may not be replaced, or a name that is a file's.

    Also with `force` only a folder that this program wrote is replaced; that is looked at where it is written.
    """
    if is_folder(who, folder, option):
        if any(folder.iterdir()) and not force:
            raise StorageError(
                f"{who}: the folder '{folder}' exists already and is not empty; choose another {option}, or write over "
                "it with --force."
            )
    elif os.path.lexists(folder):
        raise StorageError(f"{who}: '{folder}' is a file, no folder; choose another {option}.")
    require_writable_place(who, folder.resolve(), option)
