"""Names of files: those that come out of a file and lead out of no folder, and those that nothing has yet."""

from itertools import count
from pathlib import Path

from ultraquiet._base.errors import StorageError

# Separators of every system, and the colon of Windows' drives and streams: a folder may be carried between systems.
FORBIDDEN = frozenset("/\\:")
LONGEST_BYTES = 200  # most file systems take 255; a suffix and a number follow


def is_plain(name: object) -> bool:
    r"""Return whether something read from a file is the name of a file, and neither a path nor anything else.

    >>> [is_plain(name) for name in ("push-1", "..", "../victim", "/etc/passwd", "C:x", "", "a\0", 3)]
    [True, False, False, False, False, False, False, False]
    """
    if not isinstance(name, str) or name in ("", ".", "..") or not name.isprintable():
        return False
    return not FORBIDDEN.intersection(name) and len(name.encode()) <= LONGEST_BYTES


def inside(who: str, folder: Path, *names: str) -> Path:
    """Return the path of names below a folder, which it does not leave, by a link either.

    Args:
        who: refuses, in the sentence.
        folder: where the path begins; it may be a link itself.
        names: of the folders on the way, then of the file.

    Raises:
        StorageError: a name that is not plain, or a link that leads out of the folder.
    """
    path = folder.joinpath(*names) if names and all(map(is_plain, names)) else None
    if path is None:
        raise StorageError(f"{who}: {quoted('/'.join(map(str, names)))} is no name of a file in '{folder}'.")
    refuse_way_out(who, folder, path)
    return path


def refuse_way_out(who: str, folder: Path, path: Path) -> None:
    """Refuse a path below a folder that leaves it by a link.

    Raises:
        StorageError: it does, or goes round in a circle.
    """
    try:
        stays = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # links that go round in a circle
        stays = False
    if not stays:
        raise StorageError(f"{who}: '{path}' is a link that leads out of its folder; put the file itself there.")


def free_name(path: Path, word: str) -> Path:
    """Return a name beside `path` that nothing has: `plant.WORD.h5`, then `plant.WORD-2.h5`, and so on."""
    for number in count(1):
        tail = word if number == 1 else f"{word}-{number}"
        candidate = path.with_name(f"{path.name.removesuffix(path.suffix)}.{tail}{path.suffix}")
        if path.is_dir():
            candidate = path.with_name(f"{path.name}.{tail}")
        if not candidate.exists() and not candidate.is_symlink():
            return candidate
    raise AssertionError


def quoted(name: object) -> str:
    """Return a name that may be anything, short enough for a sentence."""
    return f"{name!r:.60}"
