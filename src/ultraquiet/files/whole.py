"""A file's bytes: whole, unless they would not fit, and understood, or refused in one sentence."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.regular import check_regular, read_regular
from ultraquiet.files.atomic import reason
from ultraquiet.files.sizes import sized

# Memory that reading takes, in sizes of the file, at most: the bytes, text of them, numbers, and the record's copy.
SWELL = 6
READER = "read_record"


def whole(path: str | os.PathLike[str]) -> bytes:
    """Return the bytes of a file.

    Raises:
        StorageError: missing, empty, closed, no ordinary file but a device or a pipe, or larger than the free memory
            takes; the sentence gives the size.
    """
    try:
        size, free = check_regular(path).st_size, free_bytes()
        if free is not None and SWELL * size > free:
            raise StorageError(
                f"read_record: '{path}' has {sized(size)}; reading it takes up to {sized(SWELL * size)} of memory and "
                f"{sized(free)} are free; cut it into parts first."
            )
        data = read_regular(path)
    except OSError as error:
        if isinstance(error, StorageError):
            raise
        raise StorageError(f"read_record: '{path}' cannot be read ({reason(error)}).") from error
    if not data:
        raise StorageError(f"read_record: '{path}' is empty.")
    return data


@contextmanager
def understanding(name: str, kind: str, who: str = READER) -> Iterator[None]:
    """Turn whatever a library stumbles over first in damaged or foreign bytes into one sentence."""
    try:
        yield
    except UltraquietError:
        raise
    except MemoryError as error:
        raise StorageError(
            f"{who}: '{name}' cannot be read as {kind}: that takes more memory than a file of its size accounts "
            "for; it is damaged, made to fill the memory, or to be cut up."
        ) from error
    except Exception as error:
        raise StorageError(f"{who}: '{name}' cannot be read as {kind} ({reason(error)}).") from error


def free_bytes() -> int | None:
    """Return the memory that is free, None where the system does not say."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return None
