"""What defines a bench, so that its records are known again: settings, channels, rate and files, never an address."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from ultraquiet._base.provenance import content_hash
from ultraquiet.pipeline.store.contents import hash_of

# How long an answer may take decides whether there is one, and no number in it.
PATIENCE = ("timeout_s", "start_timeout_s")
SHOWN = 90  # characters of a setting that a sentence quotes


def identity(bench: Any, table: Mapping[str, Any], beside: Path | None = None) -> dict[str, Any]:
    """Return what defines a bench, in plain types: equal for equal benches, in this process and in the next.

    Of a file that a setting names (the program of a process, its script, an FMU) the content counts, not its place; of
    a function its source, not what it remembers. Files that cannot be found are named without content.

    Args:
        bench: anything with a rate and channels.
        table: `[bench]` of the study that it was made from.
        beside: folder of the study file, where files may stand that the table names.

    >>> from ultraquiet.bench import Process
    >>> process = Process(("no-such-plant", "--quiet"), timeout_s=3.0)
    >>> settings_of(process, ())
    {'command': ['no-such-plant', '--quiet'], 'host': '127.0.0.1', 'port': None, 'token_file': ''}
    """
    places = (*(() if beside is None else (beside,)), Path())
    kind = type(bench)
    settings = {**_plain(dict(table), places), **settings_of(bench, places)}
    return {
        "kind": f"{kind.__module__}.{kind.__qualname__}",
        **{name: value for name, value in settings.items() if name not in PATIENCE},
        "rate_hz": float(bench.rate_hz),
        "actuators": _plain(tuple(bench.actuators), places),
        "sensors": _plain(tuple(bench.sensors), places),
    }


def settings_of(bench: Any, places: Sequence[Path]) -> dict[str, Any]:
    """Return the settings of a bench that is a dataclass, those that make two equal; else its class's source."""
    if not is_dataclass(bench):
        return {"source": _source(type(bench))}
    return {
        field.name: _plain(getattr(bench, field.name), places)
        for field in fields(bench)
        if field.compare and field.name not in PATIENCE
    }


def differences(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return how two benches differ, setting by setting, in words.

    >>> differences({"unit": "ground", "seed": 1}, {"unit": "flight", "seed": 1})
    ["'unit' was 'ground' and is 'flight'"]
    >>> differences({"path": {"file": "a.fmu", "sha256": "1"}}, {"path": {"file": "a.fmu", "sha256": "2"}})
    ["'path': a.fmu has another content"]
    >>> differences({"gains": [0.0] * 99 + [1.0]}, {"gains": [0.0] * 99 + [2.0]})
    ["'gains' holds other values"]
    """
    found: list[str] = []
    for name in (key for key in dict.fromkeys((*was, *now)) if not _agree(was.get(key), now.get(key))):
        files = _changed(was.get(name), now.get(name))
        one, other = _shown(was.get(name)), _shown(now.get(name))
        same = f"'{name}': {files} has another content" if files else f"'{name}' holds other values"
        found.append(f"'{name}' was {one} and is {other}" if one != other else same)
    return found


def _changed(one: Any, other: Any) -> str:
    """Return the name of the first file whose content is another."""
    if isinstance(one, Mapping) and isinstance(other, Mapping) and not _agree(one, other):
        mine, its = cast("Mapping[str, Any]", one), cast("Mapping[str, Any]", other)
        pairs = [(value, its.get(key)) for key, value in mine.items()]
        return str(mine["file"]) if "file" in mine else next(filter(None, (_changed(*pair) for pair in pairs)), "")
    if isinstance(one, list) and isinstance(other, list):
        pairs = zip(cast("list[Any]", one), cast("list[Any]", other), strict=False)
        return next(filter(None, (_changed(*pair) for pair in pairs)), "")
    return ""


def settled(one: Any, other: Any) -> Any:
    """Return what two descriptions of one bench agree in: of a file that it writes itself, the name alone.

    >>> settled({"command": [{"file": "log", "sha256": "1"}]}, {"command": [{"file": "log", "sha256": "2"}]})
    {'command': [{'file': 'log'}]}
    """
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        mine, its = cast("Mapping[str, Any]", one), cast("Mapping[str, Any]", other)
        if "file" in mine and mine.get("sha256") != its.get("sha256"):
            return {key: value for key, value in mine.items() if key != "sha256"}
        return {key: settled(value, its.get(key)) for key, value in mine.items()}
    if isinstance(one, list) and isinstance(other, list):
        return [settled(*pair) for pair in zip(cast("list[Any]", one), cast("list[Any]", other), strict=True)]
    if isinstance(one, str) and isinstance(other, Mapping):  # a file that was not there before
        return {key: value for key, value in cast("Mapping[str, Any]", other).items() if key != "sha256"}
    return one


def _agree(one: Any, other: Any) -> bool:
    """Compare two descriptions; a file that cannot be found, or that the bench writes, contradicts nothing."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        mine, its = dict(cast("Mapping[str, Any]", one)), dict(cast("Mapping[str, Any]", other))
        if "file" in mine and not ("sha256" in mine and "sha256" in its):
            mine.pop("sha256", None)
            its.pop("sha256", None)
        return set(mine) == set(its) and all(_agree(mine[key], its[key]) for key in mine)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_agree, cast("list[Any]", one), cast("list[Any]", other)))
    for described, text in ((one, other), (other, one)):
        if isinstance(described, Mapping) and isinstance(text, str) and "file" in described:
            return text.partition(":")[0].endswith(cast("Mapping[str, str]", described)["file"])
    return bool(one == other)


def _shown(value: Any) -> str:
    text = repr(_named(value))
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def _named(value: Any) -> Any:
    """Return a description with the names of files in place of their content."""
    if isinstance(value, Mapping):
        entries = cast("Mapping[str, Any]", value)
        return entries["file"] if "file" in entries else {key: _named(each) for key, each in entries.items()}
    return [_named(each) for each in cast("list[Any]", value)] if isinstance(value, list) else value


def _plain(value: Any, places: Sequence[Path]) -> Any:
    if isinstance(value, str | Path):
        return _file(str(value), places) or str(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(each, places) for key, each in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, Sequence):
        return [_plain(each, places) for each in cast("Sequence[Any]", value)]
    if isinstance(value, set | frozenset):
        return sorted(_plain(each, places) for each in cast("set[Any] | frozenset[Any]", value))
    if is_dataclass(value) and not isinstance(value, type) and not _hash(value):
        return {f.name: _plain(getattr(value, f.name), places) for f in fields(value) if f.compare}
    return _alone(value)


def _alone(value: Any) -> Any:
    """Return a value that holds no others, in plain types."""
    if value is None or isinstance(value, bool | int | float):
        return value
    if isinstance(value, np.generic):
        return cast("np.generic[Any]", value).item()
    if isinstance(value, np.ndarray):
        return content_hash(value)
    if callable(value):
        return _source(value)
    return _hash(value) or type(value).__qualname__


def _hash(value: Any) -> str:
    """Return the content hash that a value has of its own; empty where it has none."""
    found = getattr(value, "hash", "")
    return found if isinstance(found, str) else ""


def _file(text: str, places: Sequence[Path]) -> dict[str, str] | None:
    """Return name and content of the file that a text names, alone or before a colon (`bench.py:make`)."""
    name, _, rest = text.partition(":")
    for candidate, tail in ((text, ""), (name, rest)):
        for place in places:
            path = place / candidate
            if candidate and "\0" not in candidate and len(candidate) < 1000 and path.is_file():
                return {"file": path.name, "sha256": hash_of(path), **({"name": tail} if tail else {})}
    return None


def _source(function: Callable[..., Any]) -> str:
    """Return a hash of a function's or class's source; what it remembers changes while it runs and cannot count."""
    wrapped = inspect.unwrap(function)
    name = f"{getattr(wrapped, '__module__', '')}.{getattr(wrapped, '__qualname__', type(wrapped).__qualname__)}"
    try:
        return content_hash(name, inspect.getsource(wrapped))
    except (OSError, TypeError):
        return content_hash(name)
