"""Frequency responses of other programs: universal files in and out, averaged spectra in `.npz`."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.files.archive import load_many, save
from ultraquiet.files.atomic import write_bytes
from ultraquiet.files.formats import format_of, understood
from ultraquiet.files.matlab_values import mat_image, read_mat_value
from ultraquiet.files.readers.npz import npz_arrays
from ultraquiet.files.readers.uff import COHERENCE, RESPONSE_FUNCTION, common, response_name, uff_bytes, uff_sets
from ultraquiet.files.whole import understanding, whole
from ultraquiet.values import Channel, FrequencyResponse

AXIS_NAMES = ("f", "f_hz", "freq", "frequency", "frequencies")
VALUE_NAMES = ("values", "frf", "H", "G", "response")
COHERENCE_NAMES = ("coherence", "coh")
SUFFIXES = (".h5", ".hdf5", ".uff", ".unv", ".npz", ".mat")
BETWEEN = " / "  # response and reference in ID line 1
EVEN = 1e-9  # of the step: how far lines may stand from an even spacing that the header's six digits can say


def read_frf(path: str | os.PathLike[str], conjugated: bool = False) -> FrequencyResponse:
    """Read a frequency response.

    From `.h5` (an archive), `.mat` (`ResponseData` and `Frequency`), `.uff` and `.unv` (58 and 58b: response functions,
    with their coherences where they stand beside them), or `.npz` with `f` `(nf,)` and either `values` `(ny, nu, nf)`
    or the averaged spectra of one excitation, from which G = S_uy / S_uu (H1) is formed: `csd` `(ny, nf)` and `psd_exc`
    `(nf,)`, with `coh` `(ny, nf)`, `channels` and `exc` where known.

    Args:
        path: the file.
        conjugated: the cross spectra are E[u y*], not E[u* y]; programs differ, and a response that answers before it
            is asked tells a wrong choice.

    Raises:
        StorageError: missing, empty, cut short or damaged.
        InputError: no response in it, or elements of the matrix that are missing or differ in frequencies.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"read_frf: '{path}' has none of the suffixes {', '.join(SUFFIXES)}.")
    if suffix in (".h5", ".hdf5"):
        responses = [value for value in load_many(path).values() if isinstance(value, FrequencyResponse)]
        if len(responses) != 1:
            raise InputError(f"read_frf: '{path}' holds {len(responses)} frequency responses; it would take one.")
        return responses[0]
    if suffix == ".mat":
        value = read_mat_value(path)
        if not isinstance(value, FrequencyResponse):
            raise InputError(
                f"read_frf: '{path}' holds a {type(value).__name__}; it would take ResponseData, Frequency."
            )
        return value
    data = whole(path)
    settings = {"file": Path(path).name, "conjugated": conjugated}
    provenance = Provenance("read_frf", settings, parents=(hashlib.sha256(data).hexdigest(),), versions=versions())
    name, form = Path(path).name, format_of("read_frf", Path(path))
    read = (lambda: npz_arrays(name, data)) if suffix == ".npz" else (lambda: uff_sets(name, data))
    content = understood(form, name, read, len(data))
    with understanding(name, form.name):
        if suffix == ".npz":
            return _of_arrays(name, content, conjugated, provenance)
        return _of_sets(name, content, provenance)


def export_frf(
    response: FrequencyResponse, path: str | os.PathLike[str], overwrite: bool = True, text: bool = False
) -> Path:
    """Write a frequency response as `.h5`, as `.mat` (for MATLAB's `frd`), or as `.uff` or `.unv`.

    A universal file has one data set 58b an element, coherences behind.

    Args:
        response: what to write.
        path: the file.
        overwrite: False refuses a name that is taken.
        text: data set 58, in ASCII, with twelve digits.

    Raises:
        InputError: another suffix, values that are not finite, or names too long for a universal file.
        StorageError: disk full, folder missing or closed, name taken; what was there before is untouched.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".h5", ".hdf5"):
        return save(response, path, overwrite)
    if suffix == ".mat":
        return write_bytes(path, mat_image(response), overwrite)
    if suffix not in (".uff", ".unv"):
        raise InputError(f"export_frf: '{path}' has none of the suffixes .h5, .hdf5, .mat, .uff, .unv.")
    if response.f_hz.size < 2:
        raise InputError("export_frf: a universal file takes two frequencies or more, got one; write .h5.")
    parts: list[tuple[int, np.ndarray]] = [(RESPONSE_FUNCTION, response.values)]
    if response.coherence is not None:
        parts.append((COHERENCE, response.coherence))
    if not all(np.isfinite(array).all() for _, array in parts):
        raise InputError("export_frf: values or coherence are not finite, which a universal file cannot say.")
    sets = [
        _element(response, kind, array, i, j, text)
        for kind, array in parts
        for i in range(len(response.sensors))
        for j in range(len(response.actuators))
    ]
    return write_bytes(path, uff_bytes(sets), overwrite)


def _element(response: FrequencyResponse, kind: int, array: np.ndarray, i: int, j: int, text: bool) -> dict[str, Any]:
    y, u = response.sensors[i], response.actuators[j]
    name = f"{y.name}{BETWEEN}{u.name}"
    if BETWEEN in y.name or BETWEEN in u.name:
        raise InputError(f"export_frf: the name '{name}' holds '{BETWEEN}', which parts response and reference.")
    f = response.f_hz
    return {
        **common(kind, name, y.unit if kind == RESPONSE_FUNCTION else "", array[i, j], f, text),
        "rsp_node": i + 1,
        "ref_node": j + 1,
        "id2": response.estimator[:80].strip() or "NONE",
        "abscissa_spacing": int(_is_even(f)),
        "orddenom_axis_units_lab": u.unit or "NONE",
    }


def _is_even(f: np.ndarray) -> bool:
    start, step = (float(f"{value:.5e}") for value in (f[0], f[1] - f[0]))
    return bool(step > 0 and np.abs(start + step * np.arange(f.size) - f).max() <= EVEN * step)


def _of_sets(name: str, sets: Sequence[dict[str, Any]], provenance: Provenance) -> FrequencyResponse:
    functions = [data_set for data_set in sets if data_set["func_type"] == RESPONSE_FUNCTION]
    if not functions:
        raise InputError(f"read_frf: '{name}' holds no response function (data set 58 of function type 4).")
    f = np.asarray(functions[0]["x"], dtype=np.float64)
    if any(
        data_set["x"].shape != f.shape or not np.allclose(data_set["x"], f, rtol=1e-9, atol=0)
        for data_set in sets
        if data_set in functions
    ):
        raise InputError(f"read_frf: the response functions of '{name}' differ in their frequencies.")
    rows, columns = (list(dict.fromkeys(_place(data_set, end) for data_set in functions)) for end in ("rsp", "ref"))
    elements = {(_place(data_set, "rsp"), _place(data_set, "ref")): data_set for data_set in functions}
    missing = [(r, c) for r in rows for c in columns if (r, c) not in elements]
    if missing:
        raise InputError(f"read_frf: '{name}' lacks the response of {missing[0][0]} to {missing[0][1]}.")
    quality = {
        (_place(data_set, "rsp"), _place(data_set, "ref")): data_set
        for data_set in sets
        if data_set["func_type"] == COHERENCE and len(data_set["data"]) == f.size
    }
    whole_quality = all((r, c) in quality for r in rows for c in columns)
    first = functions[0]
    return FrequencyResponse(
        f,
        [[elements[r, c]["data"] for c in columns] for r in rows],
        [[quality[r, c]["data"].real for c in columns] for r in rows] if whole_quality else None,
        "" if first["id2"] == "NONE" else first["id2"],
        [_channel(elements[rows[0], c], "ref", "orddenom") for c in columns],
        [_channel(elements[r, columns[0]], "rsp", "ordinate") for r in rows],
        provenance,
    )


def _place(data_set: dict[str, Any], end: str) -> tuple[str, int, int]:
    return data_set[f"{end}_ent_name"], data_set[f"{end}_node"], data_set[f"{end}_dir"]


def _channel(data_set: dict[str, Any], end: str, axis: str) -> Channel:
    names = data_set["id1"].split(BETWEEN)
    name = names[0 if end == "rsp" else 1] if len(names) == 2 else response_name(data_set, end)
    unit = data_set.get(f"{axis}_axis_units_lab", "")
    return Channel(name, "" if unit == "NONE" else unit)


def _of_arrays(name: str, arrays: dict[str, np.ndarray], conjugated: bool, provenance: Provenance) -> FrequencyResponse:
    f, values, coherence = (_first(arrays, keys) for keys in (AXIS_NAMES, VALUE_NAMES, COHERENCE_NAMES))
    estimator = ""
    if f is None or (values is None and not {"csd", "psd_exc"} <= set(arrays)):
        listing = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
        raise InputError(f"read_frf: '{name}' holds {listing}; it would take f with values, or with csd and psd_exc.")
    if values is None:
        cross, power = np.atleast_2d(arrays["csd"]).astype(np.complex128), arrays["psd_exc"].astype(np.float64)
        if power.shape != f.shape or cross.shape[1:] != f.shape or not (power > 0).all():
            raise InputError(
                f"read_frf: '{name}' has csd {cross.shape} and psd_exc {power.shape} for {f.size} frequencies."
            )
        values, estimator = (cross.conj() if conjugated else cross) / power, "H1"
    shaped = values[:, np.newaxis] if values.ndim == 2 else values
    if coherence is not None and coherence.ndim == 2:
        coherence = coherence[:, np.newaxis]
    inputs, outputs = (
        np.atleast_1d(arrays[key]).astype(str).tolist() if key in arrays else None for key in ("exc", "channels")
    )
    try:
        return FrequencyResponse(f, shaped, coherence, estimator, _bare(inputs), _bare(outputs), provenance)
    except InputError as error:
        raise StorageError(f"read_frf: '{name}' is no frequency response: {error}") from error


def _bare(names: list[str] | None) -> list[Channel] | None:
    return None if names is None else [Channel(name, "") for name in names]


def _first(arrays: dict[str, np.ndarray], keys: Sequence[str]) -> np.ndarray | None:
    return next((arrays[key] for key in keys if key in arrays), None)
