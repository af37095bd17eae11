"""Mistakes in an experiment list: collected all, told with their lines."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from ultraquiet._base.errors import InputError
from ultraquiet._base.lines import Place, line_of
from ultraquiet.experiments.command import VOCABULARY


class _Undefined:
    """Stands where a variable without a value stood: told once, and not held against anything else."""

    def __repr__(self) -> str:
        return "an undefined variable"


UNDEFINED = _Undefined()


def undefined_in(value: Any) -> bool:
    """Return whether anything inside a value is undefined."""
    if isinstance(value, Mapping):
        return any(undefined_in(held) for held in value.values())
    if isinstance(value, list | tuple):
        return any(undefined_in(held) for held in value)
    return value is UNDEFINED


class ListError(InputError):
    """An experiment list with mistakes; `.mistakes` holds them as (line, sentence), sorted by line."""

    def __init__(self, name: str, mistakes: Sequence[tuple[int, str]]) -> None:
        self.mistakes = tuple(mistakes)
        count = "one mistake" if len(mistakes) == 1 else f"{len(mistakes)} mistakes"
        told = "".join(f"\n  line {line}: {sentence}" for line, sentence in self.mistakes)
        super().__init__(f"{name}: {count}; nothing was executed.{told}")


class Mistakes:
    """A collector that knows where in the text things stand."""

    def __init__(self, places: Mapping[Place, int]) -> None:
        self._places = places
        self._held: dict[tuple[int, str], None] = {}  # a dictionary, because rounds of a repeat would tell twice

    def add(self, place: Place, sentence: str) -> None:
        """Note a mistake at a place."""
        self._held[self.line(place), sentence] = None

    def line(self, place: Place) -> int:
        """Return the line of a place."""
        return line_of(self._places, place)

    def add_refusal(self, place: Place, error: ValidationError, model: type[BaseModel] | None) -> None:
        """Note everything that pydantic refused."""
        for found in error.errors():
            if _follows(found):
                continue
            # The discriminator's word stands in the path but not in the text.
            inner = tuple(k for k in found["loc"] if k not in VOCABULARY)
            word = ("do",) if found["type"] == "union_tag_invalid" else ()
            self.add((*place, *inner, *word), _sentence(found, model))

    def told(self) -> list[tuple[int, str]]:
        """Return all mistakes by line."""
        return sorted(self._held)

    def __len__(self) -> int:
        return len(self._held)


def _follows(found: Any) -> bool:
    """Return whether a refusal is but the consequence of an undefined variable, which is told already."""
    if found["type"] in ("missing", "extra_forbidden", "union_tag_not_found"):
        return False
    given = found["input"]
    return undefined_in(given["do"] if found["type"] == "union_tag_invalid" else given)


def _sentence(found: Any, model: type[BaseModel] | None) -> str:
    key = str(found["loc"][-1]) if found["loc"] else ""
    kind, given = found["type"], found["input"]
    known = ", ".join(model.model_fields) if model else ""
    if kind == "missing":
        return f"'{key}' is missing."
    if kind == "extra_forbidden":
        return f"there is no key '{key}' here; known are {known}."
    if kind == "union_tag_invalid":
        return f"there is no command '{given['do']}'; known are {', '.join(VOCABULARY)}."
    if kind == "union_tag_not_found":
        return f"'do' is missing; it names the command: {', '.join(VOCABULARY)}."
    if kind == "value_error":
        return f"'{key}' is {given!r}; {found['ctx']['error']}."
    words = found["msg"].removeprefix("Input ")
    return f"'{key}' {words}, got {given!r}." if key else f"it {words}, got {given!r}."
