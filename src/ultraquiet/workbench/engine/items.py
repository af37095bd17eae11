"""An item of a board: what it is made from, where its values stand, and whether they are still those."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import StorageError
from ultraquiet._base.provenance import content_hash
from ultraquiet.files import archive
from ultraquiet.workbench.engine.steps import State, parents

FOLDER = "workbench"
FACTS, VALUES = "facts.json", "values.h5"
LATEST = "latest.json"
# Tables of the study that an item depends on besides what it is made of.
_TABLES = {"design": ("closed_loop",), "deploy": ("deploy", "closed_loop")}


def key_of(state: State, board: str, name: str) -> str:
    """Return a hash of everything an item depends on, down to the files it came from."""
    recipe = state[board][name]
    above = [key_of(state, *parent) for parent in parents(recipe)]
    named = (*_TABLES.get(recipe["op"], ()), *(("bench", "blending") if recipe.get("units") else ()))
    tables = {each: state["tables"].get(each) for each in named}
    return content_hash(board, json.dumps(recipe, sort_keys=True), above, tables)[:24]


@dataclass(frozen=True)
class Item:
    """One thing on a board; `folder` is where its values stand once they were made, named by `key`."""

    board: str
    name: str
    recipe: Mapping[str, Any]
    key: str
    folder: Path

    @property
    def ready(self) -> bool:
        """Whether its values are there."""
        return (self.folder / FACTS).exists()

    @cached_property
    def facts(self) -> dict[str, Any]:
        """What was found out when it was made; empty before."""
        try:
            return json.loads((self.folder / FACTS).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise StorageError(
                f"workbench: what was found out on '{self.name}' cannot be read ({error}); make it again."
            ) from error

    def value(self, name: str = "value") -> Any:
        """Return one of its values: a record, a model as a state space, a law.

        Raises:
            StorageError: it was not made yet, or its file is damaged.
        """
        return archive.load(self.folder / VALUES, name)


def item_of(folder: Path, state: State, board: str, name: str) -> Item:
    """Return the item as the boards stand."""
    key = key_of(state, board, name)
    return Item(board, name, dict(state[board][name]), key, folder / FOLDER / "items" / f"{board}-{key}")


def order(state: State, board: str, name: str) -> list[tuple[str, str]]:
    """Return an item and all it is made of, each after its own parents."""
    found: list[tuple[str, str]] = []
    for parent in parents(state[board][name]):
        found += [each for each in order(state, *parent) if each not in found]
    return [*found, (board, name)]


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return what differs between two recipes, in words.

    >>> changes({"of": "a", "stop": 5}, {"of": "a", "stop": 9})
    ['stop was 5, is 9']
    """
    keys = [key for key in {**before, **now} if before.get(key) != now.get(key)]
    return [f"{_named(key)} was {_short(before.get(key))}, is {_short(now.get(key))}" for key in keys]


def _named(key: str) -> str:
    return re.sub(r"_hz$", " (Hz)", re.sub(r"_db$", " (dB)", key)).replace("_", " ")


def _short(value: Any) -> str:
    text = _plain(value)
    return text if len(text) < 60 else f"{text[:57]}..."


def _plain(value: Any) -> str:
    """Return a setting as a reader writes it.

    >>> _plain({"method": "lqg", "band_hz": [10, 100], "tune": True})
    'method lqg, band (Hz) 10 100, tune yes'
    """
    if value is None:
        return "absent"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{_named(str(key))} {_plain(each)}" for key, each in value.items())
    return " ".join(map(_plain, value)) if isinstance(value, list | tuple) else str(value)
