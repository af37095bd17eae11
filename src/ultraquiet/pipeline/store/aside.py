"""What a hand has changed in the folder of a study is set aside under another name, never written over."""

from pathlib import Path

from ultraquiet.files.names import free_name


def set_aside(path: Path, word: str) -> Path:
    """Give something another name, in one step, and return that.

    Raises:
        OSError: the disk refuses.
    """
    target = free_name(path, word)
    path.rename(target)
    return target
