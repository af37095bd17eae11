"""Where a study's records come from, and what a study of files need not say twice."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from ultraquiet._base.mistakes import Mistakes


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


def check_sources(content: Mapping[str, Any], mistakes: Mistakes) -> None:
    """Note where neither a bench nor files give records, or both do."""
    if "bench" not in content and "records" not in content:
        mistakes.add((), "'bench' is missing.")
    if "records" in content and "experiment" in content:
        mistakes.add(("experiment",), "experiment: the records come from files here; leave one of both tables away.")
    _check_bench(content.get("bench"), mistakes)


def _check_bench(table: Any, mistakes: Mistakes) -> None:
    """Note a bench that is named twice or not at all."""
    if not isinstance(table, dict):
        return
    named = cast("dict[str, Any]", table)
    if "method" in named and "object" in named:
        mistakes.add(("bench", "object"), "bench: give either 'method' or 'object', not both.")
    elif "method" not in named and "object" not in named:
        mistakes.add(
            ("bench",), "bench: give 'method', a registered bench, or 'object', \"FILE.py:CALLABLE\" beside the study."
        )
    elif "object" in named and not re.fullmatch(r".+\.py:[A-Za-z_]\w*", str(named["object"])):
        mistakes.add(("bench", "object"), f"bench: 'object' is \"FILE.py:CALLABLE\", got '{named['object']}'.")
