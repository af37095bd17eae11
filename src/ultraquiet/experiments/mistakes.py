"""Mistakes in an experiment list: those of its vocabulary, and those that follow from an undefined variable."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes, TableError, sentence
from ultraquiet._base.registry import known_are
from ultraquiet.experiments.command import VOCABULARY


class _Undefined:
    """Stands where a variable without a value stood: told once, and not held against anything else."""

    def __repr__(self) -> str:
        return "an undefined variable"


UNDEFINED = _Undefined()


def undefined_in(value: Any) -> bool:
    """Return whether anything inside a value is undefined."""
    if isinstance(value, Mapping):
        return any(undefined_in(inner) for inner in value.values())
    if isinstance(value, list | tuple):
        return any(undefined_in(inner) for inner in value)
    return value is UNDEFINED


class ListError(TableError):
    """An experiment list with mistakes; `.mistakes` holds them as (line, sentence), sorted by line."""

    consequence = "; nothing was executed"


def add_command_refusal(
    mistakes: Mistakes, place: Place, error: ValidationError, model: type[BaseModel] | None
) -> None:
    """Note everything that pydantic refused of a command at `place`."""
    for refusal in error.errors():
        if _follows(refusal):
            continue
        # The discriminator's word stands in the path but not in the text.
        path = tuple(step for step in refusal["loc"] if step not in VOCABULARY)
        word = ("do",) if refusal["type"] == "union_tag_invalid" else ()
        mistakes.add((*place, *path, *word), _sentence({**refusal, "loc": path}, model))


def _follows(refusal: Any) -> bool:
    """Return whether a refusal is but the consequence of an undefined variable, which is told already."""
    if refusal["type"] in ("missing", "extra_forbidden", "union_tag_not_found"):
        return False
    value = refusal["input"]
    return undefined_in(value["do"] if refusal["type"] == "union_tag_invalid" else value)


def _sentence(refusal: Any, model: type[BaseModel] | None) -> str:
    if refusal["type"] == "union_tag_invalid":
        word = str(refusal["input"]["do"])
        return f"there is no command '{word}'{known_are(word, VOCABULARY)}."
    if refusal["type"] == "union_tag_not_found":
        return f"'do' is missing; it names the command: {', '.join(VOCABULARY)}."
    return sentence(refusal, model)
