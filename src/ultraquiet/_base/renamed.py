"""Settings that went by another name: the older one is taken as an argument, in tables and as an attribute."""

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar

from ultraquiet._base.errors import InputError, UltraquietError

Settings = TypeVar("Settings", bound=type[Any])
_OLDER = "_older_names"


def formerly(**older: str) -> Callable[[Settings], Settings]:
    """Let a settings dataclass answer to older names of its fields; what is shown of it has the newer ones alone.

    Args:
        older: older name = newer name.

    Raises:
        InputError: at use, where both names of a setting are given.

    >>> from dataclasses import dataclass
    >>> @formerly(height_m="size_m")
    ... @dataclass(frozen=True)
    ... class Box:
    ...     size_m: float = 1.0
    >>> Box(height_m=2.0), Box(2.0).height_m
    (Box(size_m=2.0), 2.0)
    """

    def answering(kind: Settings) -> Settings:
        made = kind.__init__

        @wraps(made)
        def init(self: Any, *values: Any, **settings: Any) -> None:
            for name in older.keys() & settings.keys():
                if older[name] in settings:
                    raise InputError(
                        f"{kind.__name__}: '{name}' is an older name of '{older[name]}'; give one of them."
                    )
            try:
                made(self, *values, **{older.get(name, name): value for name, value in settings.items()})
            except UltraquietError as error:
                given = {older[name]: name for name in older.keys() & settings.keys()}
                if not given:
                    raise
                raise type(error)(as_given(str(error), given)) from None

        kind.__init__ = init
        setattr(kind, _OLDER, dict(older))
        for name, newer in older.items():
            setattr(kind, name, _reader(newer))
        return kind

    return answering


def older_names(kind: type[Any]) -> Mapping[str, str]:
    """Return older name -> newer name of the settings of a class; empty for most."""
    return getattr(kind, _OLDER, {})


def as_given(words: str, given: Mapping[str, str]) -> str:
    """Return a sentence on settings, newer name -> name that was given, with the names that whoever gave them knows.

    >>> as_given("Box: 'size_m' must be above zero, got -1.", {"size_m": "height_m"})
    "Box: 'height_m' must be above zero, got -1."
    """
    for newer, name in given.items():
        words = words.replace(f"'{newer}'", f"'{name}'")
    return words


def _reader(newer: str) -> property:
    def read(self: Any) -> Any:
        return getattr(self, newer)

    return property(read, doc=f"What `{newer}` is; its older name.")
