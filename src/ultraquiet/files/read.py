"""One door for records from outside: the suffix decides who reads."""

import hashlib
import os
from pathlib import Path

from ultraquiet._base.constraints import positive
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet.files.archive import is_archive, load_many
from ultraquiet.files.assemble import assemble
from ultraquiet.files.formats import ARCHIVES, FORMATS, format_of, understood
from ultraquiet.files.mapping import Mapping, load_mapping
from ultraquiet.files.readers.hdf5 import is_ours
from ultraquiet.files.select import Choice, Picked, chosen, inputs_and_outputs
from ultraquiet.files.table import Column, FileTable, table_of, tree_of
from ultraquiet.files.whole import whole
from ultraquiet.values import Record

_Path = str | os.PathLike[str]


def read_record(
    path: _Path,
    rate_hz: float | None = None,
    inputs: Choice = None,
    outputs: Choice = None,
    mapping: _Path | Mapping | None = None,
    *,
    keep_clock: bool = False,
) -> Record:
    r"""Read a record from a file of any format in `ultraquiet.files.formats`.

    What goes in and what comes out is taken, in this order, from the mapping; from `inputs` and `outputs`; from what
    the file says; from names that say so (`u`, `y`, `inputs`, `output 2`, ...); from the order, when one table has just
    two columns. The rate is taken from `rate_hz`; from the mapping; from the file; from a scalar called `fs`, `dt`,
    ...; from a column called `time` or `t` (seconds unless its unit says otherwise). Stamps may jitter by half a sample
    about an even clock; more is refused. Names and units stay as the file has them.

    Args:
        path: a file with one of the suffixes in `formats.FORMATS`: an archive, datasets of another program, text, ...
        rate_hz: samples per second, when the file does not say; it overrides what the file says.
        inputs: columns by name (`"iq_refx"`, `"motor,load"`, a list) or counted from one (`"1-2"`, `"data:3-30"`).
        outputs: likewise.
        mapping: a TOML file, or what `load_mapping` returns: columns, names, units, scales, limits, rate and cut.
        keep_clock: refuse a `rate_hz` that contradicts the rate that the file or the mapping states, or the clock that
            the file keeps; a mapping may still correct the file.

    Raises:
        StorageError: the file is missing, empty, cut short, damaged, or too large for the memory.
        InputError: unknown suffix, no rate, uneven time, NaN, channels of unequal length or rate, mistakes in the
            mapping, or no telling what goes in and what comes out; the message says what the file holds.
        ToolError: the format needs a package that is not installed; the message says how to install it.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "run.csv"
    ...     size = path.write_text("time [s], force [N], strut 1 [V], strut 2 [V]\n0,1,0,0\n0.5,0,2,3\n")
    ...     record = read_record(path, inputs="force", outputs="strut 1, strut 2")
    >>> record.rate_hz, record.sensors[1].name, record.sensors[1].unit, record.outputs.tolist()
    (2.0, 'strut 2', 'V', [[0.0, 2.0], [0.0, 3.0]])
    """
    table, archived, parents = _opened(path)
    rate_hz = None if rate_hz is None else positive("read_record", "rate_hz", rate_hz, "Hz")
    if mapping is not None:
        if inputs is not None or outputs is not None:
            raise InputError("read_record: a mapping says what goes in and out; leave inputs and outputs to it.")
        known = mapping if isinstance(mapping, Mapping) else load_mapping(mapping)
        if keep_clock and rate_hz is not None and known.rate_hz not in (None, rate_hz):
            raise InputError(
                f"read_record: the mapping says {known.rate_hz:g} Hz, which a rate of {rate_hz:g} Hz contradicts; "
                f"leave one of them away."
            )
    else:
        known = None
    if archived is not None and rate_hz not in (None, archived.rate_hz):
        raise InputError(
            f"read_record: '{path}' was recorded at {archived.rate_hz:g} Hz; it cannot be read at {rate_hz:g} Hz."
        )
    if known is not None:
        picked = known.pick(table)
        if keep_clock and known.rate_hz is None:
            rate_hz = _agreed(table, picked, rate_hz)
        rate_hz = known.rate_hz if rate_hz is None else rate_hz
        return assemble(table, picked, rate_hz, known.crop_s, parents, {"mapping": known.text})
    if archived is not None:
        return archived.pick(
            *(_places(table, role, picked) for role, picked in (("input", inputs), ("output", outputs)))
        )
    picked = inputs_and_outputs(table, inputs, outputs)
    return assemble(table, picked, _agreed(table, picked, rate_hz) if keep_clock else rate_hz, parents=parents)


def _agreed(table: FileTable, picked: Picked, rate_hz: float | None) -> float | None:
    if rate_hz is None:
        return None
    return table.agreed_hz((*picked[0], *picked[1]), rate_hz)


def read_table(path: _Path) -> FileTable:
    """Return all columns of a file as they are, before anything is chosen; errors as in `read_record`."""
    return _opened(path)[0]


def refuse_data(who: str, path: _Path, wanted: str) -> None:
    """Refuse a file of measurements, or of models, where a text is wanted that somebody wrote.

    Args:
        who: opens the sentence.
        path: the file; one that is no data, or is not there, is left to its reader.
        wanted: what it should be.

    Raises:
        InputError: it is data; the message says which command takes it.
    """
    place = Path(path)
    if place.suffix.lower() not in (suffix for form in FORMATS for suffix in form.suffixes) or not place.is_file():
        return
    try:
        values = load_many(place).values() if is_archive(place) else ()
        kinds = sorted({type(value).__name__ for value in values if not isinstance(value, Record)})
        if not kinds and not read_table(place).columns:
            return
    except UltraquietError:
        return
    if kinds:
        raise InputError(
            f"{who}: '{path}' holds a {' and a '.join(kinds)}, where {wanted} is wanted; `ultraquiet design` takes a "
            "plant, `ultraquiet deploy` a law."
        )
    raise InputError(
        f"{who}: '{path}' is a record of measurements, where {wanted} is wanted; `ultraquiet identify` makes a model "
        "of it, `ultraquiet inspect` says what it holds, and a study names it under [records] as 'files'."
    )


def _opened(path: _Path) -> tuple[FileTable, Record | None, tuple[str, ...]]:
    """Return a file's table, the record when it is an archive, and the hash of where it comes from."""
    form = format_of("read_record", Path(path))
    data = whole(path)
    if Path(path).suffix.lower() in ARCHIVES and is_ours(data):
        record = _archived(path)
        return _as_table(Path(path).name, record), record, (record.hash,)
    name = Path(path).name
    tree = understood(form, name, lambda: tree_of(form.read(name, data)), len(data))
    return table_of(name, tree), None, (hashlib.sha256(data).hexdigest(),)


def _archived(path: _Path) -> Record:
    records = {name: value for name, value in load_many(path).items() if isinstance(value, Record)}
    if len(records) != 1:
        listing = f"{len(records)} records ({', '.join(records)})" if records else "no record"
        raise InputError(f"read_record: '{path}' holds {listing}; it would take a file with one record.")
    (record,) = records.values()
    return record


def _as_table(name: str, record: Record) -> FileTable:
    return FileTable(
        name,
        tuple(
            Column(c.name, row, c.unit, "", role, record.rate_hz, 0.0, c.low, c.high)
            for role, channels, rows in (
                ("input", record.actuators, record.inputs),
                ("output", record.sensors, record.outputs),
            )
            for c, row in zip(channels, rows, strict=True)
        ),
    )


def _places(table: FileTable, role: str, choice: Choice) -> list[int] | None:
    if choice is None:
        return None
    # Numbers count the inputs, or the outputs, of a record.
    side = FileTable(table.path, tuple(c for c in table.columns if c.role == role))
    return [next(k for k, c in enumerate(side.columns) if c is column) for column in chosen(side, choice)]
