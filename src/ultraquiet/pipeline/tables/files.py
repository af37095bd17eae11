"""What a study of files need not say twice."""

from pathlib import Path
from typing import Any


def with_all_records(content: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a study with the plant made of all its files where `[plant]` names no records.

    >>> with_all_records({"records": {"files": ["run.csv"]}, "plant": {"method": "arx"}})["plant"]["records"]
    ['run']
    """
    plant, records = content.get("plant"), content.get("records")
    if not isinstance(plant, dict) or "records" in plant or not isinstance(records, dict):
        return content
    files = records.get("files")
    listed = files if isinstance(files, list) else [files]
    stems = [Path(file).stem for file in listed if isinstance(file, str)]
    return {**content, "plant": {**plant, "records": list(dict.fromkeys(stems))}} if stems else content
