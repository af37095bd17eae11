"""Settings of a registered method from `--set key=value` words."""

import re
import tomllib
from collections.abc import Callable, Sequence
from typing import Any

from ultraquiet._base import registry
from ultraquiet._base.errors import InputError
from ultraquiet._base.tables import Method


def method(family: str, name: str, assignments: Sequence[str], **options: Any) -> Any:
    """Return the settings object of a method; values are written as in TOML, bare words are text."""
    settings: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    given: set[str] = set()
    for assignment in assignments:
        key, equals, value = assignment.partition("=")
        if not equals or not key:
            raise InputError(f"--set: '{assignment}' must read key=value.")
        if key == "method":
            raise InputError("--set: the method is chosen with --method.")
        name_of = key.replace("-", "_")
        if name_of in given:
            raise InputError(f"--set: '{name_of}' is given twice; leave one away.")
        if re.fullmatch(r"[+-]?\d+,\d+", value):
            point = value.replace(",", ".")
            raise InputError(
                f"--set: '{assignment}' has a comma; write {key}={point} for a number, [{value}] for a list."
            )
        settings[name_of] = _value(value)
        given.add(name_of)
    return Method(method=name, **settings).make(family)


def completing(family: str) -> Callable[[str], list[str]]:
    """Return what the shell asks for the names of a family's methods that begin so."""

    def begins(incomplete: str) -> list[str]:
        return [name for name in registry.methods(family) if name.startswith(incomplete)]

    return begins


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
