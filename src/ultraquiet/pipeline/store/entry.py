"""What is written down of a finished stage: one file whose rename makes the whole stage valid at once."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.regular import parse_json, read_regular
from ultraquiet.pipeline.store.contents import Hashes, hashes_of, place, staged, vouched

STAGES = "stages"
SUFFIX = ".json"


@dataclass(frozen=True)
class StageEntry:
    """A finished stage: the key it was made with, its facts, and what it left, file by file.

    Args:
        key: hash of everything that it depends on.
        seconds: that it took.
        facts: in plain types.
        values: name of a value -> its file below the study's folder.
        left: what the stage left there, file or folder -> hashes of its content as `hashes_of` gives them; empty where
            nothing may stand.
        replaced: what the stage had left before and leaves no more, likewise; it is removed.
    """

    key: str
    seconds: float
    facts: Any
    values: Mapping[str, str]
    left: Mapping[str, Hashes]
    replaced: Mapping[str, Hashes] = field(default_factory=dict[str, Hashes])


def path_of(folder: Path, stage: str) -> Path:
    """Return the file of a stage."""
    return folder / STAGES / f"{stage}{SUFFIX}"


def sealed(entry: StageEntry) -> bytes:
    """Return an entry as the bytes of its file; once these have their name, the stage is what they say."""
    content = json.loads(json.dumps(vars(entry)))
    return json.dumps({**content, "sha256": _seal(content)}, indent=1).encode()


def read(folder: Path, stage: str) -> StageEntry | None:
    """Return a stage's entry; None when there is none, or none that is whole."""
    try:
        content = parse_json(read_regular(path_of(folder, stage)))
        seal = content.pop("sha256")
        return StageEntry(**content) if seal == _seal(content) else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def is_older(folder: Path, stage: str) -> bool:
    """Tell whether a stage was left by version 0.2 or one before, which wrote no hashes."""
    try:
        return "left" not in parse_json(read_regular(path_of(folder, stage)))
    except (OSError, ValueError, TypeError):
        return False


def settle(folder: Path, entry: StageEntry) -> None:
    """Do what a process that was killed right after it wrote an entry left undone; nothing where all is done.

    Raises:
        OSError: the disk refuses.
    """
    for name, hashes in entry.left.items():
        waiting, target = staged(folder, name), place(folder, name)
        # A folder takes no name that is taken; what stood there was set aside or removed before the entry.
        free = not (waiting.is_dir() and target.exists())
        if hashes and free and hashes_of(waiting) == hashes:
            waiting.replace(target)
    for name, hashes in entry.replaced.items():
        with suppress(StorageError):  # a name that leads out of the folder is none of ours
            target = place(folder, name)
            if vouched(hashes_of(target), hashes):
                remove(target)


def remove(path: Path) -> None:
    """Remove a file or a folder, or nothing."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def settle_all(folder: Path) -> None:
    """Settle every stage of a folder; what an entry names outside of it is left alone."""
    for path in sorted((folder / STAGES).glob(f"*{SUFFIX}")):
        entry = read(folder, path.name.removesuffix(SUFFIX))
        if entry is not None:
            with suppress(UltraquietError, AttributeError, TypeError):
                settle(folder, entry)


def _seal(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
