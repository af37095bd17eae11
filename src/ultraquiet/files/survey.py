"""A look at a file before anything is made of it: channels, clock, levels, clipping and gaps."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError
from ultraquiet.files.formats import format_of
from ultraquiet.files.read import read_table
from ultraquiet.files.sizes import sized
from ultraquiet.files.table import TIME_UNITS_S, Column, FileTable, clock_hz

FLAT_TOP = 3  # equal samples in a row, at the highest or lowest value, that count as clipped where no limits are known


@dataclass(frozen=True)
class Look:
    """One channel: `clipped` counts samples at its limits, or in flat tops where none are known; `missing` NaN."""

    name: str
    unit: str
    role: str
    samples: int
    rate_hz: float | None
    mean: float
    rms: float
    peak: float
    clipped: int
    missing: int


@dataclass(frozen=True)
class Survey:
    """What a file holds; `notes` are sentences on what would stand in the way of reading it as a record.

    Where the file states no rate and a column rises evenly, `clock` is the name of that column and `clock_hz` the rate
    that it shows if it counts seconds, or what its unit says.
    """

    path: str
    format: str
    size_bytes: int
    rate_hz: float | None
    duration_s: float | None
    channels: tuple[Look, ...]
    notes: tuple[str, ...]
    clock: str = ""
    clock_hz: float | None = None

    @property
    def size(self) -> str:
        """The size of the file in words."""
        return sized(self.size_bytes)


def survey(path: str | os.PathLike[str], rate_hz: float | None = None, *, keep_clock: bool = False) -> Survey:
    r"""Look a file over without choosing inputs and outputs.

    Args:
        path: any file that `read_record` reads.
        rate_hz: samples per second, when the file does not say.
        keep_clock: refuse a `rate_hz` that contradicts the clock of the file.

    Raises:
        StorageError, InputError, ToolError: as in `read_record`, when the file cannot be read at all.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "run.csv"
    ...     size = path.write_text("time [s],force [N],speed [m/s]\n0,1,0\n0.5,-1,2\n1,1,nan\n")
    ...     result = survey(path)
    >>> result.rate_hz, result.duration_s, [(c.name, c.unit, c.rms, c.missing) for c in result.channels]
    (2.0, 1.5, [('force', 'N', 1.0, 0), ('speed', 'm/s', 1.4142135623730951, 1)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "run.csv"
    ...     size = path.write_text("Uhr,force [N],speed [m/s]\n0,1,0\n0.5,-1,2\n1,1,1\n")
    ...     result = survey(path)
    >>> result.rate_hz, result.clock, result.clock_hz
    (None, 'Uhr', 2.0)
    """
    table = read_table(path)
    notes: list[str] = []
    looks = tuple(_look(c) for c in table.signals)
    if rate_hz is None:
        rate = _noted(notes, lambda: table.rate_hz(table.signals))
    else:
        given_hz = positive("survey", "rate_hz", rate_hz, "Hz")
        rate = table.agreed_hz(table.signals, given_hz) if keep_clock else given_hz
    lengths = {c.samples for c in looks}
    if len(lengths) > 1:
        notes.append(f"the channels differ in length: {', '.join(f'{c.name} ({c.samples})' for c in looks)}.")
    if not looks:
        notes.append(f"no signal; it holds {table.describe()}.")
    notes.extend(f"'{c.name}' has {c.missing} NaN or infinite values." for c in looks if c.missing)
    notes.extend(f"'{variable}' is no signal." for variable in table.unusable)
    duration_s = max(lengths) / rate if rate and lengths else None
    size = Path(path).stat().st_size
    form = format_of("survey", Path(path)).name
    looked = _with_rate(table, looks, rate)
    return Survey(str(path), form, size, rate, duration_s, looked, tuple(notes), *_unnamed_clock(table, rate))


def _unnamed_clock(table: FileTable, rate_hz: float | None) -> tuple[str, float | None]:
    """Return the name of the column that is likely the clock of a file without a rate, and the rate it shows."""
    column = table.unnamed_clock if rate_hz is None else None
    if column is None:
        return "", None
    unit = column.unit if column.unit.lower() in TIME_UNITS_S else "s"
    try:
        return column.name, clock_hz(table.path, replace(column, unit=unit))
    except InputError:  # it drifts too far to be one
        return "", None


def _noted(notes: list[str], ask: Callable[[], float]) -> float | None:
    try:
        return ask()
    except InputError as error:
        notes.append(str(error).removeprefix("read_record: "))
        return None


def _with_rate(table: FileTable, looks: tuple[Look, ...], rate_hz: float | None) -> tuple[Look, ...]:
    own = [c.rate_hz or rate_hz or _noted([], lambda c=c: table.rate_hz([c])) for c in table.signals]
    return tuple(replace(look, rate_hz=mine) for look, mine in zip(looks, own, strict=True))


def _look(c: Column) -> Look:
    sound = c.values[np.isfinite(c.values)]
    missing = c.values.size - sound.size
    with np.errstate(over="ignore"):  # the rms of absurd numbers is infinite, which says it
        rms = float(np.sqrt(np.mean(sound**2))) if sound.size else np.nan
    if not sound.size:
        return Look(c.name, c.unit, c.role, c.values.size, c.rate_hz, np.nan, np.nan, np.nan, 0, missing)
    return Look(
        c.name,
        c.unit,
        c.role,
        c.values.size,
        c.rate_hz,
        float(sound.mean()),
        rms,
        float(np.abs(sound).max()),
        _clipped(c, sound),
        missing,
    )


def _clipped(c: Column, sound: FloatArray) -> int:
    if np.isfinite(c.low) or np.isfinite(c.high):
        return int(np.count_nonzero((sound <= c.low) | (sound >= c.high)))
    low, high = sound.min(), sound.max()
    # A constant channel is silent, not clipped.
    return 0 if low == high else sum(_flat(sound == extreme) for extreme in (low, high))


def _flat(at: np.ndarray) -> int:
    """Return how many of the samples marked stand in runs of `FLAT_TOP` and more."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], at, [False])).astype(np.int8)))
    runs = edges[1::2] - edges[::2]
    return int(runs[runs >= FLAT_TOP].sum())
