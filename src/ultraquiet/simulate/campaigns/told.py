"""What defines a bench that is held in memory, so that the results of its campaign are known again."""

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, cast

import numpy as np

from ultraquiet._base.provenance import content_hash

BYTES_OF_A_NAME = 4096  # of a path on any system; what is longer names no file


def told(value: Any) -> Any:
    """Return what defines a bench, or anything that it holds, in plain types; never an address.

    Of a class or a function its name and the content of its file, of an object its class and what it holds: fields that
    make two equal where it is a dataclass, else all its attributes.

    >>> told({"gain": 2.0, "of": ("left", None)})
    {'gain': 2.0, 'of': ['left', None]}
    >>> class Rig: ...
    >>> told(Rig()) == told(Rig())
    True
    """
    return _Telling().of(value)


def kinds(bench: Any) -> list[Any]:
    """Return the classes of a bench and of those it stands around, by name and the content of their files."""
    found: list[Any] = []
    while bench is not None and len(found) < 9:
        found.append(_class(type(bench)))
        bench = getattr(bench, "bench", None)
    return found


class _Telling:
    """One description; an object that comes again is named by where it came first."""

    def __init__(self) -> None:
        self._met: dict[int, Any] = {}  # holds what it met, so that no address comes twice

    def of(self, value: Any) -> Any:
        """Return the description of one value."""
        found = _alone(value)
        if found is not None or value is None:
            return found
        if id(value) in self._met:
            return ["as before", list(self._met).index(id(value))]
        self._met[id(value)] = value
        if isinstance(value, Mapping):
            return {str(key): self.of(each) for key, each in cast("Mapping[Any, Any]", value).items()}
        if isinstance(value, set | frozenset):
            return sorted(content_hash(self.of(each)) for each in cast("set[Any]", value))
        if isinstance(value, Sequence | np.ndarray):
            return [self.of(each) for each in cast("Sequence[Any]", value)]
        return self._compound(value)

    def _compound(self, value: Any) -> Any:
        """Return the description of a function with what it closes over, or of an object with what it holds."""
        if isinstance(value, MethodType):
            return [self.of(value.__func__), self.of(value.__self__)]
        if isinstance(value, partial):
            return [self.of(value.func), self.of(value.args), self.of(value.keywords)]
        if isinstance(value, FunctionType):
            return [_function(value), self.of(value.__defaults__), *map(self.of, _closed_over(value))]
        return {"class": _class(type(value)), **{name: self.of(each) for name, each in _held(value).items()}}


def _alone(value: Any) -> Any:
    """Return the description of a value that holds no others; None where it holds some."""
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, complex | bytes | Path | np.generic):
        return repr(value)
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return content_hash(value)
    if isinstance(value, type):
        return _class(value)
    if isinstance(value, ModuleType | BuiltinFunctionType):
        return value.__name__
    own = getattr(value, "hash", None) if hasattr(type(value), "hash") else None
    return own if isinstance(own, str) else None


def _held(value: Any) -> dict[str, Any]:
    if is_dataclass(value):
        return {field.name: getattr(value, field.name, None) for field in fields(value) if field.compare}
    named = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    slots = {name: getattr(value, name) for name in named if isinstance(name, str) and hasattr(value, name)}
    return {**slots, **getattr(value, "__dict__", {})}


def _closed_over(function: FunctionType) -> list[Any]:
    found: list[Any] = []
    for cell in function.__closure__ or ():
        try:
            found.append(cell.cell_contents)
        except ValueError:  # not bound yet
            found.append(None)
    return found


def _class(kind: type) -> list[Any]:
    """Return the name of a class, and the files in which it and what it inherits from are written."""
    written: list[Any] = []
    for each in kind.__mro__[:-1]:
        found = next(filter(None, map(_file, _functions(each))), None)
        written.append(found or [_function(function) for function in _functions(each)])
    return [f"{kind.__module__}.{kind.__qualname__}", written]


def _functions(kind: type) -> list[FunctionType]:
    """Return the functions that stand in a class, properties and methods of the class too."""
    found: list[Any] = []
    for each in vars(kind).values():
        found += [each.fget, each.fset] if isinstance(each, property) else [getattr(each, "__func__", each)]
    return [inspect.unwrap(each) for each in found if isinstance(each, FunctionType)]


def _function(function: FunctionType) -> list[Any]:
    """Return the name of a function, and its file; what it does, where it was written in none."""
    code = function.__code__
    constants = [each for each in code.co_consts if isinstance(each, bool | int | float | str)]
    does = _file(function) or [code.co_code.hex(), list(code.co_names), constants]
    return [f"{function.__module__}.{function.__qualname__}", does]


def _file(function: Callable[..., Any]) -> str:
    """Return the hash of the file in which a function is written; empty where there is none."""
    name = getattr(getattr(function, "__code__", None), "co_filename", "")
    try:
        path = Path(name)
        if not name or len(name) > BYTES_OF_A_NAME or not path.is_file():
            return ""
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""
