"""A folder that appears whole or not at all."""

import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import StorageError
from ultraquiet._base.regular import parse_json, read_regular

MANIFEST = "manifest.json"
WRITER = "ultraquiet.deploy"


def write_folder(folder: Path, files: Mapping[str, str]) -> None:
    """Write all files beside `folder` and rename; replace an older folder only when this package wrote it.

    Raises:
        StorageError: the place cannot be written, or something else stands there.
    """
    folder = folder.absolute()
    require_ours(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise StorageError(
            f"deploy: cannot write beside '{folder}' ({error.strerror}); choose another folder."
        ) from None
    try:
        for name, text in files.items():
            (work / name).parent.mkdir(parents=True, exist_ok=True)
            (work / name).write_text(text, encoding="utf-8")
        work.chmod(0o755)
        _swap(work, folder)
    except OSError as error:
        raise StorageError(f"deploy: cannot write '{folder}' ({error.strerror}); nothing was changed there.") from None
    finally:
        shutil.rmtree(work, ignore_errors=True)


def rewrite(folder: Path, files: Mapping[str, str]) -> None:
    """Replace single files of a folder, each whole or not at all.

    Raises:
        StorageError: the folder is gone or cannot be written.
    """
    for name, text in files.items():
        try:
            _replace(folder / name, text)
        except OSError as error:
            raise StorageError(f"deploy: cannot write '{folder / name}' ({error.strerror}).") from None


def _replace(path: Path, text: str) -> None:
    """Put a file in the place of what stands there; a link is replaced, where `files.write_bytes` follows it."""
    # A name that nobody can have taken, by a link least of all.
    handle, work = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".new", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(work, 0o644)
        os.replace(work, path)
    finally:
        with suppress(OSError):  # it has the file's own name, unless that failed
            os.unlink(work)


def manifest_text(manifest: Mapping[str, Any]) -> str:
    """Return the manifest, which marks the folder as this package's."""
    return json.dumps({"writer": WRITER, **manifest}, indent=1, allow_nan=False) + "\n"


def require_ours(folder: Path) -> None:
    """Refuse to replace a folder that this package did not write.

    Raises:
        StorageError: a file, or a folder with something else in it.
    """
    try:
        if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
            return
        manifest = parse_json(read_regular(folder / MANIFEST))
        ours = isinstance(manifest, dict) and manifest.get("writer") == WRITER
    except (OSError, ValueError):
        ours = False
    if not ours:
        raise StorageError(f"deploy: '{folder}' holds something this program did not write; choose another folder.")


def _swap(work: Path, folder: Path) -> None:
    if not folder.exists():
        os.rename(work, folder)
        return
    # Two renames: the old folder leaves whole, and comes back if the new one cannot take its place.
    old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old.", dir=folder.parent))
    try:
        os.rename(folder, old / "code")  # refused to an ordinary user where the folder itself is read-only
        try:
            os.rename(work, folder)
        except OSError:
            os.rename(old / "code", folder)
            raise
    finally:
        if folder.exists():
            _remove(old)


def _remove(folder: Path) -> None:
    """Remove a folder whose place is taken, read-only folders inside it too."""
    for place, _, _ in os.walk(folder):
        with suppress(OSError):  # somebody else's: it stays
            os.chmod(place, 0o700)
    shutil.rmtree(folder, ignore_errors=True)
