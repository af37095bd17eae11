"""From chosen columns to a record: one length, one clock, one start, no gaps."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ultraquiet._base.constraints import positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.files.select import Picked
from ultraquiet.files.table import JITTER, Column, FileTable
from ultraquiet.values import Channel, Record


def assemble(
    table: FileTable,
    picked: Picked,
    rate_hz: float | None = None,
    crop_s: tuple[float, float] | None = None,
    parents: tuple[str, ...] = (),
    settings: Mapping[str, Any] | None = None,
) -> Record:
    """Return the columns as a record; the choice is kept in its provenance.

    Raises:
        InputError: unequal lengths, rates or starts, NaN, an empty cut; the message names the channels.
    """
    u, y = picked
    columns = (*u, *y)
    if len({c.values.size for c in columns}) != 1:
        lengths = ", ".join(f"{c.name} ({c.values.size})" for c in columns)
        raise InputError(f"read_record: the columns chosen from '{table.path}' differ in length: {lengths}.")
    rate = table.rate_hz(columns) if rate_hz is None else rate_hz
    # Checked here already: the cut and the starts are counted in samples.
    rate = positive("read_record", "rate_hz", rate, "Hz")
    # Stamps that a given rate overrides tell no start either.
    _together(table, columns, rate, [table.start_s(c) if rate_hz is None else c.start_s for c in columns])
    rows = _rows(table, columns[0].values.size, rate, crop_s)
    for c in columns:
        _sound(table, c, rows)
    choices = {"file": table.path, "inputs": [c.name for c in u], "outputs": [c.name for c in y], **(settings or {})}
    return Record(
        np.stack([c.values[rows] for c in u]),
        np.stack([c.values[rows] for c in y]),
        rate,
        [_channel(c) for c in u],
        [_channel(c) for c in y],
        Provenance("read_record", choices, parents=parents, versions=versions()),
    )


def _channel(c: Column) -> Channel:
    return Channel(c.name, c.unit, c.low, c.high)


def _together(table: FileTable, columns: Sequence[Column], rate_hz: float, starts: Sequence[float]) -> None:
    if (max(starts) - min(starts)) * rate_hz > JITTER:
        listing = ", ".join(f"{c.name} ({start:g} s)" for c, start in zip(columns, starts, strict=True))
        raise InputError(f"read_record: channels of '{table.path}' do not start together: {listing}; align them first.")


def _rows(table: FileTable, samples: int, rate_hz: float, crop_s: tuple[float, float] | None) -> slice:
    if crop_s is None:
        return slice(0, samples)
    first, last = (min(max(round(t * rate_hz), 0), samples) for t in crop_s)
    if first >= last:
        raise InputError(
            f"read_record: no sample of '{table.path}', {samples / rate_hz:g} s long, lies between "
            f"{crop_s[0]:g} and {crop_s[1]:g} s."
        )
    return slice(first, last)


def _sound(table: FileTable, c: Column, rows: slice) -> None:
    bad = np.flatnonzero(~np.isfinite(c.values[rows]))
    if bad.size:
        raise InputError(
            f"read_record: '{c.name}' of '{table.path}' has {bad.size} NaN or infinite values, the first at "
            f"{table.place_of(int(bad[0]) + rows.start)}; fill them, or leave them out with a mapping's crop_s."
        )
