"""Cells of a table of text: which hold a number, and where the first stands that holds something else."""

import re
from collections.abc import Iterable, Sequence

# What spreadsheets write where a formula gives nothing (`#N/A`, `#DIV/0!`, `#NV`, `#WERT!`) is a cell, no remark.
SHEET_WORD = re.compile(r"#(?:N/[A-Z]|NV\b|[A-ZÄÖÜ]+(?:/0)?[!?])")
MISSING = {"na", "n/a", "n.a.", "nv", "k.a.", "null", "none", "nil", "missing", "-", "--", "?"}


def is_missing(cell: str) -> bool:
    """Return whether a cell says in words that there is no number.

    >>> [is_missing(cell) for cell in ("NA", "n/a", "#DIV/0!", "#NV", "force", "")]
    [True, True, True, True, False, False]
    """
    return cell.lower() in MISSING or SHEET_WORD.fullmatch(cell) is not None


def without_remark(line: str) -> str:
    """Return a line of numbers without the remark at its end.

    >>> without_remark("1,2 # touched"), without_remark("1,#N/A"), without_remark("#DIV/0!,2")
    ('1,2 ', '1,#N/A', '#DIV/0!,2')
    """
    if "#" not in line:
        return line
    at = line.find("#")
    while at >= 0 and SHEET_WORD.match(line, at):
        at = line.find("#", at + 1)
    return line if at < 0 else line[:at]


def first_fault(rows: Iterable[Sequence[str]], start: int, names: Sequence[str]) -> str | None:
    """Return what is wrong with the first line that makes no row of numbers, and what would do; None where all do.

    Args:
        rows: cells of each line, decimal points in place of decimal commas.
        start: how many lines of the file stand before them.
        names: of the columns.
    """
    count = 0
    for line, cells in enumerate(rows, start + 1):
        if not any(cells):
            continue
        count = count or len(cells)
        if len(cells) != count:
            return f"the number of columns changed from {count} to {len(cells)} in line {line}"
        for column, cell in enumerate(cells, 1):
            if cell and not is_number(cell):
                called = f" ('{names[column - 1]}')" if column <= len(names) else ""
                return (
                    f"'{cell[:40]}', which is no number, stands in line {line}, column {column}{called}; write a "
                    "number there, or leave the cell empty if the column is not used, or end the file before that line"
                )
    return None


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number, with a decimal point."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python's own way to part thousands
