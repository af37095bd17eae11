"""What a hand has changed in the folder of a study is set aside under another name, never written over."""

from itertools import count
from pathlib import Path


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


def set_aside(path: Path, word: str) -> Path:
    """Give something another name, in one step, and return that.

    Raises:
        OSError: the disk refuses.
    """
    target = free_name(path, word)
    path.rename(target)
    return target
