"""A matrix of a study file: written there, or a file beside it."""

from pathlib import Path

import numpy as np

from ultraquiet._base.constraints import FloatArray, real_array
from ultraquiet._base.errors import InputError


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
    except OSError as error:
        raise InputError(f"{who}: '{path}' cannot be read ({error.strerror or error}).") from error


def _read(who: str, name: str, path: Path) -> FloatArray:
    if path.suffix == ".csv":
        try:
            return np.loadtxt(path, delimiter=",", ndmin=2)
        except ValueError as error:
            raise InputError(f"{who}: '{path}' is no table of numbers with commas ({error}).") from error
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            if name not in arrays:
                raise InputError(f"{who}: '{path}' holds no array '{name}', only {', '.join(arrays) or 'none'}.")
            return arrays[name]
    raise InputError(f"{who}: '{path}' must end in .csv or .npz.")
