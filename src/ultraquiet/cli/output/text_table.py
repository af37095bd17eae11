"""A table as text: whole at any width, without a character that a pipe or a narrow terminal would spoil."""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field

GAPS = ("  ", " ")  # between columns; the narrow one where the wide one leaves no room
LEAST = 14  # columns of words may be folded down to so many characters
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?( ?%| \S+)?|-|inf|nan|", re.IGNORECASE)
INDENT = 4  # of what continues a line


@dataclass
class TextTable:
    r"""Rows of words under heads.

    >>> grid = TextTable(("channel", "gain"), title="two")
    >>> grid.add("strut [1]", "3.2 dB")
    >>> print("\n".join(grid.lines()))
    two
    channel      gain
    strut [1]  3.2 dB
    >>> print("\n".join(grid.lines(width=12)))
    two
    channel:
        strut
        [1]
    gain: 3.2 dB
    """

    heads: Sequence[str]
    title: str = ""
    rows: list[tuple[str, ...]] = field(default_factory=list)

    def add(self, *cells: object) -> None:
        """Add one row, a cell for each head."""
        self.rows.append(tuple(map(str, cells)))

    def lines(self, width: int | None = None) -> list[str]:
        """Return the table as lines: one a row where there is room for it, else folded, else one a cell.

        Args:
            width: characters of a line; without it every row is one line, whatever its length.
        """
        title = [self.title] if width is None else _wrapped(self.title, width)
        if width is None:
            rows = [tuple("; ".join(filter(None, cell.split("\n"))) for cell in row) for row in self.rows]
            return [*filter(None, title), *_table(self.heads, rows, self._widths(rows), GAPS[0])]
        widths = self._widths(self.rows)
        gap = next((gap for gap in GAPS if sum(widths) + len(gap) * (len(widths) - 1) <= width), GAPS[-1])
        short = _squeezed(widths, [self._holds_words(k) for k in range(len(widths))], width, gap)
        body = _blocks(self.heads, self.rows, width) if short is None else _table(self.heads, self.rows, short, gap)
        return [*filter(None, title), *body]

    def records(self) -> list[dict[str, str]]:
        """Return every row by its heads."""
        return [dict(zip(self.heads, row, strict=True)) for row in self.rows]

    def _widths(self, rows: Sequence[tuple[str, ...]]) -> list[int]:
        columns = zip(self.heads, *rows, strict=True)
        return [max(len(line) for cell in column for line in cell.split("\n")) for column in columns]

    def _holds_words(self, column: int) -> bool:
        return not _numbers(self.rows, column)


def _numbers(rows: Sequence[tuple[str, ...]], column: int) -> bool:
    return bool(rows) and all(NUMBER.fullmatch(row[column]) for row in rows)


def _squeezed(widths: list[int], words: list[bool], width: int, gap: str) -> list[int] | None:
    """Return widths that fit, taken from the widest columns of words; None where they cannot."""
    widths = list(widths)
    room = width - len(gap) * (len(widths) - 1)
    while sum(widths) > room:
        wide = [k for k, fold in enumerate(words) if fold and widths[k] > LEAST]
        if not wide:
            return None
        widths[max(wide, key=lambda k: widths[k])] -= 1
    return widths


def _table(heads: Sequence[str], rows: Sequence[tuple[str, ...]], widths: Sequence[int], gap: str) -> list[str]:
    right = [_numbers(rows, k) for k in range(len(widths))]
    lines: list[str] = []
    for row in (tuple(heads), *rows):
        cells = [_wrapped(cell, size) for cell, size in zip(row, widths, strict=True)]
        for k in range(max(map(len, cells))):
            parts = [cell[k] if k < len(cell) else "" for cell in cells]
            placed = (p.rjust(w) if r else p.ljust(w) for p, w, r in zip(parts, widths, right, strict=True))
            lines.append(gap.join(placed).rstrip())
    return lines


def _blocks(heads: Sequence[str], rows: Sequence[tuple[str, ...]], width: int) -> list[str]:
    lines: list[str] = []
    for row in rows:
        for head, cell in zip(heads, row, strict=True):
            told = f"{head}: {cell}" if head else cell
            if len(told) <= width and "\n" not in told:
                lines.append(told)
            else:
                lines.append(f"{head}:")
                lines.extend(" " * INDENT + part for part in _wrapped(cell, max(width - INDENT, 1)))
        lines.append("")
    return lines[:-1]


def _wrapped(text: str, width: int) -> list[str]:
    return [part for line in text.split("\n") for part in textwrap.wrap(line, max(width, 1)) or [""]]
