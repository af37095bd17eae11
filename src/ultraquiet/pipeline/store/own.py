"""What a study writes stays in its folder: nothing in there may lead elsewhere, or be anything but files and folders.

A folder that somebody sent may hold links to files of the one who runs the study: whatever writes follows them.
"""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from ultraquiet._base.errors import StorageError
from ultraquiet.files.names import refuse_way_out
from ultraquiet.pipeline.store.entry import STAGES

# What a study writes, right in its folder and in rooms of it; everything else there is its owner's.
FILES = ("study.lock", "study.json", "summary.json", "report.html", "campaign.json", "campaign.parquet")
ROOMS = ("records", "models", "controllers", "loops", "code", STAGES, "campaign")


def require_own(folder: Path) -> None:
    """Refuse a folder in which something that a study writes or reads again is no file of its own.

    Raises:
        StorageError: a link that leads out of the folder or in a circle, a device, a pipe or a socket.
    """
    for path in _written(folder):
        try:
            mode = path.lstat().st_mode
        except OSError:  # not there, or gone meanwhile
            continue
        if stat.S_ISLNK(mode):
            refuse_way_out("study", folder, path)
        elif not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise StorageError(f"study: '{path}' is a device or a pipe, no file; remove it, or choose another --out.")


def _written(folder: Path) -> Iterator[Path]:
    yield from (folder / name for name in FILES)
    for room in ROOMS:
        yield folder / room
        for place, folders, files in os.walk(folder / room):
            yield from (Path(place, name) for name in (*folders, *files))
