"""From a table to the registered settings object it describes: for lists, studies and the command line alike."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from functools import cache
from math import inf, isnan
from types import NoneType, UnionType
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes, TableError, sentence
from ultraquiet._base.registry import as_given, known_are, lookup, older_names

# Types of settings that a value of a table can be held against; what else a method takes, it judges itself.
_SCALARS = (bool, int, float, str, NoneType, object)
_CONTAINERS = (tuple, list, dict, Sequence, Mapping, Union, UnionType)


class Strict(BaseModel):
    """A table whose unknown keys are mistakes, and whose numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Method(BaseModel):
    """A registered method by its name; every other key is one of its settings.

    >>> Method(method="tone", frequency_hz=60.0).make("signals").frequency_hz
    60.0
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    method: str

    @property
    def settings(self) -> dict[str, Any]:
        """The settings, lists turned into tuples."""
        return {key: _as_tuple(value) for key, value in (self.model_extra or {}).items()}

    def make(self, family: str, **more: Any) -> Any:
        """Return the settings object; `more` are settings the table does not give.

        Raises:
            TableError: the name, a setting or its value will not do; every mistake is told.
        """
        mistakes = Mistakes()
        method = settings_object(family, self.method, {**more, **self.settings}, (), mistakes)
        mistakes.refuse(TableError, f"{family} '{self.method}'")
        return method


def settings_object(
    family: str, name: str, settings: Mapping[str, Any], place: Place, mistakes: Mistakes, pending: Collection[str] = ()
) -> Any | None:
    """Return the registered settings object, or None when one of its settings will not do; every mistake is noted.

    Settings that do not exist are noted and left out: what the object does can be checked all the same.

    Args:
        family: in which `name` is registered.
        name: of the method.
        settings: their values by name, as a table holds them.
        place: where the table stands.
        mistakes: the collector.
        pending: settings whose values are not known, which has been noted already.

    >>> mistakes = Mistakes()
    >>> settings = {"frequenzy_hz": 5.0, "amplitude": float("nan"), "phase_deg": "zero"}
    >>> settings_object("signals", "tone", settings, (), mistakes)
    >>> for _, sentence in mistakes.by_line():
    ...     print(sentence[:69])
    Tone: 'amplitude' must be finite, got nan.
    signals 'tone' has no setting 'frequenzy_hz'; did you mean 'frequency
    signals 'tone': 'phase_deg' should be a valid number, unable to parse
    """
    try:
        kind = lookup(family, name)
    except UltraquietError as error:
        mistakes.add((*place, "method"), str(error))
        return None
    who = f"{family} '{name}'"
    known = {field.name: field for field in fields(kind) if field.init}
    older = older_names(kind)
    for key in older.keys() & settings.keys():
        if older[key] in settings:
            mistakes.add((*place, key), f"{who}: '{key}' is an older name of '{older[key]}'; give one of them.")
    given = {older.get(key, key): key for key in settings}
    settings = {older.get(key, key): value for key, value in settings.items()}
    for key in settings.keys() - known.keys():
        mistakes.add((*place, given[key]), f"{who} has no setting '{key}'{known_are(key, known)}.")
    values = {key: value for key, value in settings.items() if key in known}
    misfits = _misfits(kind, values)
    for key, words in misfits.items():
        mistakes.add((*place, given[key]), as_given(f"{who}: {words}", given))
        del values[key]
    for key in known.keys() - settings.keys() - {older.get(key, key) for key in pending}:
        if _needed(known[key]):
            mistakes.add(place, f"{who} lacks its setting '{key}'.")
    if any(_needed(field) and key not in values for key, field in known.items()):
        return None
    method = _built(kind, values, known, given, place, mistakes)
    unfit = {} if method is None else {key: words for key in values if (words := _no_number(key, values[key]))}
    for key, words in unfit.items():
        mistakes.add((*place, given[key]), as_given(f"{who}: {words}", given))
    return None if misfits or unfit else method


def _needed(field: "Field[Any]") -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _built(
    kind: type[Any],
    settings: dict[str, Any],
    known: Mapping[str, "Field[Any]"],
    given: Mapping[str, str],
    place: Place,
    mistakes: Mistakes,
) -> Any | None:
    """Return the object; when it refuses a value, note that, and try its default for the sake of the others.

    `given` are the names that the settings go by in the table, which stands at `place`.
    """
    left_out: set[str] = set()
    while True:
        try:
            method = kind(**settings)
        except UltraquietError as error:
            words = str(error)
            if any(f"'{key}'" in words for key in left_out):
                return None  # it may be the default that is refused now
            # The sentence names its setting; the line of that setting is where it is mended.
            refused = next((key for key in settings if f"'{key}'" in words), None)
            mistakes.add(place if refused is None else (*place, given[refused]), as_given(words, given))
            if refused is None or _needed(known[refused]):
                return None
            left_out.add(refused)
            del settings[refused]
        except Exception as error:  # a method may be anybody's, and what it is given anything
            if not left_out:
                fault = f"{kind.__name__} does not take these settings ({type(error).__name__}: {error})."
                mistakes.add(place, fault)
            return None
        else:
            return None if left_out else method


def _misfits(kind: type[Any], settings: Mapping[str, Any]) -> dict[str, str]:
    """Return for each setting of a wrong type what is wrong with it."""
    misfits: dict[str, str] = {}
    for key, adapter in _adapters(kind).items():
        if key not in settings:
            continue
        try:
            adapter.validate_python(settings[key])
        except ValidationError as error:
            # Of a union every branch refuses; the first is the one that is usually meant.
            refusal = error.errors()[0]
            loc = (key, *(step for step in refusal["loc"] if isinstance(step, int)))
            misfits[key] = sentence({**refusal, "loc": loc}, None)
    return misfits


def _no_number(key: str, value: Any) -> str:
    """Return what is wrong with numbers that a method took: NaN anywhere, a frequency below zero, a falling band.

    Many methods meet theirs only where they are at work, hours after the bench was driven.
    """
    several = isinstance(value, tuple)
    shown = list(cast("tuple[Any, ...]", value)) if several else value
    numbers = [v for v in (shown if several else [value]) if isinstance(v, int | float)]
    if any(isinstance(v, float) and isnan(v) for v in numbers):  # a whole number may be beyond all floats
        return f"'{key}' must not hold NaN, got {shown}."
    if not key.endswith("_hz") or not numbers:
        return ""
    if min(numbers) < 0:
        return f"'{key}' must not be below zero Hz, got {shown}."
    if max(numbers) == inf:
        return f"'{key}' must be finite, got {shown}."
    if key.split("_")[-2:] == ["band", "hz"] and (len(numbers) != 2 or not 0 < numbers[0] < numbers[1]):
        return f"'{key}' must be two rising frequencies above zero, got {shown}."
    return ""


@cache
def _adapters(kind: type[Any]) -> dict[str, TypeAdapter[Any]]:
    try:
        hints = get_type_hints(kind)
    except Exception:  # names that only a type checker can see
        return {}
    return {field.name: TypeAdapter(hints[field.name]) for field in fields(kind) if _plain(hints[field.name])}


def _plain(hint: Any) -> bool:
    """Return whether a type is made of what a table can hold."""
    if hint in _SCALARS or hint is Ellipsis or get_origin(hint) is Literal:
        return True
    parts = get_args(hint)
    return get_origin(hint) in _CONTAINERS and bool(parts) and all(map(_plain, parts))


def _as_tuple(value: Any) -> Any:
    return tuple(cast("list[Any]", value)) if isinstance(value, list) else value
