"""Bytes of ordinary files only: a device, a FIFO or a socket may never end, and reading one may set something off."""

import errno
import io
import json
import os
import re
import stat
import tomllib
from typing import Any

CHUNK_BYTES = 1 << 24
MOST_TEXT_BYTES = 16 << 20  # of a list, a study, a mapping: what people write by hand is a thousand times shorter
MOST_KEY_PARTS = 64

# From where a key may begin, each part taken whole: the search is one walk through the text.
_PART = r"""(?>[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?:^|[\[{{,])[ \t]*+{_PART}(?>[ \t]*+\.[ \t]*+{_PART}){{{MOST_KEY_PARTS}}}", re.MULTILINE)
_KINDS = (
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


def check_regular(path: str | os.PathLike[str]) -> os.stat_result:
    """Return what the system says of an ordinary file, links followed; nothing is opened.

    Raises:
        OSError: nothing there, links in a circle, or something that is no ordinary file.

    >>> check_regular("/dev/null")
    Traceback (most recent call last):
    OSError: [Errno 22] it is a device, no file: '/dev/null'
    """
    found = os.stat(path)
    _refuse(path, found)
    return found


def read_regular(path: str | os.PathLike[str], most: int | None = None) -> bytes:
    """Return the bytes of an ordinary file.

    Args:
        path: the file, or a link to one.
        most: refuse more bytes than that, also when the file grows while it is read.

    Raises:
        OSError: as `check_regular`, or the file is too long.
    """
    check_regular(path)
    # Between the look and the opening another may have taken the name: a pipe must not hold us then.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb", buffering=0) as file:
        found = os.fstat(handle)
        _refuse(path, found)
        if most is not None and found.st_size > most:
            raise OSError(errno.EFBIG, f"it has {found.st_size} bytes, more than {most}", os.fspath(path))
        # What a file grows by while it is read belongs to the next reader.
        left, parts = found.st_size or (most or CHUNK_BYTES), list[bytes]()
        while left > 0 and (part := file.read(min(left, CHUNK_BYTES))):
            parts.append(part)
            left -= len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def read_regular_text(path: str | os.PathLike[str]) -> str:
    """Return the UTF-8 text of an ordinary file that people write, with plain line ends; errors as `read_regular`.

    Raises:
        UnicodeDecodeError: no UTF-8.
    """
    return io.TextIOWrapper(io.BytesIO(read_regular(path, MOST_TEXT_BYTES)), encoding="utf-8").read()


def parse_json(text: str | bytes) -> Any:
    """Return what a JSON text says.

    Raises:
        ValueError: no JSON, no UTF-8, or lists in lists beyond what Python follows.

    >>> parse_json("[" * 100_000)
    Traceback (most recent call last):
    ValueError: its lists lie too deep inside one another
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its lists lie too deep inside one another") from None


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises:
        ValueError: no TOML (`tomllib.TOMLDecodeError`), tables in tables beyond what Python follows, or keys of so many
            parts that tomllib, which copies each beginning of a key, would fill the memory with them.

    >>> parse_toml(".".join("a" * 60_000) + " = 1")
    Traceback (most recent call last):
    ValueError: a key has more than 64 parts
    """
    if _LONG_KEY.search(text):
        raise ValueError(f"a key has more than {MOST_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its tables lie too deep inside one another") from None


def _refuse(path: str | os.PathLike[str], found: os.stat_result) -> None:
    if stat.S_ISREG(found.st_mode):
        return
    kind = next((words for is_kind, words in _KINDS if is_kind(found.st_mode)), "something else")
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
    raise OSError(errno.EINVAL, f"it is {kind}, no file", os.fspath(path))
