"""A file of measurements as its reader found it: named columns and a few scalars, not yet told apart."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError

RATE_NAMES = ("rate_hz", "fs", "fs_hz", "sample_rate", "sampling_rate", "samplerate")
STEP_NAMES = ("dt", "ts", "sample_time")
TIME_NAMES = ("time", "t", "time_s", "t_s", "time_ms", "time_us")
TIME_UNITS_S = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
JITTER = 0.5  # in samples: a stamp further from an even clock than this belongs to its neighbour


@dataclass(frozen=True, eq=False)
class Column:
    """One channel as found: name, unit, samples, and the variable of the file it is part of."""

    name: str
    values: FloatArray
    unit: str = ""
    variable: str = ""


@dataclass(frozen=True, eq=False)
class Table:
    """All columns of a file, its scalars by lower-case name, and which of its variables are no columns, with shapes."""

    path: str
    columns: tuple[Column, ...]
    scalars: Mapping[str, float] = field(default_factory=dict)
    unusable: tuple[str, ...] = ()

    @property
    def time(self) -> Column | None:
        """The column of time stamps, when one is named so."""
        return next((c for c in self.columns if _last(c.name) in TIME_NAMES), None)

    @property
    def signals(self) -> tuple[Column, ...]:
        """All columns but time."""
        return tuple(c for c in self.columns if c is not self.time)

    def describe(self) -> str:
        """Return what the file holds, for a message: variables with their sizes."""
        sizes: dict[str, list[int]] = {}
        for c in self.columns:
            sizes.setdefault(c.variable or c.name, []).append(c.values.size)
        said = [f"{name} ({n[0]}{f' x {len(n)}' if len(n) > 1 else ''})" for name, n in sizes.items()]
        told = "the variables " + ", ".join(said) if said else "no column of numbers"
        return told + (f" (no signals: {', '.join(self.unusable)})" if self.unusable else "")

    def rate_hz(self) -> float:
        """Return the sampling rate a scalar states, or the one the time column shows."""
        for name in RATE_NAMES:
            if name in self.scalars:
                return self.scalars[name]
        for name in STEP_NAMES:
            if self.scalars.get(name):
                return 1.0 / self.scalars[name]
        if self.time is None:
            raise InputError(f"read_record: '{self.path}' states no sampling rate; give it with --rate (rate_hz=).")
        return _clock_hz(self.path, self.time)


def _clock_hz(path: str, time: Column) -> float:
    unit = time.unit or time.name.partition("_")[2]
    if unit.lower() not in TIME_UNITS_S:
        raise InputError(f"read_record: '{path}' counts time in '{unit}', which is unknown; give --rate (rate_hz=).")
    t = time.values * TIME_UNITS_S[unit.lower()]
    if t.size < 2 or not np.all(np.diff(t) > 0):
        raise InputError(f"read_record: '{path}' has a time column that does not rise; give --rate (rate_hz=).")
    rate_hz = (t.size - 1) / float(t[-1] - t[0])
    steps = np.diff(t)
    # A lost sample is a long step; a slow drift shows against the clock of the whole record only.
    gap = np.abs(steps / np.median(steps) - 1.0) > JITTER
    drift = np.abs((t - t[0]) * rate_hz - np.arange(t.size)) > JITTER
    uneven = gap | drift[1:]
    if uneven.any():
        k = int(np.argmax(uneven)) + 1
        raise InputError(
            f"read_record: '{path}' is not evenly sampled: sample {k} at {t[k]:g} s does not keep a clock of "
            f"{1.0 / np.median(steps):g} Hz; resample it, or give --rate (rate_hz=) if the stamps are wrong."
        )
    return rate_hz


def _last(name: str) -> str:
    """Return the field of `structure.field`, in lower case."""
    return name.rpartition(".")[2].lower()


def split_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a column header.

    >>> split_unit("strut 1 [V]"), split_unit("load (rad/s)"), split_unit("y")
    (('strut 1', 'V'), ('load', 'rad/s'), ('y', ''))
    """
    found = re.fullmatch(r"(.*\S)\s*[\[(]([^\[\]()]*)[\])]", header.strip())
    return (found[1], found[2].strip()) if found else (header.strip(), "")


def from_arrays(path: str, arrays: Mapping[str, Any]) -> Table:
    """Return a table of the numeric arrays of a file; the longer side of a matrix is time."""
    columns: list[Column] = []
    scalars: dict[str, float] = {}
    unusable: list[str] = []
    for name, held in arrays.items():
        array = np.asarray(held)
        if array.dtype.kind not in "fiu":
            continue
        if array.ndim > 2 or array.size == 0:
            unusable.append(f"{name} of shape {array.shape}")
            continue
        if array.size == 1:
            scalars[_last(name)] = float(array.reshape(-1)[0])
            continue
        columns.extend(_split(name, np.atleast_2d(array.astype(np.float64))))
    return Table(path, tuple(columns), scalars, tuple(unusable))


def _split(name: str, array: FloatArray) -> Sequence[Column]:
    rows = array.T if array.shape[0] > array.shape[1] else array
    if rows.shape[0] == 1:
        return [Column(name, rows[0], "", name)]
    return [Column(f"{name}:{k + 1}", row, "", name) for k, row in enumerate(rows)]
