"""Text columns (CSV, TSV, columns of numbers) in and out."""

import codecs
import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.files.atomic import reason
from ultraquiet.files.confined import announce
from ultraquiet.files.readers.cells import first_fault, is_missing, is_number, without_remark
from ultraquiet.files.table import MOST_COLUMNS, Column, FileTable, split_unit, unbracketed
from ultraquiet.values import Channel, Record

DELIMITERS = (";", "\t", ",")
LEAST_NUMBER = 4  # bytes of numbers that a byte of text becomes at most: a digit and its delimiter
UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
NO_TEXT = "is no text file in UTF-8; save it as text (CSV) in UTF-8"
NO_NUMBERS = (
    "holds no line of numbers; below the names every cell is a number or empty, and time is counted in seconds, not "
    "told by dates"
)
DECIMAL_COMMAS = "where its commas are decimal commas, part the columns by semicolons or tabs"
ROLES = {"u ": "input", "y ": "output"}  # how `write_text` marks its columns


def read_text(name: str, data: bytes) -> FileTable:
    """Return the columns of a text file; the line before the numbers names them, with units in brackets.

    Cells are parted by semicolons, tabs, commas or blanks; with semicolons or tabs a comma is a decimal comma. Units
    may stand in a line of their own below the names. An empty cell counts as NaN, a column may be without a name, and
    delimiters at the ends of lines make no column. Lines that begin with `#` are remarks, and the last of them before
    the numbers may be the header. A cell that is no number (`NA`, `#DIV/0!`, a word) is refused with its line and
    column.
    """
    try:
        data = data.decode("utf-16").encode() if data[:2] in UTF16 else data
        before = _before(data)
    except UnicodeDecodeError:
        raise InputError(f"read_record: '{name}' {NO_TEXT}.") from None
    if before is None:
        raise InputError(f"read_record: '{name}' {NO_NUMBERS}.")
    *before, first = before
    start, delimiter = len(before), _parted_by(before, first)
    if len(_cells(first, delimiter)) > MOST_COLUMNS:
        raise InputError(f"read_record: line {start + 1} of '{name}' has more than {MOST_COLUMNS} columns.")
    _no_row_among_names(name, before, delimiter, len(_cells(first, delimiter)))
    announce(name, LEAST_NUMBER * len(data), len(data))
    try:
        rows = _numbers(data, start, delimiter)
    except UnicodeDecodeError:
        raise InputError(f"read_record: '{name}' {NO_TEXT}.") from None
    except ValueError as error:
        raise InputError(f"read_record: '{name}': {_refusal(data, before, first, reason(error))}.") from None
    if _commas_are_decimal(before, first):
        raise InputError(f"read_record: '{name}' has more numbers a line than names; {DECIMAL_COMMAS}.")
    rows = rows[:, : _named_columns(before, delimiter, rows)]
    header = _header(before, delimiter, rows.shape[1])
    columns = [Column(called, values, unit) for (called, unit), values in zip(header, rows.T, strict=True)]
    unbroken = data.rstrip().count(b"\n") + 1 - start == len(rows)
    return FileTable(name, _with_roles(columns), first_line=start + 1 if unbroken else None)


def _refusal(data: bytes, before: Sequence[str], first: str, said: str) -> str:
    """Return what is wrong with a table: its first line that is no row of it, or what NumPy says, less its advice."""
    start, delimiter = len(before), _parted_by(before, first)
    said = f"after line {start}: {said.partition('; use `usecols`')[0]}"
    if _commas_are_decimal(before, first):
        return f"{said}; {DECIMAL_COMMAS}"
    rows = (_cells(line, delimiter) for line in _rows_of_numbers(data, start, delimiter))
    names = [called for called, _ in _header(before, delimiter, len(_cells(first, delimiter)))]
    return first_fault(rows, start, names) or said


def _no_row_among_names(name: str, before: Sequence[str], delimiter: str | None, count: int) -> None:
    """Refuse first rows that a cell keeps from being some, which would else be taken for names or units."""
    lines = [(k, _named(line, delimiter, count)) for k, line in enumerate(before) if line.strip() and line[0] != "#"]
    damaged: tuple[int, list[str]] | None = None
    for k, cells in reversed(lines):
        points = [cell.replace(",", ".") if delimiter in (";", "\t") else cell for cell in cells]
        if len(cells) != count:
            return
        if not any(map(is_number, points)):
            if damaged is not None:
                raise InputError(f"read_record: '{name}': {first_fault([damaged[1]], damaged[0], cells)}.")
            return
        damaged = k, points


def _commas_are_decimal(before: Sequence[str], first: str) -> bool:
    """Return whether a line of whole numbers between commas is longer than the names above it, at most twice."""
    named = [line for line in before if line.strip()][-1:]
    names = len(_cells(named[0].lstrip("# \t"), ",")) if named else 0
    return "." not in first and _delimiter(first) == "," and 2 <= names < len(_cells(first, ",")) <= 2 * names


def _named_columns(before: Sequence[str], delimiter: str | None, rows: FloatArray) -> int:
    """Return how many columns there are without one at the end that has neither a name nor a number."""
    last = next((line for line in reversed(before) if line.strip()), "")
    names, count = _cells(_bare(last, delimiter), delimiter), rows.shape[1]
    nameless = len(names) < count or not names[count - 1]
    return count - 1 if count > 1 and nameless and np.isnan(rows[:, -1]).all() else count


def write_text(record: Record) -> bytes:
    """Return time, inputs and outputs as CSV; every float keeps all its bits, names begin with `u ` or `y `."""
    if record.samples < 2:
        raise InputError("export_record: of a single sample no stamps tell the rate; write .h5, .mat or .uff.")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    # The marks tell roles on reading, and part an actuator from the sensor of the same name.
    marked = [(mark, c) for mark, cs in zip(ROLES, (record.actuators, record.sensors), strict=True) for c in cs]
    for _, c in marked:
        _writable(c)
    writer.writerow(["time [s]", *(f"{mark}{c.name} [{c.unit}]" for mark, c in marked)])
    columns = np.vstack([record.time_s, record.inputs, record.outputs]).T
    writer.writerows([[repr(v) for v in row] for row in columns.tolist()])
    return text.getvalue().encode()


def _writable(c: Channel) -> None:
    texts = (c.name, c.unit)
    broken = not c.name or any(len(t.splitlines()) > 1 or t != t.strip() for t in texts) or set(c.unit) & set("[]()")
    if broken or split_unit(f"{c.name} [{c.unit}]") != texts:
        raise InputError(
            f"export_record: the name {c.name!r} with unit {c.unit!r} cannot stand in a line of text; rename it, "
            "without line breaks, outer blanks, a slash at its end or brackets in the unit."
        )


def _with_roles(columns: Sequence[Column]) -> tuple[Column, ...]:
    signals = [c for c in columns if c.name.lower() not in ("time", "t")]
    if {c.name[:2] for c in signals} != set(ROLES):
        return tuple(columns)
    return tuple(
        replace(c, name=c.name[2:], role=ROLES[c.name[:2]]) if any(c is s for s in signals) else c for c in columns
    )


def _lines(data: bytes) -> Iterator[str]:
    """Return the lines one by one: all at once take twenty times the memory of the file."""
    # Spreadsheets begin UTF-8 files with a byte-order mark.
    return iter(io.TextIOWrapper(io.BytesIO(data), "utf-8-sig"))


def _before(data: bytes) -> list[str] | None:
    """Return the lines up to the first one of numbers, without their ends; None when there is none."""
    lines: list[str] = []
    for line in _lines(data):
        bare = without_remark(line.rstrip("\n"))
        if _is_numbers(bare):
            return [*lines, bare]
        lines.append(line.rstrip("\n"))
    return None


def _numbers(data: bytes, start: int, delimiter: str | None) -> FloatArray:
    def loaded(**how: Any) -> FloatArray:
        lines = _rows_of_numbers(data, start, delimiter)
        return np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None, quotechar='"', **how)

    try:
        return loaded()
    except ValueError:
        if delimiter is None or not any(_has_gap(line, delimiter) for line in _rows_of_numbers(data, start, delimiter)):
            raise
    # Slower, and needed only where cells are empty.
    return loaded(converters=lambda cell: float(cell.strip() or "nan"))


def _rows_of_numbers(data: bytes, start: int, delimiter: str | None) -> Iterator[str]:
    """Return the lines of numbers, empty where a remark stood, with points in place of decimal commas."""
    rest = (without_remark(line) for line in islice(_lines(data), start, None))
    return (line.replace(",", ".") for line in rest) if delimiter in (";", "\t") else rest


def _has_gap(line: str, delimiter: str) -> bool:
    return bool(line.strip()) and not all(cell.strip() for cell in line.split(delimiter))


def _is_numbers(line: str) -> bool:
    delimiter = _delimiter(line)
    cells = [cell for cell in _cells(line, delimiter) if cell and not is_missing(cell)]
    if delimiter in (";", "\t"):
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        return False
    # A row of nothing but `nan` may still be a header.
    return bool(np.isfinite(numbers).any())


def _delimiter(line: str) -> str | None:
    # Columns padded with blanks or ending in a tab are parted by blanks of any length.
    marks = DELIMITERS if not re.fullmatch(r"[\s\d.eE+-]*", line) else ()
    return next((mark for mark in marks if mark in line.strip()), None)


def _parted_by(before: Sequence[str], first: str) -> str | None:
    """Return what parts the cells of the first line of numbers: tabs also where the names above it are parted so.

    Of numbers alone, tabs may be the ends of padded columns as well, which part nothing by themselves.
    """
    delimiter, cells = _delimiter(first), first.split("\t")
    if delimiter is not None or len(cells) < 2 or any(len(cell.split()) > 1 for cell in cells):
        return delimiter
    names = _bare(next((line for line in reversed(before) if line.strip()), ""), "\t")
    return "\t" if len(names.split("\t")) == len(cells) else None


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    # Only the csv module knows what a quoted name with a comma in it is.
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]


def _header(before: Sequence[str], delimiter: str | None, count: int) -> list[tuple[str, str]]:
    """Return name and unit of each column, from the one or two lines above the numbers."""
    rows = [_named(_bare(line, delimiter), delimiter, count) for line in before if line.strip()][-2:]
    names = rows[-1] if rows else []
    if len(rows) == 2 and len(rows[0]) == len(rows[1]) == count and all(rows[0]) and _are_units(rows):
        return [(name, unbracketed(unit)) for name, unit in zip(*rows, strict=True)]
    # One or two columns may go without a name; a line of few cells is a title.
    if len(names) != count or 2 * sum(map(bool, names)) < count:
        names = [""] * count
    return [split_unit(name) if name else (f"column {k}", "") for k, name in enumerate(names, 1)]


def _bare(line: str, delimiter: str | None) -> str:
    """Return a line of names without the mark of a remark; between tabs the first may be missing."""
    return line.lstrip("# " if delimiter == "\t" else "# \t")


def _named(line: str, delimiter: str | None, count: int) -> list[str]:
    """Return the cells of a line of names, which may be parted otherwise than the numbers below it."""
    cells = _cells(line, delimiter)
    while len(cells) > count and not cells[-1]:
        cells.pop()
    ways = (cells, *(re.split(mark, line.strip()) for mark in (r"\t", r"\s{2,}")))
    return next((way for way in ways if len(way) == count), cells)


def _are_units(rows: Sequence[Sequence[str]]) -> bool:
    # Names differ from each other and stand bare, without units of their own; units are short or absent.
    names, units = rows
    bare = len(set(names)) == len(names) and not any(split_unit(name)[1] for name in names)
    return bare and not any(map(is_number, names)) and all(len(unit) <= 12 for unit in units)
