"""Files from outside: copied into the study, looked over, and read as what the user confirmed."""

import hashlib
import json
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ultraquiet import files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files import Survey, parse_mapping, read_record, survey
from ultraquiet.values import Record
from ultraquiet.workbench.engine.steps import NAME

FOLDER = "imports"
CHANNEL_KEYS = ("column", "name", "unit", "scale", "offset", "limits")


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file of the study.

    Raises:
        InputError: the name leads out of the study's folder.
    """
    path, root = (folder / name).resolve(), folder.resolve()
    if not path.is_relative_to(root):
        raise InputError(f"workbench: '{name}' is not in the study's folder; drop the file on Records instead.")
    return path


def received(folder: Path, name: str, data: bytes | Path) -> str:
    """Keep a dropped file in the study and return its name there; what has the same name and other content stays."""
    bare = re.sub(r"[^A-Za-z0-9_.-]+", "-", Path(name.replace("\\", "/")).name).lstrip(".-") or "file"
    place = folder / FOLDER
    place.mkdir(parents=True, exist_ok=True)
    digest = _digest(data)
    target, number = place / bare, 1
    while target.exists():
        if _digest(target) == digest:
            return f"{FOLDER}/{target.name}"
        number += 1
        target = place / f"{Path(bare).stem}-{number}{Path(bare).suffix}"
    if isinstance(data, bytes):
        files.write_bytes(target, data)
    else:
        part = target.with_name(f".{target.name}.part")
        shutil.copyfile(data, part)
        part.replace(target)
    return f"{FOLDER}/{target.name}"


def looked_over(folder: Path, name: str, rate_hz: float | None = None) -> Survey:
    """Return what a received file holds; errors as in `files.survey`."""
    return survey(inside(folder, name), rate_hz)


def import_step(
    folder: Path,
    name: str,
    file: str,
    channels: Mapping[str, Sequence[Mapping[str, Any]]],
    rate_hz: float | None = None,
) -> dict[str, Any]:
    """Return the step that reads a received file.

    Args:
        folder: of the study.
        name: of the record on the board.
        file: its name in the study, as `received` returned it.
        channels: `inputs` and `outputs`, each a list of tables as in a mapping (`files.parse_mapping`).
        rate_hz: samples per second; None leaves it to the file.
    """
    path = inside(folder, file)
    if not path.is_file():
        raise InputError(f"workbench: the study holds no file '{file}'; drop it on Records first.")
    sides = {side: [dict(one) for one in channels.get(side, ())] for side in ("inputs", "outputs")}
    return {"op": "import", "name": name, "file": file, "sha256": _digest(path), "rate_hz": rate_hz, **sides}


def mapping_text(recipe: Mapping[str, Any]) -> str:
    """Return the mapping of an import as TOML."""
    lines = [] if recipe["rate_hz"] is None else [f"rate_hz = {recipe['rate_hz']!r}"]
    for side in ("inputs", "outputs"):
        for one in recipe[side]:
            lines.append(f"[[{side}]]")
            lines += [f"{key} = {json.dumps(one[key])}" for key in CHANNEL_KEYS if one.get(key) is not None]
    return "\n".join(lines) + "\n"


def read_import(folder: Path, recipe: Mapping[str, Any]) -> Record:
    """Return the record of an import.

    Raises:
        StorageError: the file is no longer the one that was dropped.
        InputError: as `files.read_record`.
    """
    path = inside(folder, recipe["file"])
    if not path.is_file() or _digest(path) != recipe["sha256"]:
        raise StorageError(
            f"workbench: '{recipe['file']}' is not the file that was dropped any more; drop it once again."
        )
    if not recipe["inputs"] and not recipe["outputs"]:
        return read_record(path, recipe["rate_hz"])
    return read_record(path, mapping=parse_mapping(mapping_text(recipe), f"channels of '{path.name}'"))


def proposed_name(file: str) -> str:
    """Return a name for the record of a file.

    >>> proposed_name("imports/run 7 (b).csv")
    'run-7-b'
    """
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "-", Path(file).stem).strip("-.")
    return stem if NAME.fullmatch(stem) else "record"


def _digest(data: bytes | Path) -> str:
    if isinstance(data, bytes):
        return hashlib.sha256(data).hexdigest()
    with data.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
