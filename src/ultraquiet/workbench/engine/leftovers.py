"""One workbench at a time in a study's folder, and what one that was killed left half written there is removed."""

import re
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ultraquiet._base.errors import StorageError
from ultraquiet.pipeline.store.entry import remove
from ultraquiet.pipeline.store.lock import HeldError, locked
from ultraquiet.workbench.engine.items import FOLDER

WRITTEN = r"[0-9a-f]{12}\.part"  # how `write_bytes` ends a name that is not valid yet
# Hidden names that the workbench gives, by the folder in which it does.
HIDDEN = {
    ".": rf"\.(study\.toml|study\.py)\.{WRITTEN}",
    "data": rf"\..+\.{WRITTEN}",
    "imports": r"\..+\.part",
    FOLDER: rf"\.dropped\.part|\..+\.json\.{WRITTEN}",
    f"{FOLDER}/items": r"\..+\.part",
    f"{FOLDER}/views": r"\..+\.part\.npz",
}


@contextmanager
def alone(folder: Path) -> Generator[None]:
    """Keep every other workbench out of a study for the length of a block; begin it without leftovers.

    Raises:
        StorageError: another one serves the study, or the folder cannot be written.
    """
    with ExitStack() as held:
        try:
            held.enter_context(locked(folder / FOLDER, lambda _: None))
        except HeldError as error:
            raise StorageError(
                f"serve: a workbench is open on '{folder}' already{error.by}; go to its address, or stop it first."
            ) from None
        sweep(folder)
        yield


def sweep(folder: Path) -> None:
    """Remove what was being written when a workbench was killed; only for who is alone in the folder."""
    for room, name in HIDDEN.items():
        with suppress(OSError):
            for path in (folder / room).iterdir():
                if re.fullmatch(name, path.name):
                    remove(path)
