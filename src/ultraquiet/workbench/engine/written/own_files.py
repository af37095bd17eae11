"""The files that the workbench writes for others to read: what a hand has written there is set aside before."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from ultraquiet._base.errors import StorageError
from ultraquiet._base.regular import read_regular
from ultraquiet.files import reason, write_bytes
from ultraquiet.pipeline.store.aside import set_aside

EDITED = "edited"


class OwnFiles:
    """Files of a folder, and of each what was written there last; anything else is somebody's own.

    Args:
        folder: where the files stand.
        note: file in which it is remembered what was written.
    """

    def __init__(self, folder: Path, note: Path) -> None:
        self._folder, self._note = folder, note
        self._known = self._read()

    def write(self, texts: Mapping[str, str]) -> list[Path]:
        """Write files by their names; what is somebody's own is given another name first, and that is returned.

        Raises:
            StorageError: the disk refuses; what was somebody's own is still there.
        """
        kept = [renamed(self._folder / name) for name in texts if self.is_foreign(name, texts[name])]
        for name, text in texts.items():
            write_bytes(self._folder / name, text.encode())
        # last: what a run that is killed before wrote is told by its text
        known = {name: _digest(text.encode()) for name, text in texts.items()}
        if known != self._known:
            write_bytes(self._note, json.dumps(known, indent=1).encode())
            self._known = known
        return kept

    def is_foreign(self, name: str, text: str) -> bool:
        """Tell whether something stands under a name that is neither what was written last nor `text`."""
        path = self._folder / name
        try:
            found = read_regular(path)
        except FileNotFoundError:
            return path.is_symlink()
        except OSError:
            return True
        return _digest(found) not in (self._known.get(name), _digest(text.encode()))

    def recognise(self, texts: Mapping[str, str]) -> None:
        """Take files for written here that hold these texts, which the folder's own steps lead to."""
        for name, text in texts.items():
            if (self._folder / name).exists() and not self.is_foreign(name, text):
                self._known[name] = _digest(read_regular(self._folder / name))

    def _read(self) -> dict[str, str]:
        try:
            return dict(json.loads(self._note.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return {}


def renamed(path: Path) -> Path:
    """Give somebody's own file another name, and return that.

    Raises:
        StorageError: the disk refuses.
    """
    try:
        return set_aside(path, EDITED)
    except OSError as error:
        raise StorageError(
            f"workbench: '{path}' is not the workbench's own and cannot be given another name ({reason(error)}); move "
            "it away."
        ) from error


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
