"""A law's coefficients for other programs, and back: MAT, HDF5, CSV, foton."""

import csv
import io
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.regular import read_regular
from ultraquiet.deploy.exchange.foton import foton_text, read_foton
from ultraquiet.files import load, save, write_bytes
from ultraquiet.files.confined import confined
from ultraquiet.files.packing import pack, unpack
from ultraquiet.values.channel import Channel
from ultraquiet.values.state_space import StateSpace

MATRICES = ("A", "B", "C", "D")


def export_law(law: StateSpace, path: str | os.PathLike[str], **settings: Any) -> Path:
    """Write a law's coefficients for another program, whole or not at all; the suffix decides the format.

    x[k+1] = A x[k] + B y[k], u[k] = C x[k] + D y[k].

    `.mat` (version 5): A, B, C, D, rate_hz, Ts, names and units, so that `ss(A, B, C, D, Ts)` is the law in MATLAB;
    `.h5`: an archive of this package, plain HDF5 inside; `.csv`: a row for each number; `.txt`: second-order sections
    as LIGO's foton writes them, see `foton_text`, whose settings are passed on. All but the last keep every bit.
    What the code adds to the law (limits, ramps, guards) is not in it. Give `deployment.quantised` for the rounded
    coefficients of the code.

    Args:
        law: discrete controller from measurements to commands.
        path: the file.
        settings: of `foton_text`, for `.txt`.

    Raises:
        InputError: another suffix, a law in continuous time, or one that the format cannot hold.
        StorageError: the file cannot be written; what was there before is untouched.

    >>> import tempfile
    >>> law = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.5]], rate_hz=3500.0)
    >>> [read_law(export_law(law, tempfile.mkdtemp() + "/law" + s)).rate_hz for s in FORMATS]
    [3500.0, 3500.0, 3500.0, 3500.0]
    """
    if not isinstance(law, StateSpace):
        raise InputError(f"export_law: 'law' must be a StateSpace, got {type(law).__name__}.")
    if law.rate_hz is None:
        raise InputError("export_law: the controller is in continuous time; discretise it at the bench's rate first.")
    kind = _suffix("export_law", path)
    if settings and kind != ".txt":
        raise InputError(f"export_law: {', '.join(settings)} are for foton's '.txt', got '{path}'.")
    if kind == ".h5":
        return save(law, path)
    writers: Mapping[str, Callable[[], bytes]] = {
        ".mat": lambda: _mat(law),
        ".csv": lambda: _csv(law),
        ".txt": lambda: foton_text(law, **settings).encode(),
    }
    return write_bytes(path, writers[kind]())


def read_law(path: str | os.PathLike[str]) -> StateSpace:
    """Read what `export_law` wrote.

    Raises:
        StorageError: missing, damaged, or something else.
        InputError: another suffix.
    """
    kind = _suffix("read_law", path)
    if kind == ".h5":
        law = load(path)
        if not isinstance(law, StateSpace):
            raise StorageError(f"read_law: '{path}' holds a {type(law).__name__}, not a law.")
        return law
    try:
        data = read_regular(path)
    except OSError as error:
        raise StorageError(f"read_law: '{path}' cannot be read ({error.strerror}).") from None
    import scipy.io  # noqa: F401  the child can load nothing

    read = FORMATS[kind]
    packed = confined(lambda: pack(_law_of(read, data, path)), Path(path).name, kind, len(data), who="read_law")
    return cast("StateSpace", unpack(*packed))


def _law_of(read: Callable[[bytes], StateSpace], data: bytes, path: str | os.PathLike[str]) -> StateSpace:
    try:
        return read(data)
    except StorageError:
        raise
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise StorageError(f"read_law: '{path}' holds no law ({type(error).__name__}: {error}).") from None


def _suffix(who: str, path: str | os.PathLike[str]) -> str:
    kind = Path(path).suffix.lower()
    if kind not in FORMATS:
        raise InputError(f"{who}: the suffix must be one of {', '.join(FORMATS)}, got '{path}'.")
    return kind


def _mat(law: StateSpace) -> bytes:
    import scipy.io

    def cells(texts: list[str]) -> np.ndarray:
        array = np.empty(len(texts), dtype=object)
        array[:] = texts
        return array

    memory, rate_hz = io.BytesIO(), float(law.rate_hz or 0)
    variables: dict[str, Any] = {name: getattr(law, name) for name in MATRICES}
    variables |= {"rate_hz": rate_hz, "Ts": 1.0 / rate_hz}
    for side, wires in (("input", law.actuators), ("output", law.sensors)):
        variables |= {f"{side}_names": cells([c.name for c in wires]), f"{side}_units": cells([c.unit for c in wires])}
    scipy.io.savemat(memory, variables)
    return memory.getvalue()


def _from_mat(data: bytes) -> StateSpace:
    import scipy.io

    try:
        variables = scipy.io.loadmat(io.BytesIO(data))
    except Exception as error:  # SciPy raises whatever its parser meets
        raise ValueError(str(error)) from None

    def wires(side: str) -> list[Channel]:
        texts = [["".join(cell.ravel()) for cell in variables[f"{side}_{kind}"].ravel()] for kind in ("names", "units")]
        return [Channel(name, unit) for name, unit in zip(*texts, strict=True)]

    rate_hz = float(variables["rate_hz"][0, 0])
    D = np.asarray(variables["D"], dtype=np.float64)
    n = variables["A"].shape[0]
    A, B, C = (np.asarray(variables[m], float).reshape(s) for m, s in zip("ABC", _shapes(n, *D.shape), strict=True))
    return StateSpace(A, B, C, D, rate_hz, wires("input"), wires("output"))


def _csv(law: StateSpace) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["what", "row", "column", "value"])
    rows.writerow(["rate_hz", "", "", repr(float(law.rate_hz or 0))])
    rows.writerow(["states", "", "", law.states])
    for side, wires in (("input", law.actuators), ("output", law.sensors)):
        rows.writerows([side, k + 1, c.unit, c.name] for k, c in enumerate(wires))
    for name in MATRICES:
        matrix = getattr(law, name)
        rows.writerows([name, i + 1, j + 1, repr(float(v))] for (i, j), v in np.ndenumerate(matrix))
    return text.getvalue().encode()


def _from_csv(data: bytes) -> StateSpace:
    rows = list(csv.reader(io.StringIO(data.decode(), newline="")))[1:]
    single = {row[0]: row[3] for row in rows if not row[1]}
    wires = {side: [Channel(r[3], r[2]) for r in rows if r[0] == side] for side in ("input", "output")}
    ny, nu, n = len(wires["input"]), len(wires["output"]), int(single["states"])
    shapes = dict(zip(MATRICES, (*_shapes(n, nu, ny), (nu, ny)), strict=True))
    matrices = {name: np.full(shape, np.nan) for name, shape in shapes.items()}
    for what, row, column, value in rows:
        if what in matrices:
            matrices[what][int(row) - 1, int(column) - 1] = float(value)
    A, B, C, D = matrices.values()
    return StateSpace(A, B, C, D, float(single["rate_hz"]), wires["input"], wires["output"])


def _shapes(states: int, outputs: int, inputs: int) -> tuple[tuple[int, int], ...]:
    return (states, states), (states, inputs), (outputs, states)


def _from_foton(data: bytes) -> StateSpace:
    return read_foton(data.decode("ascii")).state_space()


def _from_archive(data: bytes) -> StateSpace:
    raise NotImplementedError  # archives are read by their path


FORMATS: Mapping[str, Callable[[bytes], StateSpace]] = MappingProxyType(
    {".mat": _from_mat, ".h5": _from_archive, ".csv": _from_csv, ".txt": _from_foton}
)
