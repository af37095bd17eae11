"""Which columns of a file go in and which come out: by name, by number, or by what the names say themselves."""

import re
from collections.abc import Sequence

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.files.table import Column, Table
from ultraquiet.values import Channel, Record

Choice = str | int | Sequence[str | int] | None

SPEAKING = {  # names that say themselves what a column is
    "inputs": re.compile(r"(inputs?|u)[\W_]*\d*", re.IGNORECASE),
    "outputs": re.compile(r"(outputs?|y)[\W_]*\d*", re.IGNORECASE),
}
COLUMNS = re.compile(r"(?:(?P<variable>.+):)?(?P<first>\d+)(?:-(?P<last>\d+))?")


def to_record(table: Table, rate_hz: float | None, inputs: Choice, outputs: Choice, parent: str = "") -> Record:
    """Return the chosen columns of a table as a record; the choice is kept in its provenance."""
    if (inputs is None) != (outputs is None):
        raise InputError("read_record: --inputs and --outputs (inputs=, outputs=) go together; one of them is missing.")
    if inputs is None:
        u, y = _speaking(table)
    else:
        u, y = chosen(table, inputs), chosen(table, outputs)
    lengths = {c.values.size for c in (*u, *y)}
    if len(lengths) != 1:
        said = ", ".join(f"{c.name} ({c.values.size})" for c in (*u, *y))
        raise InputError(f"read_record: the columns chosen from '{table.path}' differ in length: {said}.")
    settings = {"file": table.path, "inputs": [c.name for c in u], "outputs": [c.name for c in y]}
    return Record(
        np.stack([c.values for c in u]),
        np.stack([c.values for c in y]),
        table.rate_hz() if rate_hz is None else rate_hz,
        [Channel(c.name, c.unit) for c in u],
        [Channel(c.name, c.unit) for c in y],
        Provenance("read_record", settings, parents=(parent,) if parent else (), versions=versions()),
    )


def chosen(table: Table, choice: Choice) -> list[Column]:
    """Return the columns that a choice names: `"motor,load"`, `"1-2"`, `"data:3-30"`, `["a", "b"]`, `1`."""
    if isinstance(choice, int | str):
        whole = str(choice)
        names = {c.name for c in table.columns} | {c.variable for c in table.columns}
        items = [whole] if whole in names else whole.split(",")
    else:
        items = [str(item) for item in choice or ()]
    picked = [column for item in items for column in _item(table, item.strip())]
    if not picked:
        raise InputError(f"read_record: no column was chosen from '{table.path}'; it holds {table.describe()}.")
    twice = sorted({c.name for c in picked if sum(c is other for other in picked) > 1})
    if twice:
        raise InputError(f"read_record: '{twice[0]}' was chosen twice; name every column once.")
    return picked


def _item(table: Table, item: str) -> list[Column]:
    named = [c for c in table.columns if item in (c.name, f"{c.name} [{c.unit}]", f"{c.name} ({c.unit})")]
    if len(named) > 1:
        raise InputError(f"read_record: '{table.path}' has {len(named)} columns called '{item}'; choose by number.")
    whole = named or [c for c in table.columns if item and c.variable == item]
    if whole:
        return whole
    numbers = COLUMNS.fullmatch(item)
    if numbers is None:
        raise InputError(f"read_record: '{table.path}' has no column '{item}'; it holds {table.describe()}.")
    columns = _numbered(table, item, numbers["variable"])
    first, last = int(numbers["first"]), int(numbers["last"] or numbers["first"])
    if not 1 <= first <= last <= len(columns):
        raise InputError(
            f"read_record: '{item}' was asked of '{table.path}', whose columns are numbered 1 to {len(columns)}."
        )
    return list(columns[first - 1 : last])


def _numbered(table: Table, item: str, variable: str | None) -> Sequence[Column]:
    if variable is not None:
        return [c for c in table.columns if c.variable == variable]
    matrices = {c.variable for c in table.columns if c.name != c.variable}
    if len(matrices) != 1:
        raise InputError(
            f"read_record: '{item}' is a number, but '{table.path}' holds {table.describe()}; "
            "say of which, as in NAME:1-2."
        )
    (only,) = matrices
    return [c for c in table.columns if c.variable == only]


def _speaking(table: Table) -> tuple[list[Column], list[Column]]:
    """Return inputs and outputs by their names, or by order when there are just two."""
    signals = table.signals
    u, y = (
        [c for c in signals if name.fullmatch(c.name.partition(":")[0].rpartition(".")[2])]
        for name in SPEAKING.values()
    )
    if u and y:
        return u, y
    one_table = len({c.variable for c in signals}) == 1
    if one_table and len(signals) == 2 and not _is_ramp(signals[0]):
        return [signals[0]], [signals[1]]
    numbers = " or by number, as in --inputs 1-2 --outputs 3" if one_table else ""
    raise InputError(
        f"read_record: '{table.path}' does not say what goes in and what comes out; it holds {table.describe()}; "
        f"name them with --inputs and --outputs (inputs=, outputs=){numbers}."
    )


def _is_ramp(column: Column) -> bool:
    # Evenly rising numbers are time stamps without a name, not an excitation.
    steps = np.diff(column.values)
    return bool(steps.size > 1 and np.all(steps > 0) and np.ptp(steps) <= 1e-3 * steps.mean())
