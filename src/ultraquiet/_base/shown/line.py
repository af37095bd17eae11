"""One line that says what an object is: its class, its status, and the numbers that fit."""

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, cast

import numpy as np

LONGEST = 160  # characters; a line of a terminal and a half
WORDS = 48  # characters of one text within it
LEAST_CHANCE = 1e-12  # a p-value below it has no digit that says anything
AT_REST_HZ = 1e-9  # no bench swings as slowly
MOST_DIGITS = 17  # of a double
MOST_ENTRIES = 8  # of a sequence or an array


def line(shown: object) -> str:
    """Return an object on one line of at most `LONGEST` characters.

    Settings are written as they would be typed, defaults left out; anything else stands in angle brackets, its status
    first. A class that knows better says so in `_in_a_line`.
    """
    name = type(shown).__name__
    if (own := getattr(shown, "_in_a_line", None)) is not None:
        return _bracketed(name, word(shown), [own()])
    given = dict(attributes(shown))
    if is_dataclass(shown) and all(is_plain(value) for value in given.values()):
        changed = {f.name: given[f.name] for f in fields(shown) if f.name in given and not _is_default(f, given)}
        typed = f"{name}({', '.join(f'{key}={text(value)}' for key, value in changed.items())})"
        if len(typed) <= LONGEST:
            return typed
        return _fitted(f"{name}(", [f"{key}={text(value)}" for key, value in changed.items()], ")")
    facts = [fact for key, value in given.items() if key != "status" and (fact := _fact(key, value))]
    return _bracketed(name, word(shown), facts)


def counted(number: int, what: str, several: str = "") -> str:
    """Return a number of things in words; `several` is what more than one of them are called, or do.

    >>> counted(1, "input"), counted(3, "input"), counted(1, "is better", "are better"), counted(0, "pass", "passes")
    ('1 input', '3 inputs', '1 is better', '0 passes')
    """
    return f"{number} {several_of(number, what, several)}"


def several_of(number: int, what: str, several: str = "") -> str:
    """Return the word for one thing, or for so many.

    >>> several_of(1, "mode"), several_of(2, "mode"), several_of(2, "is", "are")
    ('mode', 'modes', 'are')
    """
    return what if number == 1 else several or f"{what}s"


def chance(p: float) -> str:
    """Return a p-value as a sentence says it.

    >>> chance(0.0312), chance(6.2e-309), chance(float("nan"))
    ('0.031', 'below 1e-12', 'nan')
    """
    return f"below {LEAST_CHANCE:g}" if p <= LEAST_CHANCE else f"{p:.2g}"


def p_in_words(p: float) -> str:
    """Return a p-value with its letter.

    >>> p_in_words(0.0312), p_in_words(0.0)
    ('p = 0.031', 'p below 1e-12')
    """
    return f"p {chance(p)}" if p <= LEAST_CHANCE else f"p = {chance(p)}"


def rounded(value: float, digits: int = 1) -> str:
    """Return a number with so many decimals, never as a zero below zero.

    >>> rounded(-0.04), rounded(2.347, 2)
    ('0.0', '2.35')
    """
    return f"{round(value, digits) + 0.0:.{digits}f}"


def figure_or(value: float | None, digits: int = 1, otherwise: str = "-") -> str:
    """Return a number with so many decimals, or what stands for one that nobody knows or that is not finite.

    >>> figure_or(2.347, 2), figure_or(float("nan")), figure_or(None), figure_or(float("-inf"), otherwise="unstable")
    ('2.35', '-', '-', 'unstable')
    """
    return otherwise if value is None or not np.isfinite(value) else rounded(value, digits)


def on_its_side(value: float, bound: float, least: int, form: str = "f") -> str:
    """Write a figure that misses a bound with `least` digits of a format, and more where these would say it is kept.

    >>> on_its_side(19.9962, 20.0, 1), on_its_side(17.31, 20.0, 1), on_its_side(5.00004, 5.0, 4, "g")
    ('19.996', '17.3', '5.00004')
    """
    sides = value > bound, value < bound
    for digits in range(least, MOST_DIGITS):
        said = f"{value:.{digits}{form}}"
        if (float(said) > bound, float(said) < bound) == sides:
            return said
    return f"{value:.{MOST_DIGITS}g}"


def hertz(f_hz: float) -> str:
    """Return a frequency as a sentence says it: what a search leaves beside zero is zero.

    >>> hertz(8.158e-14), hertz(31.5712)
    ('0 Hz', '31.57 Hz')
    """
    return f"{f_hz if f_hz > AT_REST_HZ else 0.0:.4g} Hz"


def in_percent(share: float, digits: int = 0) -> str:
    """Return a share as a sentence writes it.

    >>> in_percent(0.104), in_percent(0.001, 1)
    ('10 %', '0.1 %')
    """
    return f"{100 * share:.{digits}f} %"


def loudness(reduction_db: float, digits: int = 1) -> str:
    """Return by how much something got quieter or louder: a sentence knows no attenuation below zero.

    >>> loudness(3.54), loudness(-3.54), loudness(0.04)
    ('quieter by 3.5 dB', 'louder by 3.5 dB', 'neither quieter nor louder')
    """
    size = rounded(abs(reduction_db), digits)
    if not float(size):
        return "neither quieter nor louder"
    return f"{'quieter' if reduction_db > 0 else 'louder'} by {size} dB"


def fall(reduction_db: float, digits: int = 1) -> str:
    """Return where a level went: a sentence knows no fall below zero.

    >>> fall(3.54), fall(-3.54), fall(-0.04)
    ('falls by 3.5 dB', 'rises by 3.5 dB', 'stays what it is')
    """
    size = rounded(abs(reduction_db), digits)
    if not float(size):
        return "stays what it is"
    return f"{'falls' if reduction_db > 0 else 'rises'} by {size} dB"


def opening(said: str) -> str:
    """Return words as they begin a sentence; a name that begins one is never passed here: it is written as it is.

    >>> opening("ok: The loop is stable."), opening("not white"), opening("")
    ('Ok: The loop is stable.', 'Not white', '')
    """
    return f"{said[:1].upper()}{said[1:]}"


def command(*words: object) -> str:
    """Return a command as a shell takes it: words with blanks or letters of other scripts are quoted.

    >>> command("ultraquiet", "campaign", Path("my rig.toml"), "--out", Path("-out"))
    "ultraquiet campaign 'my rig.toml' --out ./-out"
    """
    return shlex.join(f"./{w}" if isinstance(w, Path) and str(w).startswith("-") else str(w) for w in words)


def word(shown: object) -> str:
    """Return the word of an object's status, empty where it carries none."""
    return str(getattr(getattr(shown, "status", None), "word", ""))


def attributes(shown: object) -> Iterator[tuple[str, Any]]:
    """Yield the public attributes of an object, fields of a dataclass in their order; nothing is computed."""
    held: Any = shown
    named: list[str] = list(getattr(held, "_fields", getattr(held, "__dict__", {})))
    if is_dataclass(held):
        named = [f.name for f in fields(held) if f.repr]
    for name in named:
        if not name.startswith("_") and hasattr(held, name):
            yield name, getattr(held, name)


def is_plain(value: object) -> bool:
    """Return whether a value can be typed as it stands: a number, a text, and small collections of these."""
    if value is None or isinstance(value, bool | int | float | complex | str | Path | np.generic):
        return True
    if isinstance(value, tuple | list):
        return all(map(is_plain, cast("list[Any]", value)))
    if isinstance(value, Mapping):
        return all(map(is_plain, cast("Mapping[Any, Any]", value).values()))
    return is_dataclass(value) and not isinstance(value, type) and all(is_plain(v) for _, v in attributes(value))


def text(value: Any) -> str:
    """Return a value as it would be typed, long ones cut.

    >>> text(0.1 + 0.2), text("ab"), text((1.0, 2.0)), text(list(range(99)))
    ('0.3', "'ab'", '(1, 2)', '[0, 1, 2, 3, 4, 5, 6, 7, ...]')
    """
    if isinstance(value, Enum | str | Path):
        return repr(_cut(str(value)))
    if isinstance(value, float) or np.issubdtype(cast("type[Any]", type(value)), np.floating):
        return f"{float(value):.6g}"
    if isinstance(value, tuple | list | Mapping):
        return _collection(cast("tuple[Any, ...]", value))
    if isinstance(value, np.ndarray):
        return array(cast("np.ndarray[Any, Any]", value))
    return _cut(" ".join(repr(value).split()))


def _collection(value: "tuple[Any, ...] | list[Any] | Mapping[Any, Any]") -> str:
    entries = [str(each) if isinstance(value, Mapping) else text(each) for each in list(value)[:MOST_ENTRIES]]
    inner = ", ".join(entries + ["..."] * (len(value) > MOST_ENTRIES))
    if isinstance(value, tuple):
        return f"({inner},)" if len(value) == 1 else f"({inner})"
    return f"{{{inner}}}" if isinstance(value, Mapping) else f"[{inner}]"


def _cut(said: str) -> str:
    return said if len(said) <= WORDS else f"{said[: WORDS - 3]}..."


def array(values: "np.ndarray[Any, Any]") -> str:
    """Return a short array's numbers, a long one's shape."""
    if values.ndim <= 1 and values.size <= MOST_ENTRIES and values.dtype.kind in "fiub":
        return " ".join(f"{each:.4g}" for each in values.ravel().tolist())
    return f"({', '.join(map(str, values.shape))})"


def _fact(key: str, value: Any) -> str:
    """Return a field on a few characters; what other objects hold is left to them."""
    if value is None or isinstance(value, Mapping) or callable(value):
        return ""
    if isinstance(value, np.ndarray):
        return f"{key} {array(cast('np.ndarray[Any, Any]', value))}"
    if is_plain(value) and not is_dataclass(value):
        return "" if isinstance(value, str | tuple | list) and not value else f"{key}={text(value)}"
    return ""


def _is_default(field: "Field[Any]", given: Mapping[str, Any]) -> bool:
    """Return whether a field holds what it holds when nothing is said."""
    value = given[field.name]
    if field.default is not MISSING:
        return type(value) is type(field.default) and bool(value == field.default)
    if field.default_factory is not MISSING:
        return bool(value == field.default_factory())
    return False


def _bracketed(name: str, status: str, facts: list[str]) -> str:
    return _fitted(f"<{name} {status}: " if status else f"<{name}: ", facts, ">")


def _fitted(head: str, facts: list[str], tail: str) -> str:
    """Return as many facts as fit between head and tail; the first is cut rather than left out."""
    kept: list[str] = []
    for fact in facts:
        flat = " ".join(fact.split())
        if len(head) + len(", ".join([*kept, flat])) > LONGEST - 8:
            kept.append(f"{flat[: max(LONGEST - len(head) - 8, 0)]}..." if not kept else "...")
            break
        kept.append(flat)
    whole = f"{head}{', '.join(kept)}"
    return f"{whole.removesuffix(': ') if not kept else whole}{tail}"
