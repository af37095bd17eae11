"""Universal files, data set 58 (ASCII) and 58b (binary), by pyuff.

pyuff works on named files only, so the bytes pass through a folder of their own. It prints the sampling step with six
digits and numbers of the ASCII form with twelve; therefore ID line 4 of what is written here repeats role, count and
rate, and the binary form, which keeps every bit, is what is written unless text is asked for.
"""

import math
import re
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files.table import Column, FileTable, clock_hz, rate_of_step
from ultraquiet.values import Record

TIME_RESPONSE, RESPONSE_FUNCTION, COHERENCE = 1, 4, 6  # record 6, field 1
TIME_AXIS, FREQUENCY_AXIS = 17, 18  # record 8, field 1
NONE = "NONE"  # what stands where nothing is said
MOST_NAME, MOST_UNIT = 80, 20  # columns of an ID line and of a unit's label
PRINTED = 1e-5  # what a step may be off by: pyuff prints six digits of it
BYTES_AT = 32  # column of the number of bytes behind the first line of a data set 58b, its line end counted
# By number, negative ones from the end.
DIRECTIONS = ("", "+X", "+Y", "+Z", "+RX", "+RY", "+RZ", "-RZ", "-RY", "-RX", "-Z", "-Y", "-X")
OURS = re.compile(r"ultraquiet (input|output) (\d+) of (\d+), ([-+.\deE]+) Hz")


def read_uff(name: str, data: bytes) -> FileTable:
    """Return the time responses of a universal file.

    A channel's name is ID line 1 where it differs from set to set, or node and direction; its unit is the label of the
    ordinate.
    """
    sets = [data_set for data_set in uff_sets(name, data) if data_set.get("func_type") in (0, TIME_RESPONSE)]
    real = [data_set for data_set in sets if not np.iscomplexobj(data_set["data"])]
    names = _names(real)
    columns = [_column(name, called, data_set) for called, data_set in zip(names, real, strict=True)]
    counts = {match[1]: int(match[3]) for data_set in real if (match := OURS.fullmatch(data_set["id4"]))}
    for role, count in counts.items():
        if sum(c.role == role for c in columns) != count:
            raise StorageError(f"read_record: '{name}' was cut short: it should hold {count} channels of {role}.")
    return FileTable(name, tuple(columns))


def write_uff(record: Record, text: bool = False) -> bytes:
    """Return a record as data sets 58b, or 58 when text is asked for, one a channel, inputs first."""
    sets: list[dict[str, Any]] = []
    stamps = np.array([0.0, 1.0 / record.rate_hz])  # pyuff takes start and step from the first two
    for role, channels, rows in (
        ("input", record.actuators, record.inputs),
        ("output", record.sensors, record.outputs),
    ):
        for k, (c, row) in enumerate(zip(channels, rows, strict=True)):
            head = {"id4": f"ultraquiet {role} {k + 1} of {len(channels)}, {record.rate_hz!r} Hz", "rsp_node": k + 1}
            sets.append({**common(TIME_RESPONSE, c.name, c.unit, row, stamps, text), **head})
    return uff_bytes(sets)


def uff_sets(name: str, data: bytes) -> list[dict[str, Any]]:
    """Return all data sets 58 of a universal file, each whole."""
    import pyuff

    if not data.rstrip(b" \r\n").endswith(b"    -1"):
        raise StorageError(
            f"read_record: '{name}' is no universal file, or was cut short: it does not end with '    -1'."
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "held.uff"
        path.write_bytes(data)
        file = pyuff.UFF(str(path))
        numbers = [k for k, kind in enumerate(file.get_set_types()) if kind == 58]
        sets: list[dict[str, Any]] = [file.read_sets(k) for k in numbers]  # type: ignore[assignment]
    for k, data_set in zip(numbers, sets, strict=True):
        if len(data_set["data"]) != data_set["num_pts"]:
            raise StorageError(
                f"read_record: data set {k + 1} of '{name}' holds {len(data_set['data'])} of {data_set['num_pts']} "
                "values; it is damaged or was cut short."
            )
    return sets


def uff_bytes(sets: Sequence[dict[str, Any]]) -> bytes:
    """Return data sets as the bytes of a universal file."""
    import pyuff

    parts: list[bytes] = []
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        # pyuff leaves the last handle on a binary set to the garbage collector.
        warnings.simplefilter("ignore", ResourceWarning)
        # One file a set: pyuff reads the whole file again after every set it adds, and loses the head of a binary one
        # that it writes over another.
        for k, data_set in enumerate(sets):
            path = Path(folder) / f"{k}.uff"
            try:
                pyuff.UFF(str(path)).write_sets(dict(data_set), mode="add")
            except Exception as error:  # pyuff makes one of no kind of what the disk refuses
                raise StorageError(
                    f"export_record: the file could not be prepared in '{folder}' ({error}); make room there, "
                    "or set TMPDIR to a disk that has some."
                ) from error
            parts.append(_sized(path.read_bytes(), data_set))
            path.unlink()
    return b"".join(parts)


def common(kind: int, name: str, unit: str, data: np.ndarray, x: FloatArray, text: bool) -> dict[str, Any]:
    """Return the fields that every data set has; an evenly spaced abscissa is given by its step."""
    for what, label, most in (("name", name, MOST_NAME), ("unit", unit, MOST_UNIT)):
        if len(label) > most or label != label.strip() or len(label.splitlines()) > 1 or (what == "name" and not label):
            raise InputError(
                f"export_record: the {what} {label!r} does not fit a universal file, which holds 1 to {most} "
                "characters without outer blanks and line breaks; rename it."
            )
    return {
        "type": 58,
        "binary": 0 if text else 1,
        "id1": name,
        "func_type": kind,
        "rsp_dir": 0,
        "ref_node": 0,
        "ref_dir": 0,
        "data": data,
        "x": x,
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": TIME_AXIS if kind == TIME_RESPONSE else FREQUENCY_AXIS,
        "orddenom_spec_data_type": 0,
        "ordinate_axis_units_lab": unit or NONE,
    }


def _sized(data: bytes, data_set: dict[str, Any]) -> bytes:
    """Return one data set with its number of bytes set right: pyuff counts complex and uneven values once only."""
    if not data_set["binary"]:
        return data
    numbers = (2 if np.iscomplexobj(data_set["data"]) else 1) + (0 if data_set["abscissa_spacing"] else 1)
    at = data.index(b"\n") + BYTES_AT
    return data[:at] + b"%12d" % (8 * numbers * len(data_set["data"])) + data[at + 12 :]


def _stated(text: str) -> str:
    return "" if text == NONE else text


def _names(sets: Sequence[dict[str, Any]]) -> list[str]:
    labels = [_stated(data_set["id1"]) for data_set in sets]
    ours = [OURS.fullmatch(data_set["id4"]) for data_set in sets]
    if all(labels) and (all(ours) or len(set(labels)) == len(labels)):
        return labels
    return [response_name(data_set) for data_set in sets]


def response_name(data_set: dict[str, Any], end: str = "rsp") -> str:
    """Return entity, node and direction of the response (`rsp`) or the reference (`ref`), as in `wing 12 +Z`."""
    words = (_stated(data_set[f"{end}_ent_name"]), str(data_set[f"{end}_node"]), DIRECTIONS[data_set[f"{end}_dir"]])
    return " ".join(word for word in words if word)


def _column(path: str, name: str, data_set: dict[str, Any]) -> Column:
    unit = _stated(data_set.get("ordinate_axis_units_lab", ""))
    values = np.asarray(data_set["data"], dtype=np.float64)
    ours = OURS.fullmatch(data_set["id4"])
    if ours:
        rate_hz, step_s = float(ours[4]), float(data_set["abscissa_inc"])
        if not math.isclose(step_s * rate_hz, 1.0, rel_tol=PRINTED):
            raise StorageError(
                f"read_record: '{path}' says of '{name}' that it has {rate_hz:g} Hz and a step of {step_s:g} s; it "
                "has been changed: one of them is wrong."
            )
        return Column(name, values, unit, role=ours[1], rate_hz=rate_hz)
    if data_set["abscissa_spacing"] == 1:
        step_s = float(data_set["abscissa_inc"])
        rate_hz = rate_of_step(step_s, ".5e") if step_s > 0 else None
        return Column(name, values, unit, rate_hz=rate_hz, start_s=float(data_set["abscissa_min"]))
    x = np.asarray(data_set["x"], dtype=np.float64)
    return Column(name, values, unit, rate_hz=clock_hz(path, Column("time", x, "s")), start_s=float(x[0]))
