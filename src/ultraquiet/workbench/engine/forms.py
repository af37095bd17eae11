"""Forms from the registry: for each setting of a method its name, unit, default, range and meaning."""

import inspect
import re
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields
from functools import cache
from typing import Any, Union, get_args, get_origin

from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.mistakes import Mistakes
from ultraquiet._base.registry import lookup, methods
from ultraquiet._base.tables import settings_object
from ultraquiet.signals import Signal

UNITS = {"hz": "Hz", "v": "V", "s": "s", "db": "dB", "deg": "deg", "percent": "%", "samples": "samples"}
LEVEL = "unit"
AUTOMATIC = "automatic"  # what a method finds out by itself
SIMPLE = (bool, int, float, str)
# What no text field can hold: systems, records, tables of a method's own.
CLOSED = ("StateSpace", "Record", "Callable", "Specification", "Channel", "_Line", "_Unpacked")
FAMILIES = ("signals", "identify", "design", "reduce")
CODE = re.compile(r"`([^`]*)`")
REFERENCE = re.compile(r" \(`[a-z_.]+`\)|[,;] see `\w+`")  # to the library's own pages, which a form's reader has not
ENTRY = re.compile(r"^ {4}([a-z_0-9, ]+): (.*)$")
NUMBER = r"(\d+\.?\d*(?:e[-+]?\d+)?)"
RANGE = re.compile(rf"{NUMBER}\s*(?:[\s;\u2010-\u2015-]|to|\.\.)\s*{NUMBER}(?:\s*Hz)?", re.IGNORECASE)


@dataclass(frozen=True)
class Setting:
    """One field of a form. `kind` is "flag", "choice" or "text"; `default` is what stands where nothing is entered."""

    name: str
    unit: str
    kind: str
    default: str
    meaning: str
    allowed: str
    choices: tuple[str, ...]
    plain: bool

    @property
    def label(self) -> str:
        """Its name and unit as a label; a form asks for the method itself under that name.

        >>> Setting("stop_hz", "Hz", "text", "", "", "", (), True).label
        'stop (Hz)'
        >>> Setting("method", "", "choice", "truncation", "", "", (), True).label
        'variant'
        """
        bare = "variant" if self.name == "method" else said(self.name)
        return f"{bare} ({self.unit})" if self.unit else bare


def said(name: str) -> str:
    """Return a setting's name as a reader says it, its unit left away.

    >>> said("stop_hz"), said("roll_off_hz")
    ('stop', 'roll off')
    """
    return re.sub(rf"_({'|'.join(UNITS)})$", "", name).replace("_", " ")


def in_words(text: str, kind: type[Any]) -> str:
    """Return a docstring's text with the names of a method's settings as its form says them."""
    names = {each.name for each in fields(kind) if "_" in each.name}
    bare = CODE.sub(lambda m: f"'{_method_of(m[1])}'", REFERENCE.sub("", text))
    return re.sub(r"'?\b([a-z]+(?:_[a-z0-9]+)+)\b'?", lambda m: said(m[1]) if m[1] in names else m[0], bare)


def left_empty(text: str, empty_is_none: bool) -> str:
    """Return a meaning with what None stands for said as a field shows it, or left away where no field can hold it.

    >>> left_empty("block rows. None tries several.", True), left_empty("corner; None for a constant.", True)
    ('block rows. Left empty, it tries several.', 'corner; left empty for a constant.')
    >>> left_empty('states; "auto" or None takes the best. More.', True)
    'states; left empty, it takes the best. More.'
    >>> left_empty('states; "auto" or None takes the best.', False), left_empty("delay. None tries 1 to 4.", False)
    ('states; "auto" takes the best.', 'delay.')
    """
    if not empty_is_none:
        return re.sub(r"[.;] None [^.;]*(?=[.;])", "", text.replace('"auto" or None', '"auto"'))
    text = text.replace('"auto" or None', "None").replace("when None", "when left empty")

    def word(found: "re.Match[str]") -> str:
        start = "Left" if found[1] in ("", ". ") else "left"
        return f"{found[1]}{start} empty{found[2] if found[2] in (':', ' for') else f',{found[2]}'}"

    text = re.sub(r"(^|[.;] )None(:| for\b| never)", word, text)
    return re.sub(r"(^|[.;] )None (?!when)", lambda m: f"{m[1]}{'left' if m[1] == '; ' else 'Left'} empty, it ", text)


def _method_of(name: str) -> str:
    """Return what a form calls a class of the library: its method's name, where it is one.

    >>> _method_of("LeadLag"), _method_of("budget")
    ('lead-lag', 'budget')
    """
    every = (each for family in FAMILIES for each in methods(family).items())
    return next((method for method, kind in every if kind.__name__ == name), name)


def offered(family: str) -> dict[str, str]:
    """Return the methods of a family by name, each with its first line."""
    return {name: in_words((kind.__doc__ or "").split("\n")[0], kind) for name, kind in methods(family).items()}


@cache
def settings_of(family: str, method: str) -> tuple[Setting, ...]:
    """Return the fields of a method's form: plain ones first."""
    kind = lookup(family, method)
    told = _meanings(kind)
    made = [_setting(kind, field, told.get(field.name, "")) for field in fields(kind) if _open(field)]
    return tuple(sorted(made, key=lambda one: not one.plain))


def entered(family: str, method: str, texts: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the table that a filled form stands for, and for each field that will not do a sentence.

    Args:
        family: of the method.
        method: its name.
        texts: what was entered, by setting; empty texts stand for the default.

    >>> entered("design", "mixed-sensitivity", {"band_hz": "10, 100", "margin": ""})
    ({'method': 'mixed-sensitivity', 'band_hz': [10, 100]}, {})
    """
    given = {key: _value(text) for key, text in texts.items() if text is not None and text != ""}
    faults: dict[str, str] = {}
    mistakes = Mistakes()
    as_tuples = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}
    settings_object(family, method, as_tuples, (), mistakes)
    for _, sentence in mistakes.by_line():
        named = next((key for key in given if f"'{key}'" in sentence), "")
        faults[named] = sentence
    return {"method": method, **given}, faults


def _open(field: "Field[Any]") -> bool:
    return field.init and not field.name.startswith("_") and not _closed(field)


def _closed(field: "Field[Any]") -> bool:
    words = str(field.type)
    return any(word in words for word in CLOSED) and not any(word in words for word in ("float", "str"))


def _setting(kind: type[Any], field: "Field[Any]", meaning: str) -> Setting:
    level = issubclass(kind, Signal) and field.name in kind.levels
    # a level has the unit of the actuator which sends it
    unit = LEVEL if level else UNITS.get(field.name.rpartition("_")[2], "")
    allowed, choices = _allowed(kind, field)
    if choices and _shown(field) not in choices:
        choices = (_shown(field), *choices)
    flag = field.type is bool or field.type == "bool"
    form = "flag" if flag else "choice" if choices else "text"
    written = _written(field.type)
    plain = field.type in SIMPLE or any(each in written for each in ("int |", "float |", "tuple[float, float]"))
    simple = plain and "StateSpace" not in written and "Sequence" not in written
    shown = "from the actuator" if level and field.default is None else _shown(field)
    return Setting(field.name, unit, form, shown, meaning, allowed, choices, simple)


def _written(kind: Any) -> str:
    """Return a type as annotations write it, however Python keeps it.

    >>> _written(int | None) == _written("int | None") == _written(Union[int, None]) == "int | None"
    True
    """
    if get_origin(kind) is not Union:
        return str(kind)
    names = ("None" if each is type(None) else getattr(each, "__qualname__", str(each)) for each in get_args(kind))
    return " | ".join(names)


def _shown(field: "Field[Any]") -> str:
    if field.default is MISSING:
        return "" if field.default_factory is MISSING else AUTOMATIC
    value = field.default
    if value is None:
        return AUTOMATIC
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _allowed(kind: type[Any], field: "Field[Any]") -> tuple[str, tuple[str, ...]]:
    """Return the range of a setting in words, and its choices, as its own refusal states them."""
    probes: tuple[Any, ...] = ("no such choice",) if field.type in (str, "str") else (-10, -1e300, 1e300)
    for probe in probes:
        try:
            kind(**{field.name: probe})
        except UltraquietError as error:
            words = str(error)
            if f"'{field.name}'" not in words:
                continue
            if found := re.search(r"must be one of (.+), got", words):
                return "", tuple(re.findall(r"'([^']*)'", found[1]))
            if found := re.search(r"must (be|lie) (.+?), got", words):
                return found[2], ()
        except Exception:  # a method may be anybody's, and what it is given anything
            continue
    return "", ()


@cache
def _meanings(kind: type[Any]) -> dict[str, str]:
    """Return what the docstrings of a class and those it is made from say of each setting."""
    told: dict[str, str] = {}
    names: list[str]
    for each in reversed(kind.__mro__):
        names, inside = [], False
        for line in (inspect.cleandoc(each.__doc__ or "")).split("\n"):
            if line in ("Args:", "Attributes:"):
                inside = True
            elif inside and (found := ENTRY.match(line)):
                names = [name.strip() for name in found[1].split(",")]
                told |= dict.fromkeys(names, found[2])
            elif inside and line.startswith("        "):
                told |= {name: f"{told[name]} {line.strip()}" for name in names}
            elif inside and line.strip() and not line.startswith(" "):
                inside = False
    given = {each.name: each.default for each in fields(kind)}
    return {name: left_empty(in_words(text, kind), given.get(name) is None) for name, text in told.items()}


def _value(text: Any) -> Any:
    """Return what a text stands for: numbers, several of them between commas or as people write a range, words.

    >>> [_value(text) for text in ("0.5", "10, 100", "10 100", "10-100", "10 to 100 Hz", "-3", "1e-3", "full")]
    [0.5, [10, 100], [10, 100], [10, 100], [10, 100], -3, 0.001, 'full']
    """
    if not isinstance(text, str):
        return text
    bare = text.strip().strip("()[]")
    if found := RANGE.fullmatch(bare):
        bare = f"{found[1]}, {found[2]}"
    for written in (bare, f"[{bare}]"):
        try:
            return tomllib.loads(f"value = {written}")["value"]
        except tomllib.TOMLDecodeError:
            continue
    return text.strip()
