"""What a study's file may leave out or say in an older way: the tables as they are read."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ultraquiet._base.lines import Place


def with_paper(content: dict[str, Any], places: Mapping[Place, int]) -> tuple[dict[str, Any], Mapping[Place, int]]:
    """Return the content with the older keys `identify.paper_*` as the table `paper` that they are now."""
    sweep = content.get("identify")
    if not isinstance(sweep, dict) or "paper" in content:
        return content, places
    older = {
        key: key.removeprefix("paper_") for key in sweep if key in ("paper_structure", "paper_order", "paper_records")
    }
    if not older:
        return content, places
    table: dict[str, Any] = {"records": ["chirp", "noise", "prbs"], **{new: sweep[key] for key, new in older.items()}}
    moved = {("paper", new): places[("identify", key)] for key, new in older.items() if ("identify", key) in places}
    rest = {key: value for key, value in sweep.items() if key not in older}
    return {**content, "identify": rest, "paper": table}, {**places, **moved}


def with_all_records(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content with the plant made from all files where it names no records."""
    plant, files = content.get("plant"), _files_of(content.get("records"))
    if not isinstance(plant, dict) or "records" in plant or not files:
        return content
    return {**content, "plant": {**plant, "records": list(dict.fromkeys(Path(file).stem for file in files))}}


def _files_of(records: Any) -> list[str]:
    files = records.get("files") if isinstance(records, dict) else None
    return [file for file in files if isinstance(file, str)] if isinstance(files, list) else []
