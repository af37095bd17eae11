"""SEP-005 dictionaries, the time series of the SDyPy packages: a value in memory, not a file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.files.assemble import assemble
from ultraquiet.files.select import Choice, inputs_and_outputs
from ultraquiet.files.table import Column, FileTable, clock_hz
from ultraquiet.values import Record


def from_sep005(
    signals: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    inputs: Choice = None,
    outputs: Choice = None,
    rate_hz: float | None = None,
) -> Record:
    """Return SEP-005 dictionaries as a record.

    Args:
        signals: dictionaries with `data` `(n,)`, `name`, `unit_str`, and `fs` or `time` `(n,)`.
        inputs: the names that go in; not needed where `role` says it, as `to_sep005` does.
        outputs: the names that come out.
        rate_hz: samples per second, over what the dictionaries say.

    Raises:
        InputError: a field is missing, or lengths, rates or stamps do not go together; the message names the channel.

    >>> back = from_sep005(to_sep005(Record([[1.0, 0.0]], [[0.1, 0.3]], 3500.0, ["force"], ["speed"])))
    >>> back.rate_hz, back.actuators[0].name, back.outputs
    (3500.0, 'force', array([[0.1, 0.3]]))

    Reference: SDyPy Enhancement Proposal 5, "SDyPy Unified timeseries".
    """
    dictionaries = [signals] if isinstance(signals, Mapping) else list(signals)
    table = FileTable(
        "SEP-005", tuple(column for k, signal in enumerate(dictionaries) for column in _columns(k, signal))
    )
    return assemble(table, inputs_and_outputs(table, inputs, outputs), rate_hz)


def to_sep005(record: Record) -> list[dict[str, Any]]:
    """Return a record as SEP-005 dictionaries, one a channel; `role`, `low` and `high` are fields of our own.

    SEP-005 wants names that differ: an actuator and a sensor of one name get ` (input)` and ` (output)` behind it.
    """
    twins = {c.name for c in record.actuators} & {c.name for c in record.sensors}
    return [
        {
            "data": row,
            "name": f"{c.name} ({role})" if c.name in twins else c.name,
            "fs": record.rate_hz,
            "unit_str": c.unit,
            "role": role,
            "low": c.low,
            "high": c.high,
        }
        for role, channels, rows in (
            ("input", record.actuators, record.inputs),
            ("output", record.sensors, record.outputs),
        )
        for c, row in zip(channels, rows, strict=True)
    ]


def _columns(k: int, signal: Mapping[str, Any]) -> list[Column]:
    missing = [key for key in ("data", "name", "unit_str") if key not in signal]
    if missing or ("fs" not in signal and "time" not in signal):
        lacks = ", ".join(missing) or "fs or time"
        raise InputError(f"from_sep005: signal {k + 1} ('{signal.get('name', '')}') lacks {lacks}.")
    name, role = str(signal["name"]), str(signal.get("role", ""))
    rows = np.atleast_2d(np.asarray(signal["data"], dtype=np.float64))
    if rows.ndim != 2:
        raise InputError(f"from_sep005: '{name}' has data of shape {rows.shape}; it would take (n,) or (channels, n).")
    rate_hz, start_s = (float(signal["fs"]), 0.0) if "fs" in signal else _clock(name, signal["time"], rows.shape[1])
    limits = {key: float(signal[key]) for key in ("low", "high") if key in signal}
    bare = name.removesuffix(f" ({role})") if role else name
    return [
        Column(
            bare if len(rows) == 1 else f"{bare}:{i + 1}",
            row,
            str(signal["unit_str"] or ""),
            name,
            role,
            rate_hz,
            start_s,
            **limits,
        )
        for i, row in enumerate(rows)
    ]


def _clock(name: str, time: Any, samples: int) -> tuple[float, float]:
    """Return the rate that stamps show, and the first of them, seconds."""
    stamps = np.asarray(time, dtype=np.float64)
    if stamps.shape != (samples,):
        raise InputError(f"from_sep005: '{name}' has {samples} samples but time of shape {stamps.shape}.")
    return clock_hz(name, Column("time", stamps, "s")), float(stamps[0])
