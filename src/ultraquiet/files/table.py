"""A file of measurements as its reader found it: named columns and a few scalars, not yet told apart."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, StorageError

RATE_NAMES = ("rate_hz", "fs", "fs_hz", "sample_rate", "sampling_rate", "samplerate")
STEP_NAMES = ("dt", "ts", "sample_time")
TIME_NAMES = ("time", "t", "time_s", "t_s", "time_ms", "time_us", "zeit", "temps", "tiempo", "tempo", "tid", "tijd")
SPEAKING = {  # names that say themselves what a column is
    "input": re.compile(r"(inputs?|u)[\W_]*\d*", re.IGNORECASE),
    "output": re.compile(r"(outputs?|y)[\W_]*\d*", re.IGNORECASE),
}
TIME_UNITS_S = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
CLOCKS_AGREE = 1e-3  # two rates nearer than this share are one clock: crystals differ by less, rounded steps too
JITTER = 0.5  # in samples: a stamp further from an even clock than this belongs to its neighbour
# Behind a slash, as ISO 80000 heads a column, only what is surely a unit: `force / displacement` is a name. A unit of
# several is products of such and their quotients; only below a line is `s2` a power, `coil / A2` may count coils.
ONE_UNIT = r"(?:[numkMGµμ]?(?:V|A|N|Nm|g|s|m|Pa|T|W|Hz|rad|deg|bar)|cm|hPa|min|h|%|°|°C|K|dB|rpm|1)"
RAISED = rf"{ONE_UNIT}(?:\^-?\d|[²³]|⁻[¹²³])?"
PRODUCT, BELOW = (rf"{each}(?:[ ·*]{each})*" for each in (RAISED, rf"(?:{RAISED}|{ONE_UNIT}\d)"))
UNIT = re.compile(rf"{PRODUCT}(?:/(?:{BELOW}|\({BELOW}(?:/{BELOW})*\)))*")
MOST_SLASHES = 8  # that are looked behind, from the end
MOST_COLUMNS = 10_000  # the largest arrays of sensors have hundreds
MOST_DIGITS = 17  # that a float64 needs in decimal
NEIGHBOURS = 4  # floats to either side of a quotient of stamps, one of which is the rate that they were written by


@dataclass(frozen=True, eq=False)
class Column:
    """One channel as found: name, unit, samples, the variable of the file it is part of; and what else the file says.

    `role` is `input`, `output` or empty; `rate_hz` and `start_s` are the channel's own, where a file knows them.
    """

    name: str
    values: FloatArray
    unit: str = ""
    variable: str = ""
    role: str = ""
    rate_hz: float | None = None
    start_s: float = 0.0
    low: float = -float("inf")
    high: float = float("inf")


@dataclass(frozen=True, eq=False)
class FileTable:
    """All columns of a file, its scalars by name, and which of its variables are no columns, with shapes.

    A scalar's name is whole, `run1.fs`, its last field in lower case. A rate or a clock holds for the structure, or the
    group, that it stands in and for all within; one that stands beside them for all that have none of their own.
    `first_line` is the line of a text file on which its first sample stands, where each next one has the next line.
    """

    path: str
    columns: tuple[Column, ...]
    scalars: Mapping[str, float] = field(default_factory=dict)
    unusable: tuple[str, ...] = ()
    first_line: int | None = None

    @cached_property
    def clocks(self) -> Mapping[str, Column]:
        """The columns of time stamps that are named so, the first of each structure, by the structure's name."""
        named = [c for c in self.columns if not c.role and _last(c.name) in TIME_NAMES]
        return {c.variable.rpartition(".")[0]: c for c in reversed(named)}

    def is_clock(self, column: Column) -> bool:
        """Return whether a column is one of time stamps."""
        return any(column is clock for clock in self.clocks.values())

    @property
    def signals(self) -> tuple[Column, ...]:
        """All columns but time."""
        return tuple(c for c in self.columns if not self.is_clock(c))

    @property
    def unnamed_clock(self) -> Column | None:
        """The first column that rises evenly, where none is named time: a clock under a name of its own, or a ramp."""
        if self.clocks:
            return None
        return next((c for c in self.columns if not c.role and is_ramp(c.values)), None)

    def describe(self) -> str:
        """Return what the file holds, for a message: variables with their sizes."""
        sizes: dict[str, list[int]] = {}
        for c in self.columns:
            sizes.setdefault(c.variable or c.name, []).append(c.values.size)
        listing = [f"{name} ({n[0]}{f' x {len(n)}' if len(n) > 1 else ''})" for name, n in sizes.items()]
        sentence = "the variables " + ", ".join(listing) if listing else "no column of numbers"
        return sentence + (f" (no signals: {', '.join(self.unusable)})" if self.unusable else "")

    def rate_hz(self, columns: Sequence[Column] = ()) -> float:
        """Return the rate that the given columns state, or scalars beside them, or the one their time columns show.

        Raises:
            InputError: none is stated, two of them differ by half a sample over the record, a clock is not even.
        """
        shown: dict[int, float] = {}  # by each clock: many columns go by one
        rates = [self._rate_of(c, shown) for c in columns] or [self._rate_of(Column("", np.zeros(0)), shown)]
        longest = max((c.values.size for c in columns), default=0)
        if (max(rates) - min(rates)) * longest > JITTER * min(rates):
            listing = ", ".join(f"{c.name} ({rate:g} Hz)" for c, rate in zip(columns, rates, strict=True))
            raise InputError(
                f"read_record: channels of '{self.path}' differ in rate: {listing}; choose those of one rate."
            )
        return rates[0]

    def start_s(self, column: Column) -> float:
        """Return when a column's first sample was taken, on its own clock where its structure has one."""
        clock = self._clock_of(column)
        if column.start_s or column.rate_hz is not None or clock is None or not clock.values.size:
            return column.start_s
        return float(clock.values[0]) * TIME_UNITS_S.get(_unit_of(clock).lower(), 0.0)

    def _rate_of(self, column: Column, shown: dict[int, float]) -> float:
        """Return the rate of one column: its own, or what stands nearest to it in the file."""
        if column.rate_hz is not None:
            return float(column.rate_hz)
        around = _around(column)
        stated = next((rate for place in around if (rate := self._stated_at(place)) is not None), None)
        if stated is not None:
            return stated
        clock = self._clock_of(column)
        if clock is None:
            elsewhere = {name.rpartition(".")[0]: None for name in self.scalars}
            rates = {rate for place in elsewhere if (rate := self._stated_at(place)) is not None}
            if len(rates) == 1:
                return rates.pop()
            if rates or len(self.clocks) > 1:
                raise InputError(
                    f"read_record: '{self.path}' states several sampling rates, none of them beside '{column.name}'; "
                    f"give its own with --rate (rate_hz=)."
                )
            clock = next(iter(self.clocks.values()), None)
        if clock is None:
            raise self._no_rate()
        if id(clock) not in shown:
            shown[id(clock)] = self._shown_by(clock)
        return shown[id(clock)]

    def _stated_at(self, place: str) -> float | None:
        """Return the rate that a scalar of one structure states."""
        own = {name: self.scalars.get(f"{place}.{name}".lstrip(".")) for name in (*RATE_NAMES, *STEP_NAMES)}
        rate = next((own[name] for name in RATE_NAMES if own[name] is not None), None)
        step = next((step for name in STEP_NAMES if (step := own[name])), None)
        return rate_of_step(step) if rate is None and step is not None else rate

    def _clock_of(self, column: Column) -> Column | None:
        return next((self.clocks[place] for place in _around(column) if place in self.clocks), None)

    def _no_rate(self) -> InputError:
        even = self.unnamed_clock
        clock = "" if even is None else f", or name '{even.name}', which rises evenly, 'time' if it is the clock"
        return InputError(f"read_record: '{self.path}' states no sampling rate; give it with --rate (rate_hz=){clock}.")

    def _shown_by(self, clock: Column) -> float:
        missing = np.flatnonzero(np.isnan(clock.values))
        if missing.size:
            raise InputError(
                f"read_record: the time column of '{self.path}' has {missing.size} NaN, the first at "
                f"{self.place_of(int(missing[0]))}; fill them, or give --rate (rate_hz=)."
            )
        return clock_hz(self.path, clock)

    def place_of(self, sample: int) -> str:
        """Return where a sample stands, for a message: its number, and its line in a file of text."""
        if self.first_line is None:
            return f"sample {sample}"
        return f"sample {sample}, in line {self.first_line + sample} (an empty cell counts as NaN)"

    def agreed_hz(self, columns: Sequence[Column], given_hz: float) -> float:
        """Return a rate somebody gave, refused where it contradicts a clock that the file keeps itself."""
        try:
            own_hz = self.rate_hz(columns)
        except InputError:  # no clock of its own, or none to go by: then the rate is needed
            return given_hz
        if abs(given_hz - own_hz) > CLOCKS_AGREE * own_hz:
            raise InputError(
                f"read_record: '{self.path}' keeps a clock of {own_hz:g} Hz; a rate of {given_hz:g} Hz contradicts it. "
                f"Leave the rate away, or state it in a mapping if the file's clock is wrong."
            )
        return given_hz


def clock_hz(path: str, time: Column) -> float:
    """Return the rate of a column of time stamps, which may jitter by half a sample, or say where it is not even."""
    unit = _unit_of(time)
    if unit.lower() not in TIME_UNITS_S:
        raise InputError(f"read_record: '{path}' counts time in '{unit}', which is unknown; give --rate (rate_hz=).")
    t = time.values * TIME_UNITS_S[unit.lower()]
    if t.size < 2:
        raise InputError(f"read_record: '{path}' holds a single sample, which makes no record.")
    back = np.flatnonzero(~(np.diff(t) > 0))
    if back.size:
        raise InputError(
            f"read_record: '{path}' has a time column that does not rise, first at sample {back[0] + 1}; give "
            "--rate (rate_hz=) if the samples are in order all the same."
        )
    rate_hz = (t.size - 1) / float(t[-1] - t[0])
    steps = np.diff(t)
    # A lost sample is a long step; a slow drift shows against the clock of the whole record only.
    gap = np.abs(steps / np.median(steps) - 1.0) > JITTER
    drift = np.abs((t - t[0]) * rate_hz - np.arange(t.size)) > JITTER
    # Against the clock of a whole record with a gap nothing is even; the gap itself is what to name.
    uneven = gap if gap.any() else drift[1:]
    if uneven.any():
        k = int(np.argmax(uneven)) + 1
        raise InputError(
            f"read_record: '{path}' is not evenly sampled: sample {k} at {t[k]:g} s does not keep a clock of "
            f"{1.0 / np.median(steps):g} Hz; resample it, or give --rate (rate_hz=) if the stamps are wrong."
        )
    return _roundest_clock(t, rate_hz)


def _unit_of(time: Column) -> str:
    """Return the unit that a column of time stamps counts in, as its header or its name says."""
    return time.unit or time.name.rpartition(".")[2].partition("_")[2]


def _around(column: Column) -> list[str]:
    """Return the names of what a column stands in, from its own variable outwards to the file, which has none."""
    fields = column.variable.split(".") if column.variable else []
    return [".".join(fields[:k]) for k in range(len(fields), -1, -1)]


def _roundest_clock(t: FloatArray, rate_hz: float) -> float:
    """Return the number of fewest digits that explains rounded stamps as well as the quotient of first and last.

    One that gives the very stamps comes first: so a rate that was written as stamps comes back with all its bits.
    """
    k = np.arange(t.size)
    plain = [p for digits in range(1, MOST_DIGITS) if (p := float(f"{rate_hz:.{digits}g}")) > 0]
    beside = rate_hz + np.spacing(rate_hz) * np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    exact = next((hz for hz in (*plain, *beside.tolist()) if np.array_equal(k / hz, t)), None)
    if exact is not None:
        return exact
    error = np.abs(t - t[0] - k / rate_hz).max() + 4 * np.spacing(np.abs(t).max())
    return next((hz for hz in plain if np.abs(t - t[0] - k / hz).max() <= error), rate_hz)


def rate_of_step(step_s: float, printed: str = ".17g") -> float:
    """Return the rate of fewest digits whose period prints as the file gives it.

    >>> rate_of_step(2.85714e-04, ".5e"), rate_of_step(1 / 3500)
    (3500.0, 3500.0)
    """
    for digits in range(1, MOST_DIGITS):
        plain = float(f"{1.0 / step_s:.{digits}g}")
        if plain > 0 and format(1.0 / plain, printed) == format(step_s, printed):
            return plain
    return 1.0 / step_s


def _last(name: str) -> str:
    """Return the field of `structure.field`, in lower case."""
    return name.rpartition(".")[2].lower()


def split_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a column header.

    >>> split_unit("strut 1 [V]"), split_unit("load (rad/s)"), split_unit("y")
    (('strut 1', 'V'), ('load', 'rad/s'), ('y', ''))
    >>> split_unit("t / s"), split_unit("v / mm/s"), split_unit("force / displacement")
    (('t', 's'), ('v', 'mm/s'), ('force / displacement', ''))
    >>> split_unit("acc / (m/s^2)"), split_unit("gain [V/(m/s)]"), split_unit("force / (mean displacement)")
    (('acc', 'm/s^2'), ('gain', 'V/(m/s)'), ('force / (mean displacement)', ''))
    """
    header = header.strip()
    before, inside = _last_bracket(header)
    if before and not before.endswith("/"):
        return before, inside
    return _behind_a_slash(header, "/" if before else " / ") or (header, "")


def _behind_a_slash(header: str, slash: str) -> tuple[str, str] | None:
    """Return name and unit where a unit stands behind the first slash that one can stand behind."""
    parts = header.split(slash)
    tried = range(max(1, len(parts) - MOST_SLASHES), len(parts))
    cuts = ((slash.join(parts[:k]).strip(), unbracketed(slash.join(parts[k:]))) for k in tried)
    return next(((name, unit) for name, unit in cuts if name and UNIT.fullmatch(unit)), None)


def unbracketed(unit: str) -> str:
    """Return a unit without the brackets around the whole of it.

    >>> unbracketed("[m/s]"), unbracketed("V/(m/s)"), unbracketed("(V)/(A)"), unbracketed("[]")
    ('m/s', 'V/(m/s)', '(V)/(A)', '')
    """
    before, inside = _last_bracket(unit.strip())
    return inside if not before else unit.strip()


def _last_bracket(text: str) -> tuple[str, str]:
    """Return what stands before the bracket that ends a text, and in it; nothing and all of it where none does."""
    if not text.endswith(("]", ")")):
        return "", text
    depth = 0
    for k in range(len(text) - 1, -1, -1):
        depth += (text[k] in "])") - (text[k] in "[(")
        if depth == 0:
            return text[:k].strip(), text[k + 1 : -1].strip()
    return "", text


def from_arrays(path: str, arrays: Mapping[str, Any], texts: Mapping[str, Sequence[str]] | None = None) -> FileTable:
    """Return a table of the numeric arrays of a file; the longer side of a matrix is time.

    `texts` are the lists of words beside them: `u_names` and `u_units` name the columns of `u`.
    """
    columns: list[Column] = []
    scalars: dict[str, float] = {}
    unusable: list[str] = []
    for name, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            continue
        if array.ndim > 2 or array.size == 0:
            unusable.append(f"{name} of shape {array.shape}")
            continue
        if array.size == 1 and f"{name}_names" not in (texts or {}):
            structure, dot, _ = name.rpartition(".")
            scalars[f"{structure}{dot}{_last(name)}"] = float(array.reshape(-1)[0])
            continue
        columns.extend(_split(name, np.atleast_2d(array.astype(np.float64)), texts or {}))
    return FileTable(path, tuple(columns), scalars, tuple(unusable))


def _split(variable: str, array: FloatArray, texts: Mapping[str, Sequence[str]]) -> Sequence[Column]:
    names, units = texts.get(f"{variable}_names", ()), texts.get(f"{variable}_units", ())
    # Names say which side is channels (time goes down where both could be); without them the longer side is time.
    upright = array.shape[1] == len(names) if len(names) in array.shape else array.shape[0] > array.shape[1]
    rows = array.T if upright else array
    if len(names) != len(rows):
        names = [variable] if len(rows) == 1 else [f"{variable}:{k + 1}" for k in range(len(rows))]
    if len(units) != len(rows):
        units = [""] * len(rows)
    role = role_of(variable)
    return [Column(name, row, unit, variable, role) for name, row, unit in zip(names, rows, units, strict=True)]


def role_of(name: str) -> str:
    """Return `input` or `output` when the last field of a name says so (`u`, `run.inputs`, `Output 2`), or nothing."""
    bare = name.rpartition(".")[2]
    return next((role for role, pattern in SPEAKING.items() if pattern.fullmatch(bare)), "")


def is_ramp(values: FloatArray) -> bool:
    """Return whether numbers rise evenly: then they are time stamps without a name, not an excitation."""
    steps = np.diff(values)
    return bool(steps.size > 1 and np.all(steps > 0) and np.ptp(steps) <= 1e-3 * steps.mean())


def tree_of(table: FileTable) -> dict[str, Any]:
    """Return a table as plain data, for another process.

    Raises:
        StorageError: more columns than a record has.
    """
    if len(table.columns) > MOST_COLUMNS:
        raise StorageError(
            f"read_record: '{table.path}' holds {len(table.columns)} columns; up to {MOST_COLUMNS} are read."
        )
    names = [field.name for field in fields(Column)]
    texts = {"name", "unit", "variable"}
    rows = [{name: getattr(column, name) for name in names} for column in table.columns]
    return {
        "columns": [{key: _printable(v) if key in texts else v for key, v in row.items()} for row in rows],
        "scalars": dict(table.scalars),
        "unusable": [_printable(variable) for variable in table.unusable],
        "first_line": table.first_line,
    }


def _printable(text: Any) -> str:
    """Return a text without what commands a terminal, or no text can hold."""
    return "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(c) in ("Cc", "Cs") else c for c in str(text))


def table_of(name: str, tree: dict[str, Any]) -> FileTable:
    """Return the table that `tree_of` took apart."""
    columns = tuple(Column(**column) for column in tree["columns"])
    return FileTable(name, columns, tree["scalars"], tuple(tree["unusable"]), tree["first_line"])
