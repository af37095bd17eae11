"""One table of methods: who registers appears in the command line, in study files and in the conformance tests.

>>> from ultraquiet._base.registry import methods
>>> "box-jenkins" in methods("identify")
True
"""

from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from importlib import import_module, metadata
from types import MappingProxyType
from typing import Any, TypeVar

from ultraquiet._base.errors import UnknownMethodError

# The verb each family answers to, and the room whose import registers its built-in methods.
FAMILIES: Mapping[str, str] = MappingProxyType(
    {"signals": "generate", "bench": "run", "identify": "identify", "design": "design", "reduce": "reduce"}
)

_table: dict[str, dict[str, type[Any]]] = {family: {} for family in FAMILIES}
_loaded: set[str] = set()

Method = TypeVar("Method", bound=type[Any])


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
