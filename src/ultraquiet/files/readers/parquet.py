"""Parquet tables in and out, by pyarrow."""

import io
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet.files.confined import announce
from ultraquiet.files.readers.extra import extra
from ultraquiet.files.table import RATE_NAMES, Column, FileTable
from ultraquiet.values import Record

UNITS = ("unit", "units")
FLOAT_BYTES = 8


def read_parquet(name: str, data: bytes) -> FileTable:
    """Return the numeric columns of a Parquet table.

    A column's metadata may say `unit`, the table's may say the rate (`rate_hz`, `fs`, ...); stamps of a calendar become
    seconds from the first. Missing values become NaN.
    """
    pq, pa = extra("pyarrow.parquet", "pyarrow", "Parquet"), extra("pyarrow", "pyarrow", "Parquet")
    # The system's allocator asks for what it needs; Arrow's own ones reserve address space by the gigabyte.
    pa.set_memory_pool(pa.system_memory_pool())
    file = pq.ParquetFile(pa.BufferReader(data))
    announce(name, file.metadata.num_rows * file.metadata.num_columns * FLOAT_BYTES, len(data))
    table = file.read(use_threads=False)
    columns = [_column(pa, table.schema.field(k), table.column(k)) for k in range(table.num_columns)]
    metadata = _texts(table.schema.metadata)
    rates = {key: float(metadata[key]) for key in RATE_NAMES if key in metadata}
    unusable = tuple(f"{label} ({kind})" for label, kind in columns if isinstance(kind, str))
    return FileTable(name, tuple(column for _, column in columns if isinstance(column, Column)), rates, unusable)


def write_parquet(record: Record) -> bytes:
    """Return a record as a table of float64; names, units, roles, limits and rate stand in its metadata."""
    pq, pa = extra("pyarrow.parquet", "pyarrow", "Parquet"), extra("pyarrow", "pyarrow", "Parquet")
    fields, arrays = [], []
    for role, channels, rows in (
        ("input", record.actuators, record.inputs),
        ("output", record.sensors, record.outputs),
    ):
        for k, (c, row) in enumerate(zip(channels, rows, strict=True)):
            metadata = {"name": c.name, "unit": c.unit, "role": role, "low": repr(c.low), "high": repr(c.high)}
            # Two columns of one name would leave other readers at a loss; the metadata keep the name as it is.
            twin = sum(c.name == other.name for other in (*record.actuators, *record.sensors)) > 1
            fields.append(pa.field(f"{role} {k + 1} {c.name}" if twin else c.name, pa.float64(), metadata=metadata))
            arrays.append(pa.array(row))
    memory = io.BytesIO()
    schema = pa.schema(fields, metadata={"rate_hz": repr(float(record.rate_hz))})
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), memory)
    return memory.getvalue()


def _texts(metadata: Any) -> dict[str, str]:
    return {key.decode(): value.decode() for key, value in (metadata or {}).items()}


def _column(pa: Any, field: Any, column: Any) -> tuple[str, Column | str]:
    metadata = _texts(field.metadata)
    name: str = metadata.get("name") or str(field.name)
    unit = next((metadata[key] for key in UNITS if key in metadata), "")
    if pa.types.is_timestamp(field.type):
        stamps, missing = _numbers(column.cast(pa.timestamp("ns")).cast(pa.int64()), np.int64)
        since = np.where(missing, nan, (stamps - stamps[0] if stamps.size and not missing[0] else stamps) / 1e9)
        return name, Column(name, since, "s")
    if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
        return name, str(field.type)
    values = _floats(pa, column)
    low, high = float(metadata.get("low", -inf)), float(metadata.get("high", inf))
    return name, Column(name, values, unit, role=metadata.get("role", ""), low=low, high=high)


def _floats(pa: Any, column: Any) -> FloatArray:
    """Return a column as float64, NaN for what is missing."""
    values, missing = _numbers(column.cast(pa.float64(), safe=False), np.float64)
    return np.where(missing, nan, values)


def _numbers(column: Any, kind: type[np.generic]) -> tuple[Any, NDArray[np.bool_]]:
    """Return a column's numbers `(n,)` and which of them are missing, out of its buffers.

    `to_numpy`, `fill_null` and every scalar that Arrow makes of a Python number import pandas where it is installed,
    and the process that reads can open nothing.
    """
    values, missing = [np.empty(0, kind)], [np.empty(0, bool)]
    for part in column.chunks:
        own = slice(part.offset, part.offset + len(part))
        held, numbers = part.buffers()
        if len(part):
            values.append(np.frombuffer(numbers, kind)[own])
            bits = None if held is None else np.unpackbits(np.frombuffer(held, np.uint8), bitorder="little")
            missing.append(np.zeros(len(part), bool) if bits is None else bits[own] == 0)
    return np.concatenate(values), np.concatenate(missing)
