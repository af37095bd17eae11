"""The results of a campaign on disk: each sealed in one line at once, so that a kill loses none and doubles none."""

import json
import os
import zlib
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files.names import free_name
from ultraquiet.simulate.campaigns.drawing import WHO

Row = dict[str, Any]


class Ledger:
    """One file: a head that says which campaign, then a line a result, each with a checksum, forced to the disk.

    What a kill leaves half written is the last line alone; it is cut off when the file is opened again.

    Args:
        path: of the file.
        digest: of the campaign; results of another one are refused.
        resume: go on with what is there; without it what is there is kept under a name that nothing has, and begun
            anew.

    Raises:
        InputError: `resume` with results of another campaign.
        StorageError: the file cannot be written.
    """

    def __init__(self, path: Path, digest: str, resume: bool) -> None:
        self.path, self.digest = path, digest
        self.rows: dict[int, Row] = {}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists() and not resume:
                path.rename(free_name(path, "before"))
            kept = self._kept() if path.exists() else b""
            self._file = path.open("r+b" if kept else "wb")
            self._file.truncate(len(kept))
            self._file.seek(len(kept))
            if not kept:
                self._write({"campaign": digest})
        except OSError as error:
            raise _unwritten(path, error) from error

    def add(self, row: Row) -> None:
        """Seal a result; one of a case that is there already is left away."""
        if row["case"] in self.rows:
            return
        try:
            self._write(row)
        except OSError as error:
            raise _unwritten(self.path, error) from error
        self.rows[row["case"]] = row

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> "Ledger":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, content: Row) -> None:
        self._file.write(_sealed(content))
        self._file.flush()
        os.fsync(self._file.fileno())

    def _kept(self) -> bytes:
        """Return the whole lines of the file, up to the first that is not what was sealed."""
        whole = b""
        for number, line in enumerate(self.path.read_bytes().splitlines(keepends=True)):
            content = _opened(line)
            if content is None:
                break
            if number == 0 and content.get("campaign") != self.digest:
                raise InputError(
                    f"{WHO}: '{self.path}' holds results of another law, bench, band or seed; without --resume they "
                    f"are kept under another name and the campaign begins anew."
                )
            if number:
                self.rows.setdefault(content["case"], content)
            whole += line
        return whole


def digest_of(path: Path) -> str | None:
    """Return which campaign a file is of; None where it does not tell."""
    with path.open("rb") as file:
        head = _opened(file.readline())
    return None if head is None else head.get("campaign")


def _sealed(content: Row) -> bytes:
    text = json.dumps(content).encode()
    return f"{zlib.crc32(text):08x} ".encode() + text + b"\n"


def _opened(line: bytes) -> Row | None:
    """Return what a line holds; None where it is not whole."""
    check, _, text = line.partition(b" ")
    if not line.endswith(b"\n") or check != f"{zlib.crc32(text[:-1]):08x}".encode():
        return None
    content: Row = json.loads(text)
    return content


def _unwritten(path: Path, error: OSError) -> StorageError:
    return StorageError(f"{WHO}: '{path}' cannot be written ({error.strerror or error}); sealed results are kept.")
