"""The door for records, responses and models: what a verb is handed is what it asks for, or one sentence says so.

`takes_values` reads the annotations of a verb, so that what it documents is what it checks.
"""

import inspect
from collections.abc import Callable, Sequence
from functools import lru_cache, wraps
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, Union, cast, get_args, get_origin

from ultraquiet._base.errors import InputError
from ultraquiet.values.frequency_response import FrequencyResponse
from ultraquiet.values.polynomial import PolynomialMatrix, PolynomialModel
from ultraquiet.values.record import Record

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
CHECKED = {Record, FrequencyResponse, PolynomialMatrix, PolynomialModel}


def takes_values(verb: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments that a function annotates as records, responses or polynomial models, and unions of them.

    A result of an identification stands for its model, and one record for a list of one where only lists are asked for.

    >>> @takes_values
    ... def channels(records: Sequence[Record]) -> int:
    ...     return sum(len(record.sensors) for record in records)
    >>> channels(Record([[0.0, 1.0]], [[0.0, 1.0]], 10.0))
    1
    >>> channels([None])
    Traceback (most recent call last):
    ...
    ultraquiet._base.errors.InputError: channels: 'records' must be a list of Record, got a list of NoneType.
    """

    @wraps(verb)
    def through(*args: P.args, **kwargs: P.kwargs) -> R:
        places, method = _values_of(verb)
        who = type(args[0]).__name__ if method and args else verb.__name__
        passed: list[Any] = list(args)
        named: dict[str, Any] = dict(kwargs)
        for name, (k, kind) in places.items():
            if k < len(passed):
                passed[k] = _taken(who, name, passed[k], kind)
            elif name in named:
                named[name] = _taken(who, name, named[name], kind)
        return verb(*passed, **named)  # type: ignore[arg-type]

    return through


def of_kind(who: str, name: str, value: Any, kind: type[T]) -> T:
    """Return what is of a kind that no room below its own knows.

    Raises:
        InputError: anything else.
    """
    if not isinstance(value, kind):
        raise InputError(f"{who}: '{name}' must be {_words(kind)}, got {_seen(value)}.")
    return value


def answering(who: str, name: str, value: Any) -> Any:
    """Return what has a response at frequencies in Hz: a model or system, also that of a result, or a measured one.

    Raises:
        InputError: anything else.
    """
    for one in (value, getattr(value, "model", None)):
        if isinstance(one, FrequencyResponse) or callable(getattr(one, "frequency_response", None)):
            return one
    raise InputError(f"{who}: '{name}' must be a model, a system or a FrequencyResponse, got {type(value).__name__}.")


@lru_cache(maxsize=256)
def _values_of(verb: Callable[..., Any]) -> tuple[dict[str, tuple[int, Any]], bool]:
    """Return the places and kinds of the arguments that are checked, and whether the verb is a method."""
    parameters = inspect.signature(verb).parameters
    places = {
        name: (k, parameter.annotation)
        for k, (name, parameter) in enumerate(parameters.items())
        if CHECKED & set(_leaves(parameter.annotation))
    }
    return places, "self" in parameters


def _leaves(kind: Any) -> list[Any]:
    return [leaf for part in get_args(kind) for leaf in _leaves(part)] or [kind]


def _taken(who: str, name: str, value: Any, kind: Any) -> Any:
    """Return the value as the verb wants it."""
    for one in (value, [value], getattr(value, "model", None)):
        if one is not None and _is(one, kind):
            return one
    if value is None and _is(value, kind):
        return None
    raise InputError(f"{who}: '{name}' must be {_words(kind)}, got {_seen(value)}.")


def _is(value: Any, kind: Any) -> bool:
    """Return whether a value is of an annotated kind, a list where everything in it is."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_is(value, part) for part in parts)
    if origin is Sequence:
        return isinstance(value, list | tuple) and all(_is(one, parts[0]) for one in cast("Sequence[Any]", value))
    if kind is None or kind is NoneType:
        return value is None
    return not isinstance(kind, type) or isinstance(value, kind)


def _words(kind: Any) -> str:
    """Return a kind in words: "a Record or a list of Record"."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        told = [_words(part) for part in parts if part is not NoneType]
        return " or ".join([", ".join(told[:-1]), told[-1]] if len(told) > 1 else told)
    if origin is Sequence:
        return f"a list of {' or '.join(leaf.__name__ for leaf in dict.fromkeys(_leaves(parts[0])))}"
    return f"{'an' if kind.__name__[0] in 'AEIO' else 'a'} {kind.__name__}"


def _seen(value: Any) -> str:
    if not isinstance(value, list | tuple):
        return type(value).__name__
    kinds = dict.fromkeys(type(one).__name__ for one in cast("Sequence[Any]", value))
    return f"a list of {', '.join(kinds) or 'nothing'}"


__all__ = ["answering", "of_kind", "takes_values"]
