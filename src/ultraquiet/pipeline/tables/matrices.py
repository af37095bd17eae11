"""A matrix of a study file: written there, or a file beside it."""

import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, real_array
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.regular import MOST_TEXT_BYTES, read_regular
from ultraquiet.files import reason
from ultraquiet.files.confined import confined
from ultraquiet.files.readers.npz import npz_arrays


def matrix_of(name: str, given: list[list[float]] | str, beside: Path | None) -> FloatArray:
    """Return a matrix given in place or by a file.

    Args:
        name: of the setting, and of the array in an `.npz`.
        given: rows, or the name of a `.csv` or `.npz`.
        beside: folder in which the file is sought; the current one when absent.

    Raises:
        InputError: rows of unequal length, no such file, another kind of file, no such array in it.

    >>> matrix_of("sensors", [[1, 2], [3, 4]], None).tolist()
    [[1.0, 2.0], [3.0, 4.0]]
    """
    who = f"blending.{name}"
    if not isinstance(given, str):
        lengths = sorted({len(row) for row in given})
        if len(lengths) != 1:
            raise InputError(f"{who}: the rows must be of one length, got rows of {', '.join(map(str, lengths))}.")
        return real_array(who, name, given, 2)
    path = Path(given) if beside is None else beside / given
    try:
        return real_array(who, name, _read(who, name, path), 2)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a name with a NUL is of the second kind
        why = str(error) if isinstance(error, StorageError) else f"'{path}' cannot be read ({reason(error)})."
        raise InputError(f"{who}: {why}") from error


def _read(who: str, name: str, path: Path) -> FloatArray:
    if path.suffix not in (".csv", ".npz"):
        raise InputError(f"{who}: '{path}' must end in .csv or .npz.")
    data = read_regular(path, MOST_TEXT_BYTES)
    if path.suffix == ".csv":
        try:
            return np.loadtxt(io.StringIO(data.decode()), delimiter=",", ndmin=2)
        except ValueError as error:
            raise InputError(f"{who}: '{path}' is no table of numbers with commas ({error}).") from error
    # Few bytes may unpack into any number: that is done where it costs nobody anything.
    held: dict[str, Any] = confined(partial(_numbers, path.name, data), path.name, "NumPy", len(data), who=who)
    if name not in held:
        raise InputError(f"{who}: '{path}' holds no array '{name}', only {', '.join(held) or 'none'}.")
    return held[name]


def _numbers(name: str, data: bytes) -> dict[str, Any]:
    return {key: array for key, array in npz_arrays(name, data).items() if array.dtype.kind in "fiu"}
