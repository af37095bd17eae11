"""A mapping: a TOML file that says which columns of a file are which channels, and in what units."""

import os
import re
from collections.abc import Mapping as AnyMapping
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet._base.lines import Place, line_numbers, line_of, told
from ultraquiet._base.regular import parse_toml, read_regular_text
from ultraquiet.files.atomic import reason
from ultraquiet.files.select import Picked, chosen
from ultraquiet.files.table import Column, FileTable

HEAD = ("rate_hz", "crop_s", "inputs", "outputs")
CHANNEL = ("column", "name", "unit", "scale", "offset", "limits")


class MappingError(InputError):
    """A mapping with mistakes; `.mistakes` holds them as (line, sentence), sorted by line."""

    def __init__(self, name: str, mistakes: Sequence[tuple[int, str]]) -> None:
        self.mistakes = tuple(sorted(set(mistakes)))
        count = "one mistake" if len(self.mistakes) == 1 else f"{len(self.mistakes)} mistakes"
        super().__init__(f"{name}: {count}; nothing was read.{told(self.mistakes)}")


@dataclass(frozen=True)
class Mapped:
    """One channel of a mapping: which column, and what becomes of it: `scale * value + offset`, in `unit`."""

    column: str
    name: str | None
    unit: str | None
    scale: float
    offset: float
    limits: tuple[float, float] | None
    place: Place

    def apply(self, c: Column) -> Column:
        """Return the column as the channel it stands for."""
        low, high = self.limits or sorted(self.scale * limit + self.offset for limit in (c.low, c.high))
        plain = self.scale == 1 and self.offset == 0
        return replace(
            c,
            name=c.name if self.name is None else self.name,
            unit=c.unit if self.unit is None else self.unit,
            values=c.values if plain else self.scale * c.values + self.offset,
            low=low,
            high=high,
        )


@dataclass(frozen=True)
class Mapping:
    """A mapping without mistakes of its own; `pick` finds those against a file."""

    name: str
    text: str
    rate_hz: float | None
    crop_s: tuple[float, float] | None
    inputs: tuple[Mapped, ...]
    outputs: tuple[Mapped, ...]
    places: AnyMapping[Place, int] = field(repr=False, compare=False)

    def pick(self, table: FileTable) -> Picked:
        """Return the columns that go in and those that come out, renamed and scaled.

        Raises:
            MappingError: columns that the file does not have; all of them are told, each with its line.
        """
        mistakes: list[tuple[int, str]] = []
        picked = [self._channels(table, mapped, mistakes) for mapped in (self.inputs, self.outputs)]
        if mistakes:
            raise MappingError(self.name, mistakes)
        return picked[0], picked[1]

    def _channels(self, table: FileTable, mapped: Sequence[Mapped], mistakes: list[tuple[int, str]]) -> list[Column]:
        picked: list[Column] = []
        for one in mapped:
            line = line_of(self.places, (*one.place, "column"))
            try:
                columns = chosen(table, one.column)
            except InputError as error:
                mistakes.append((line, str(error).removeprefix("read_record: ")))
                continue
            if len(columns) > 1 and one.name is not None:
                mistakes.append((line, f"'{one.column}' are {len(columns)} columns, which cannot share one name."))
            picked.extend(one.apply(c) for c in columns)
        return picked


def load_mapping(path: str | os.PathLike[str]) -> Mapping:
    """Read a mapping and check it whole.

    Args:
        path: a TOML file as in the example of `parse_mapping`.

    Raises:
        MappingError: what is wrong with it, all at once, each mistake with its line.
        InputError: the file cannot be read.
    """
    try:
        text = read_regular_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"mapping: '{path}' cannot be read ({reason(error)}).") from error
    return parse_mapping(text, f"mapping '{path}'")


def parse_mapping(text: str, name: str = "mapping") -> Mapping:
    """Check the text of a mapping; errors as in `load_mapping`.

    `rate_hz` overrides the file's rate; `crop_s` keeps the samples from the first second to before the second. Each
    `[[inputs]]` and `[[outputs]]` names a `column` (as `inputs=` of `read_record` would), and may give its channel a
    `name`, a `unit`, a `scale` and an `offset` (scale * value + offset, in the new unit) and `limits` in that unit.

    >>> parse_mapping('''
    ... rate_hz = 2500.0
    ... crop_s = [0.5, 4.5]
    ... [[inputs]]
    ... column = "iq_adx"
    ... name = "current"
    ... unit = "A"
    ... limits = [-10.0, 10.0]
    ... [[outputs]]
    ... columm = "omega_max"
    ... scale = 0.0
    ... ''')
    Traceback (most recent call last):
    ultraquiet.files.mapping.MappingError: mapping: 3 mistakes; nothing was read.
      line 9: 'column' is missing; it names the column of the file.
      line 10: there is no key 'columm' here; known are column, name, unit, scale, offset, limits.
      line 11: 'scale' must be a finite number other than zero, got 0.0.
    """
    try:
        content = parse_toml(text)
    except ValueError as error:  # no TOML, or tables too deep, or numbers that Python cannot hold
        match = re.search(r"at line (\d+)", str(error))
        raise MappingError(name, [(int(match[1]) if match else 1, f"this is not TOML: {error}.")]) from None
    check = _Check(line_numbers(text))
    check.keys((), content, HEAD)
    rate_hz = content.get("rate_hz")
    if rate_hz is not None and not (_number(rate_hz) and rate_hz > 0):
        check.add(("rate_hz",), f"'rate_hz' must be a number above zero, got {rate_hz!r}.")
    crop_s = check.pair((), content, "crop_s")
    if crop_s is not None and crop_s[0] < 0:
        check.add(("crop_s",), f"'crop_s' counts from the first sample, got {crop_s[0]:g} s.")
    inputs, outputs = (check.channels(content, kind) for kind in ("inputs", "outputs"))
    if check.mistakes:
        raise MappingError(name, check.mistakes)
    return Mapping(name, text, None if rate_hz is None else float(rate_hz), crop_s, inputs, outputs, check.places)


class _Check:
    """Collects mistakes with their lines while the content is taken apart."""

    def __init__(self, places: AnyMapping[Place, int]) -> None:
        self.places = places
        self.mistakes: list[tuple[int, str]] = []

    def add(self, place: Place, sentence: str) -> None:
        self.mistakes.append((line_of(self.places, place), sentence))

    def keys(self, place: Place, content: AnyMapping[str, Any], known: Sequence[str]) -> None:
        for key in content:
            if key not in known:
                self.add((*place, key), f"there is no key '{key}' here; known are {', '.join(known)}.")

    def pair(self, place: Place, content: AnyMapping[str, Any], key: str) -> tuple[float, float] | None:
        value = content.get(key)
        if value is None:
            return None
        if isinstance(value, list) and len(value) == 2 and all(map(_number, value)) and value[0] < value[1]:
            return float(value[0]), float(value[1])
        self.add((*place, key), f"'{key}' must be two rising numbers, got {value!r}.")
        return None

    def channels(self, content: AnyMapping[str, Any], kind: str) -> tuple[Mapped, ...]:
        tables = content.get(kind)
        if not isinstance(tables, list) or not tables or not all(isinstance(one, dict) for one in tables):
            self.add((kind,), f"'{kind}' are missing; at least one [[{kind}]] with its column is needed.")
            return ()
        return tuple(self._channel((kind, k), one) for k, one in enumerate(tables))

    def _channel(self, place: Place, content: AnyMapping[str, Any]) -> Mapped:
        self.keys(place, content, CHANNEL)
        column = content.get("column")
        if column is None:
            self.add(place, "'column' is missing; it names the column of the file.")
        elif isinstance(column, bool) or not isinstance(column, str | int):
            self.add((*place, "column"), f"'column' must be a name or a number from one, got {column!r}.")
        for key in ("name", "unit"):
            if not isinstance(content.get(key, ""), str):
                self.add((*place, key), f"'{key}' must be a text, got {content[key]!r}.")
        scale, offset = content.get("scale", 1.0), content.get("offset", 0.0)
        if not (_number(scale) and scale != 0):
            self.add((*place, "scale"), f"'scale' must be a finite number other than zero, got {scale!r}.")
        if not _number(offset):
            self.add((*place, "offset"), f"'offset' must be a finite number, got {offset!r}.")
        limits = self.pair(place, content, "limits")
        return Mapped(str(column), content.get("name"), content.get("unit"), scale, offset, limits, place)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
