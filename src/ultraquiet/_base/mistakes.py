"""Mistakes in tables that people write: collected all, told at once, each with its line."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from ultraquiet._base.errors import InputError
from ultraquiet._base.lines import NO_LINE, Place, line_numbers, line_of, told
from ultraquiet._base.registry import known_are
from ultraquiet._base.regular import parse_toml

# What pydantic puts into a place besides keys and indices: the kinds of a value that may be one or the other.
KIND = re.compile(r"\[key\]|constrained-\w+|(?:list|tuple|dict)\[.*\]|float|int|str|bool")
WRONG_KIND = ("list_type", "tuple_type", "float_type", "int_type", "string_type", "bool_type")


class TableError(InputError):
    """Tables with mistakes; `.mistakes` holds them as (line, sentence), sorted by line."""

    consequence: ClassVar[str] = ""

    def __init__(self, name: str, mistakes: Sequence[tuple[int, str]]) -> None:
        self.mistakes = tuple(mistakes)
        count = "one mistake" if len(mistakes) == 1 else f"{len(mistakes)} mistakes"
        lines = told(self.mistakes)
        alone = len(mistakes) == 1 and mistakes[0][0] == NO_LINE
        super().__init__(mistakes[0][1] if alone else f"{name}: {count}{self.consequence}.{lines}")


class Mistakes:
    """A collector that knows where in a text things stand; where there is no text, its mistakes have no lines.

    >>> mistakes = Mistakes({("bench",): 3, ("bench", "unit"): 4})
    >>> mistakes.add(("bench", "unit"), "there is no unit 'moon'.")
    >>> mistakes.by_line()
    [(4, "there is no unit 'moon'.")]
    """

    def __init__(self, places: Mapping[Place, int] | None = None) -> None:
        self._places = places
        # A dictionary, because rounds of a repeat would tell twice.
        self._mistakes: dict[tuple[int, str], None] = {}

    def add(self, place: Place, sentence: str) -> None:
        """Note a mistake at a place."""
        self._mistakes[self.line(place), sentence] = None

    def line(self, place: Place) -> int:
        """Return the line of a place."""
        return NO_LINE if self._places is None else line_of(self._places, place)

    def add_refusal(self, place: Place, error: ValidationError, model: type[BaseModel]) -> None:
        """Note everything that pydantic refused of a table at `place`."""
        for refusal in _of_their_kind(error.errors()):
            self.add((*place, *steps(refusal["loc"])), sentence(refusal, model))

    def by_line(self) -> list[tuple[int, str]]:
        """Return all mistakes by line."""
        return sorted(self._mistakes)

    def refuse(self, error: type[TableError], name: str) -> None:
        """Raise the error when there are mistakes."""
        if self._mistakes:
            raise error(name, self.by_line())

    def __len__(self) -> int:
        return len(self._mistakes)


def steps(loc: Sequence[str | int]) -> Place:
    """Return a place as somebody wrote it, without pydantic's words for keys and kinds."""
    return tuple(step for step in loc if not (isinstance(step, str) and KIND.fullmatch(step)))


def _of_their_kind(refusals: Sequence[Any]) -> list[Any]:
    """Return the refusals without those of a kind that the value never was, where another kind was meant."""
    kinds = [refusal["loc"][: k + 1] for refusal in refusals for k, step in enumerate(refusal["loc"]) if _is_kind(step)]
    meant = [r for r in refusals if r["type"] not in WRONG_KIND]
    asides = {loc for loc in kinds if any(r["loc"][: len(loc) - 1] == loc[:-1] for r in meant)}
    return [r for r in refusals if r["type"] not in WRONG_KIND or r["loc"] not in asides]


def _is_kind(step: str | int) -> bool:
    return isinstance(step, str) and step != "[key]" and KIND.fullmatch(step) is not None


def read_toml(text: str, name: str, error: type[TableError]) -> tuple[dict[str, Any], Mapping[Place, int]]:
    """Return the tables of a TOML text and the line of each; what is no TOML is a mistake like any other."""
    text = text.removeprefix("\ufeff")  # some editors begin a file by it
    try:
        return parse_toml(text), line_numbers(text)
    except tomllib.TOMLDecodeError as refusal:
        match = re.search(r"at line (\d+)", str(refusal))
        raise error(name, [(int(match[1]) if match else 1, f"this is not TOML: {refusal}.")]) from None
    except ValueError as refusal:  # too deep, or dates and whole numbers that Python cannot hold
        raise error(name, [(1, f"this is not TOML: {refusal}.")]) from None


def sentence(refusal: Any, model: type[BaseModel] | None) -> str:
    """Return what pydantic refused as a sentence, its table first; `model` is that of the table its path begins at."""
    path = steps(refusal["loc"])
    tables = _tables(path)
    return f"{tables}: {_said(refusal, path, model)}" if tables else _said(refusal, path, model)


def _tables(path: Place) -> str:
    """Return the names of the tables that a path leads through to its key."""
    ends = [k for k, step in enumerate(path) if isinstance(step, str)]
    return _named(path[: ends[-1]], whole=True) if ends else ""


def _said(refusal: Any, path: Place, model: type[BaseModel] | None) -> str:
    key, kind, value = _named(path), refusal["type"], refusal["input"]
    if kind == "missing":
        return f"'{key}' is missing."
    if kind == "extra_forbidden":
        table = _model_at(model, path[:-1])
        known = [field.alias or name for name, field in table.model_fields.items()] if table else []
        return f"there is no key '{key}' here{known_are(key, known)}."
    if kind == "model_type":
        shown = f'; write {key} = {{ method = "{value}" }}' if isinstance(value, str) and takes_method(refusal) else ""
        return f"'{key}' must be a table, got {value!r}{shown}."
    if kind == "list_type" and isinstance(value, dict):
        return f"'{key}' is a list of tables; write two brackets round its name, [[{key}]]."
    if kind == "value_error":
        return f"'{key}' is {value!r}; {refusal['ctx']['error']}."
    words = _of_length(refusal) or refusal["msg"].removeprefix("Input ")
    return f"'{key}' {words}, got {value!r}." if key else f"it {words}, got {value!r}."


def takes_method(refusal: Any) -> bool:
    """Return whether what was refused should have been the table of a method."""
    return refusal.get("ctx", {}).get("class_name") in ("Method", "BenchTable")


def _of_length(refusal: Any) -> str:
    """Return what is wrong with a value that should be a list, or one of fewer values."""
    kind, value = refusal["type"], refusal["input"]
    if kind in ("tuple_type", "list_type") and isinstance(value, int | float | str):
        numbers = not isinstance(value, str) or ("," in value and re.fullmatch(r"[\d\s.,eE+-]+", value))
        shown = f"[{value}]" if numbers else f'["{value}"]'
        return f"should be a list in brackets, as {shown} is"
    if kind == "too_long":
        return f"should hold at most {refusal['ctx']['max_length']} values, not {refusal['ctx']['actual_length']}"
    return ""


def _named(path: Sequence[str | int], whole: bool = False) -> str:
    """Return the last key of a path, or all of them, with the indices of elements of lists."""
    named: list[str] = []
    index = ""
    for step in reversed(path):
        if isinstance(step, str):
            named.insert(0, f"{step}{index}")
            index = ""
            if not whole:
                break
        else:
            index = f"[{step}]{index}"
    return ".".join(named) or index


def _model_at(kind: Any, path: Sequence[str | int]) -> type[BaseModel] | None:
    """Return the model of the table that a path through a model's fields leads to."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if not path:
            return kind
        field = kind.model_fields.get(str(path[0]))
        return None if field is None else _model_at(field.annotation, path[1:])
    parts = get_args(kind)
    inner = path[1:] if get_origin(kind) in (dict, list) else path
    return next((model for part in parts if (model := _model_at(part, inner)) is not None), None)
