"""Files beside a bench: a law that was designed on the ones runs on the other, wire by wire."""

from collections.abc import Mapping
from typing import Any

from ultraquiet._base.constraints import same_rate
from ultraquiet._base.errors import RateError
from ultraquiet._base.mistakes import Mistakes
from ultraquiet.pipeline.study import RecordsTable
from ultraquiet.values import Record

# Both sides of a record with the key of `[records]` that names them, and how its table and the bench call one of them.
SIDES = (("inputs", "actuators", "input", "actuator"), ("outputs", "sensors", "output", "sensor"))


def require_of_bench(table: RecordsTable, bench: Any, read: Mapping[str, Record], mistakes: Mistakes) -> None:
    """Note a rate that is not the bench's, and channels of the same names that stand in another order.

    Files are like one another, so the first one is looked at. One that no controller could run on is left alone.
    """
    if not read or not getattr(bench, "reacts", True):
        return
    name, record = next(iter(read.items()))
    try:
        same_rate("study", f"'{name}'", record.rate_hz, "the bench", bench.rate_hz)
    except RateError as error:
        where = ("records", "files", 0) if table.rate_hz is None else ("records", "rate_hz")
        mistakes.add(where, str(error))
    for key, side, of_file, of_bench in SIDES:
        ours, theirs = ([c.name for c in getattr(each, side)] for each in (record, bench))
        if len(ours) != len(theirs):
            continue  # which is said of the plant, once it is identified
        moved = next((c for k, c in enumerate(ours) if c in theirs and theirs[k] != c), None)
        if moved is not None:
            where = ("records", "files", 0) if getattr(table, key) is None else ("records", key)
            mistakes.add(
                where,
                f"study: '{moved}' is {of_file} {ours.index(moved) + 1} of '{name}' and {of_bench} "
                f"{theirs.index(moved) + 1} of the bench, on which a law would run with its wires swapped; name "
                f"'{key}' in the order of the bench, {', '.join(theirs)}.",
            )


def taken_for(bench: Any, read: Mapping[str, Record]) -> tuple[str, ...]:
    """Return sentences on channels of files that have other names than those of the bench, in whose places they stand.

    >>> from ultraquiet.bench import Wrapped
    >>> import numpy as np
    >>> bench = Wrapped(lambda u, d: u, lambda: None, 500.0, ["coil"], ["left", "right"])
    >>> record = Record(np.zeros((1, 9)), np.zeros((2, 9)), 500.0, ["coil"], ["left", "r"])
    >>> taken_for(bench, {"run": record})
    ("the bench's sensors left, right are taken for left, r of the files",)
    """
    if not read or not getattr(bench, "reacts", True):
        return ()
    record = next(iter(read.values()))
    pairs = [(side, *([c.name for c in getattr(each, side)] for each in (bench, record))) for _, side, *_ in SIDES]
    return tuple(
        f"the bench's {side} {', '.join(theirs)} are taken for {', '.join(ours)} of the files"
        for side, theirs, ours in pairs
        if theirs != ours and len(theirs) == len(ours)
    )
