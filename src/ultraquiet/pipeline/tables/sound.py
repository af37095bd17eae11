"""What is sound in a study that holds mistakes: that its tables fit each other is asked of the rest all the same."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes, steps
from ultraquiet._base.regular import check_regular
from ultraquiet.files import reason

PACKAGED = "suite"  # a list that is no file beside the study
LEANED_ON = (("controllers",), ("closed_loop", "tones_hz"))  # by other tables; without them they would seem wrong


def without_refused(content: Mapping[str, Any], error: ValidationError) -> dict[str, Any] | None:
    """Return the tables without what a schema refused; None where other tables lean on that.

    >>> from ultraquiet._base.tables import Strict
    >>> class Head(Strict):
    ...     seed: int = 0
    >>> class Tables(Strict):
    ...     study: Head
    >>> content = {"study": {"seed": "one", "sede": 2}}
    >>> try:
    ...     Tables.model_validate(content)
    ... except ValidationError as error:
    ...     without_refused(content, error)
    {'study': {}}
    """
    rest = deepcopy(dict(content))
    for refusal in error.errors():
        place = steps(refusal["loc"])
        while place and not isinstance(place[-1], str):
            place = place[:-1]  # of a list that holds one wrong value all goes
        unknown = refusal["type"] == "extra_forbidden"
        if not unknown and (len(place) < 2 or refusal["type"] == "missing"):
            return None
        if not unknown and any(place[: len(each)] == each for each in LEANED_ON):
            return None
        table = _at(rest, place[:-1])
        if isinstance(table, dict):
            cast("dict[str | int, Any]", table).pop(place[-1], None)
    return rest


def _at(table: Any, place: Place) -> Any:
    """Return what stands at a place; None where that is gone already."""
    for step in place:
        try:
            table = table[step]
        except (KeyError, IndexError, TypeError):
            return None
    return table


def note_missing_files(content: Mapping[str, Any], beside: Path, mistakes: Mistakes) -> None:
    """Note every file that a study names and that cannot be read; a relative one stands beside it."""
    for place, name in _files(content):
        try:
            check_regular(beside / name)
        except (OSError, ValueError) as error:
            mistakes.add(place, f"{place[0]}: '{name:.200}' cannot be read ({reason(error)}).")


def _files(content: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    """Yield the place and the name of every file."""
    tables = {key: table for key, table in content.items() if isinstance(table, dict)}
    records, blending = tables.get("records", {}), tables.get("blending", {})
    listed = records.get("files")
    named: list[tuple[Place, Any]] = [
        *((("records", "files", k), name) for k, name in enumerate(listed if isinstance(listed, list) else [])),
        (("records", "mapping"), records.get("mapping")),
        (("experiment", "list"), tables.get("experiment", {}).get("list")),
        *((("blending", key), blending.get(key)) for key in ("sensors", "actuators")),
    ]
    reference = tables.get("bench", {}).get("object")
    if isinstance(reference, str) and ".py:" in reference:
        named.append((("bench", "object"), reference.rpartition(":")[0]))
    return ((place, name) for place, name in named if isinstance(name, str) and name and name != PACKAGED)
