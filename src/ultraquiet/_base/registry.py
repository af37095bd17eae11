"""One table of methods: who registers appears in the command line, in study files and in the conformance tests.

A setting that went by another name answers to it: as an argument, in tables and as an attribute.

>>> from ultraquiet._base.registry import methods
>>> "box-jenkins" in methods("identify")
True
"""

from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from functools import wraps
from importlib import import_module, metadata
from types import MappingProxyType
from typing import Any, TypeVar

from ultraquiet._base.errors import InputError, UltraquietError, UnknownMethodError

# The verb each family answers to, and the room whose import registers its built-in methods.
FAMILIES: Mapping[str, str] = MappingProxyType(
    {"signals": "generate", "bench": "run", "identify": "identify", "design": "design", "reduce": "reduce"}
)

_table: dict[str, dict[str, type[Any]]] = {family: {} for family in FAMILIES}
_loaded: set[str] = set()

Method = TypeVar("Method", bound=type[Any])
_OLDER = "_older_names"


def register(family: str, name: str) -> Callable[[Method], Method]:
    """Enter a frozen settings dataclass under `name`; it must have the family's verb as a method."""
    if family not in FAMILIES:
        raise UnknownMethodError(f"registry: there is no family '{family}', only {', '.join(FAMILIES)}.")

    def enter(method: Method) -> Method:
        if not hasattr(method, FAMILIES[family]):
            raise UnknownMethodError(
                f"registry: '{method.__name__}' lacks the verb '{FAMILIES[family]}' of '{family}'."
            )
        registered = _table[family].get(name)
        if registered is not None and registered.__qualname__ != method.__qualname__:
            raise UnknownMethodError(f"registry: '{name}' of '{family}' is taken by {registered.__qualname__}.")
        _table[family][name] = method
        return method

    return enter


@contextmanager
def registered(family: str, name: str, method: type[Any]) -> Generator[None]:
    """Have a method registered within a block and no longer: the table is one for all that runs in a process.

    >>> from ultraquiet._base.registry import methods, registered
    >>> with registered("reduce", "none-at-all", type("Whole", (), {"reduce": None})):
    ...     print("none-at-all" in methods("reduce"))
    True
    >>> "none-at-all" in methods("reduce")
    False
    """
    register(family, name)(method)
    try:
        yield
    finally:
        del _table[family][name]


def methods(family: str) -> Mapping[str, type[Any]]:
    """Return name -> class of a family, built-in ones and those of entry points `ultraquiet.<family>`."""
    if family not in FAMILIES:
        raise UnknownMethodError(f"registry: there is no family '{family}', only {', '.join(FAMILIES)}.")
    if family not in _loaded:
        import_module(f"ultraquiet.{family}")
        for entry in metadata.entry_points(group=f"ultraquiet.{family}"):
            register(family, entry.name)(entry.load())
        _loaded.add(family)
    return MappingProxyType(dict(sorted(_table[family].items())))


def lookup(family: str, name: str) -> type[Any]:
    """Return the class registered under `name`, or name what there is."""
    known = methods(family)
    if name not in known:
        elsewhere = next((other for other in FAMILIES if other != family and name in methods(other)), None)
        hint = "" if elsewhere is None else f" ('{name}' is one of {elsewhere})"
        raise UnknownMethodError(f"{family}: there is no method '{name}'{hint}{known_are(name, known)}.")
    return known[name]


def known_are(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence on an unknown name: which one was meant perhaps, and which there are.

    >>> known_are("ordr", ("order", "delay")), known_are("x", ("order", "delay"))
    ("; did you mean 'order'? Known are order, delay", '; known are order, delay')
    """
    names = list(known)
    nearest = get_close_matches(name, names, n=1)
    listed = f"nown are {', '.join(names)}" if names else "nown are none"
    return f"; did you mean '{nearest[0]}'? K{listed}" if nearest else f"; k{listed}"


def formerly(**older: str) -> Callable[[Method], Method]:
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

    def answering(kind: Method) -> Method:
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
