"""Tables from text files (CSV, TSV, columns of numbers) and from NumPy's `.npz`."""

import csv
import io
import re
from collections.abc import Sequence

import numpy as np

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files.atomic import reason
from ultraquiet.files.table import Column, Table, from_arrays, split_unit

DELIMITERS = (";", "\t", ",")


def read_text(name: str, data: bytes) -> Table:
    """Return the columns of a text file; the line before the numbers names them, with units in brackets.

    Cells are parted by semicolons, tabs, commas or blanks; lines that begin with `#` are remarks, and the last of them
    before the numbers may be the header.
    """
    try:
        # Spreadsheets begin UTF-8 files with a byte-order mark.
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"read_record: '{name}' is no text file in UTF-8.") from None
    start = next((k for k, line in enumerate(lines) if _is_numbers(line)), None)
    if start is None:
        raise InputError(f"read_record: '{name}' holds no line of numbers.")
    delimiter = _delimiter(lines[start])
    try:
        rows = np.loadtxt(lines[start:], delimiter=delimiter, ndmin=2)
    except ValueError as error:
        raise InputError(f"read_record: '{name}', after line {start}: {reason(error)}.") from None
    header = _header(lines[:start], delimiter, rows.shape[1])
    return Table(name, tuple(Column(*_named(h, values)) for h, values in zip(header, rows.T, strict=True)))


def read_npz(name: str, data: bytes) -> Table:
    """Return the arrays of an `.npz` file; pickled objects are not opened."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            arrays = {key: held[key] for key in held.files if held[key].dtype.kind in "fiu"}
    except Exception as error:
        # Damaged bytes surface as whatever zipfile, zlib or NumPy stumble over first.
        raise StorageError(f"read_record: '{name}' cannot be read as .npz ({reason(error)}).") from error
    return from_arrays(name, arrays)


def _named(header: str, values: np.ndarray) -> tuple[str, np.ndarray, str]:
    name, unit = split_unit(header)
    return name, values, unit


def _is_numbers(line: str) -> bool:
    cells = [cell for cell in _cells(line, _delimiter(line)) if cell]
    try:
        return bool(cells) and all(float(cell) == float(cell) for cell in cells)
    except ValueError:
        return False


def _delimiter(line: str) -> str | None:
    # Columns padded with blanks or ending in a tab are parted by blanks of any length.
    marks = DELIMITERS if not re.fullmatch(r"[\s\d.eE+-]*", line) else ()
    return next((mark for mark in marks if mark in line.strip()), None)


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    # Only the csv module knows what a quoted name with a comma in it is.
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]


def _header(before: Sequence[str], delimiter: str | None, count: int) -> list[str]:
    for line in reversed([line for line in before if line.strip()]):
        cells = _cells(line.lstrip("# \t"), delimiter)
        if len(cells) == count and all(cells):
            return cells
        break
    return [f"column {k + 1}" for k in range(count)]
