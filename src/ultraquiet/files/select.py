"""Which columns of a file go in and which come out: by name, by number, or by what the names say themselves."""

import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet._base.lines import NO_LINE
from ultraquiet._base.mistakes import TableError
from ultraquiet.files.table import Column, FileTable, is_ramp, role_of

Choice = str | int | Sequence[str | int] | None
Picked = tuple[list[Column], list[Column]]

COLUMNS = re.compile(r"(?:(?P<variable>.+):)?(?P<first>\d+)(?:-(?P<last>\d+))?")


def inputs_and_outputs(table: FileTable, inputs: Choice, outputs: Choice) -> Picked:
    """Return the columns that go in and those that come out: as chosen, or as the file says."""
    if (inputs is None) != (outputs is None):
        raise InputError("read_record: --inputs and --outputs (inputs=, outputs=) go together; one of them is missing.")
    if inputs is None:
        return _speaking(table)
    picked = _both(table, inputs, outputs)
    clock = next((c for c in (*picked[0], *picked[1]) if table.is_clock(c)), None)
    if clock is not None:
        numbered = ", ".join(f"{k} {c.name}" for k, c in enumerate(table.columns, 1) if not table.is_clock(c))
        raise InputError(
            f"read_record: '{clock.name}' is the clock of '{table.path}', no signal; leave it away. Numbers count "
            f"all columns: {numbered}."
        )
    return picked


class _AbsentError(InputError):
    """A column that a table has not."""


def _both(table: FileTable, inputs: Choice, outputs: Choice) -> Picked:
    """Return what is chosen of either side; where nothing can be, of which column is told for both."""
    into, out = (_looked_up(table, choice) for choice in (inputs, outputs))
    # each side is told by itself, as it may stand in a line of its own; of an empty table there is one thing to say
    sides = [into, out] if table.columns else [_LookedUp([], [*into.absent, *out.absent], [])]
    _refuse(table, [sentence for side in sides for sentence in _mistakes(table, side)])
    return into.columns, out.columns


def chosen(table: FileTable, choice: Choice) -> list[Column]:
    """Return the columns that a choice names: `"motor,load"`, `"1-2"`, `"data:3-30"`, `["a", "b"]`, `1`."""
    found = _looked_up(table, choice)
    _refuse(table, _mistakes(table, found))
    return found.columns


class _LookedUp(NamedTuple):
    """What a choice names, what of it the table has not, and what else is wrong with it."""

    columns: list[Column]
    absent: list[str]
    refused: list[str]


def _mistakes(table: FileTable, found: _LookedUp) -> list[str]:
    names = list(dict.fromkeys(f"'{item}'" for item in found.absent))
    what = f"column{'s' * (len(names) > 1)} {', '.join(names)}"
    said = [f"read_record: '{table.path}' has no {what}; it holds {table.describe()}."] if names else []
    return [*said, *found.refused]


def _refuse(table: FileTable, said: Sequence[str]) -> None:
    if said:
        raise TableError(f"read_record: '{table.path}'", [(NO_LINE, one) for one in dict.fromkeys(said)])


def _looked_up(table: FileTable, choice: Choice) -> _LookedUp:
    items = _items_of(choice)
    if isinstance(choice, str) and not _called(table, choice):
        items = choice.split(",")
    found = _LookedUp([], [], [])
    for item in (item.strip() for item in items):
        try:
            found.columns.extend(_item(table, item))
        except _AbsentError:
            found.absent.append(item)
        except InputError as error:
            found.refused.append(str(error))
    if found.absent or found.refused:
        return found
    if not found.columns:
        found.refused.append(f"read_record: no column was chosen from '{table.path}'; it holds {table.describe()}.")
    twice = sorted({c.name for c in found.columns if sum(c is other for other in found.columns) > 1})
    if twice:
        found.refused.append(f"read_record: '{twice[0]}' was chosen twice; name every column once.")
    return found


def _items_of(choice: Any) -> list[str]:
    """Return the names and numbers of a choice, numbers of NumPy's among them."""
    listed = isinstance(choice, Iterable) and not isinstance(choice, str | bytes)
    items = [] if choice is None else list(choice) if listed else [choice]
    odd = [item for item in items if not isinstance(item, str | int | np.integer)]
    if odd:
        raise InputError(
            f"read_record: a column is chosen by its name or by its number from one, got {odd[0]!r}; give one "
            f"of these, or a list of them."
        )
    return [str(item) for item in items]


def _called(table: FileTable, item: str) -> list[Column]:
    named = [c for c in table.columns if item in _names(c)]
    return named or [c for c in table.columns if item and c.variable == item]


def _names(c: Column) -> tuple[str, ...]:
    # Where the file tells roles, `u strut 1` and `y strut 1` tell an actuator from its sensor.
    marked = {"input": f"u {c.name}", "output": f"y {c.name}"}.get(c.role, c.name)
    return c.name, f"{c.name} [{c.unit}]", f"{c.name} ({c.unit})", marked


def _item(table: FileTable, item: str) -> list[Column]:
    named = _called(table, item)
    if len(named) > 1 and len({c.name for c in named}) == 1:
        raise InputError(f"read_record: '{table.path}' has {len(named)} columns called '{item}'; choose by number.")
    if named:
        return named
    numbers = COLUMNS.fullmatch(item)
    if numbers is None:
        raise _AbsentError(item)
    columns = _numbered(table, item, numbers["variable"])
    first, last = int(numbers["first"]), int(numbers["last"] or numbers["first"])
    if not 1 <= first <= last <= len(columns):
        raise InputError(
            f"read_record: '{item}' was asked of '{table.path}', whose columns are numbered 1 to {len(columns)}."
        )
    return list(columns[first - 1 : last])


def _numbered(table: FileTable, item: str, variable: str | None) -> Sequence[Column]:
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


def _speaking(table: FileTable) -> Picked:
    """Return inputs and outputs by what the file says, by their names, or by order when there are just two."""
    signals = table.signals
    u, y = ([c for c in signals if (c.role or role_of(c.name)) == role] for role in ("input", "output"))
    if u and y:
        return u, y
    if len(signals) < 2 and not table.unusable:
        listing = f"one signal, '{signals[0].name}'" if signals else "no signal"
        raise InputError(
            f"read_record: '{table.path}' holds {listing}; a record takes an input and an output at least."
        )
    one_table = len({c.variable for c in signals}) == 1
    if one_table and len(signals) == 2 and not is_ramp(signals[0].values):
        return [signals[0]], [signals[1]]
    first = 1 + (bool(table.columns) and table.is_clock(table.columns[0]))
    numbers = f" or by number, as in --inputs {first}-{first + 1} --outputs {first + 2}" if one_table else ""
    raise InputError(
        f"read_record: '{table.path}' does not say what goes in and what comes out; it holds {table.describe()}; "
        f"name them with --inputs and --outputs (inputs=, outputs=){numbers}, or in a mapping."
    )
