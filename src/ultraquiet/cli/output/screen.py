"""Where results go: words and tables for a reader, JSON for a program, nothing where silence was asked for."""

import dataclasses
import json
import math
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass
from enum import Enum
from typing import Any, TextIO
from unicodedata import category

import numpy as np

from ultraquiet.cli.output.text_table import TextTable

UNPRINTED = ("Cc", "Cf", "Cs")  # control, direction and other marks without a shape, halves of characters


@dataclass(frozen=True)
class Screen:
    """What a command prints on: `as_json` one JSON value and nothing else, `quiet` no words, no tables, no progress."""

    as_json: bool = False
    quiet: bool = False

    @property
    def silent(self) -> bool:
        """Whether words and tables are left away."""
        return self.as_json or self.quiet

    def say(self, *words: object) -> None:
        """Print one line after another, as they are."""
        if not self.silent:
            _write("".join(f"{word}\n" for word in words))

    def table(self, grid: TextTable) -> None:
        """Print a table: to the width of a terminal, or that `COLUMNS` asks for; else in whole lines."""
        known = sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()
        self.say(*grid.lines(shutil.get_terminal_size().columns if known else None))

    def result(self, facts: Any) -> None:
        """Print what was found as JSON, where that was asked for."""
        if self.as_json:
            _write(json.dumps(plain(facts), indent=1, allow_nan=False) + "\n")


def harmless(text: str) -> str:
    r"""Return a text whose names and quotations, which came out of files, command no terminal.

    >>> harmless("a\x1b[2J")
    'a\ufffd[2J'
    """
    if text.isascii() and text.replace("\n", "").isprintable():
        return text
    return "".join(c if c in "\n\t" or category(c) not in UNPRINTED else "\N{REPLACEMENT CHARACTER}" for c in text)


def _write(text: str) -> None:
    """Write what the terminal's characters allow; a square or a degree it does not know becomes a question mark."""
    text, out = harmless(text), _out.get() or sys.stdout
    try:
        out.write(text)
    except UnicodeEncodeError:
        known = out.encoding or "ascii"
        out.write(text.encode(known, "replace").decode(known))


PLAIN = Screen()
_screen: ContextVar[Screen] = ContextVar("screen", default=PLAIN)
_out: ContextVar[TextIO | None] = ContextVar("out", default=None)  # where results go while others' prints go aside


def screen() -> Screen:
    """Return the screen of the command that runs."""
    return _screen.get()


@contextmanager
def showing(on: Screen) -> Iterator[None]:
    """Let everything inside the block print on this screen; what a bench's own code prints never joins the JSON."""
    before, out = _screen.set(on), _out.set(sys.stdout)
    try:
        with redirect_stdout(sys.stderr if on.silent else sys.stdout):
            yield
    finally:
        _screen.reset(before)
        _out.reset(out)


def plain(value: Any) -> Any:
    """Return a value as JSON knows it; what is not finite becomes null, as JSON has no word for it.

    >>> plain({"peak_db": np.float64(3.0), "delay_s": np.array([0.1, np.inf])})
    {'peak_db': 3.0, 'delay_s': [0.1, None]}
    """
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or (isinstance(value, bool | int | str) and not isinstance(value, Enum)):
        return value
    return _plain_container(value)


def _plain_container(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set):
        return [plain(each) for each in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    return plain(value.value) if isinstance(value, Enum) else str(value)
