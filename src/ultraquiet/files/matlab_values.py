"""Models, laws and frequency responses as MAT files, under the names that MATLAB's `ss` and `frd` give them."""

import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.files.confined import announce
from ultraquiet.files.formats import format_of, understood
from ultraquiet.files.read import read_record
from ultraquiet.files.readers.mat_sizes import declared_bytes
from ultraquiet.files.readers.matlab import write_mat
from ultraquiet.files.whole import understanding, whole
from ultraquiet.values import Channel, FrequencyResponse, InnovationForm, Record, StateSpace

HELD = "a StateSpace (models and laws), a FrequencyResponse or a Record"
ENDS = (("actuators", "Input"), ("sensors", "Output"))
QUALITIES = ("coherence", "variance")
SYSTEM, RESPONSE = ("A", "B", "C", "D", "Ts", "rate_hz", "K", "NoiseVariance"), ("ResponseData", "Frequency")
CHANNELS = tuple(f"{end}{what}" for _, end in ENDS for what in ("Name", "Unit", "Limits"))
WANTED = (*SYSTEM, *RESPONSE, "FrequencyUnit", "estimator", *QUALITIES, *CHANNELS)


def mat_image(value: Any) -> bytes:
    """Return a value as the bytes of a MAT file (version 5).

    In MATLAB: `load law.mat; K = ss(A, B, C, D, Ts, 'InputName', InputName, 'OutputName', OutputName)`, and
    `load response.mat; G = frd(ResponseData, Frequency, 'FrequencyUnit', 'Hz')`. Every bit of the numbers is kept, and
    names, units and limits of the channels; an innovation form keeps K and its noise, provenance is left out.

    Raises:
        InputError: a value that has no such form.
    """
    if isinstance(value, Record):
        return write_mat(value)
    if isinstance(value, StateSpace):
        held = {key: getattr(value, key) for key in "ABCD"}
        held |= {"Ts": 0.0 if value.rate_hz is None else 1.0 / value.rate_hz, "rate_hz": value.rate_hz or 0.0}
        if isinstance(value, InnovationForm):
            held |= {"K": value.K, "NoiseVariance": value.noise_covariance}
    elif isinstance(value, FrequencyResponse):
        held = {"ResponseData": value.values, "Frequency": value.f_hz[:, None], "FrequencyUnit": "Hz"}
        held |= {key: each for key in QUALITIES if (each := getattr(value, key)) is not None}
        held["estimator"] = value.estimator
    else:
        raise InputError(f"save: a MAT file takes {HELD}, got {type(value).__name__}; save it as .h5.")
    return _written({**held, **_ends(value)})


def read_mat_value(path: str | os.PathLike[str]) -> StateSpace | FrequencyResponse | Record:
    """Read a model, a law, a response or a record from a MAT file, ours or one that MATLAB saved with these names.

    `A`, `B`, `C`, `D` with `Ts` (zero or absent: continuous) make a `StateSpace`; `ResponseData` `(ny, nu, nf)` with
    `Frequency` in Hz, or in rad/s where `FrequencyUnit` says so, a `FrequencyResponse`; anything else is tried as a
    record. Fields of one structure count as variables: `s = struct(K)` is enough.

    Raises:
        StorageError: missing, empty, cut short or damaged.
        InputError: none of these.
    """
    name, data = Path(path).name, whole(path)
    with understanding(name, "MATLAB"):
        held = understood(format_of("load", Path(path)), name, lambda: _variables(name, data), len(data))
    if set("ABCD") <= set(held):
        return _system(name, held)
    if {"ResponseData", "Frequency"} <= set(held):
        return _response(name, held)
    return read_record(path)


def _variables(name: str, data: bytes) -> dict[str, Any]:
    """Return what systems and responses are made of, as plain values; nothing from version 7.3: records alone."""
    import scipy.io

    announce(name, declared_bytes(name, data), len(data))
    try:
        found = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    except NotImplementedError:
        return {}
    held = {**_flat(found), **_shaped(scipy.io.loadmat(io.BytesIO(data)))}
    return {key: _plain(held[key]) for key in WANTED if key in held}


def _plain(value: Any) -> Any:
    """Return a cell of texts as a list, a sparse matrix in full, anything else as it is."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return ["" if np.size(each) == 0 else str(each) for each in value.ravel()]
    in_full = getattr(value, "toarray", None)
    return value if in_full is None else in_full()


def _system(name: str, held: Mapping[str, Any]) -> StateSpace:
    A, B, C, D = (np.atleast_2d(np.asarray(held[key], dtype=np.float64)) for key in "ABCD")
    (ny, nu), n = D.shape, A.shape[0]
    if A.shape != (n, n) or B.size != n * nu or C.size != ny * n:
        raise InputError(f"load: A, B, C and D of '{name}' do not fit together.")
    matrices = A, B.reshape(n, nu), C.reshape(ny, n), D  # without states an empty matrix may have lost its other side
    rate_hz, step_s = (float(np.ravel(held.get(key, 0.0))[0]) for key in ("rate_hz", "Ts"))
    if step_s < 0:
        raise InputError(f"load: the system in '{name}' is discrete without a sampling time (Ts = -1); give it one.")
    rate = rate_hz or (float(f"{1.0 / step_s:.15g}") if step_s else None)
    ends = _channels(held, "Input", nu), _channels(held, "Output", ny)
    if "NoiseVariance" in held and "K" in held and rate is not None:
        K, noise = np.reshape(held["K"], (n, ny)), np.reshape(held["NoiseVariance"], (ny, ny))
        return InnovationForm(*matrices, K, noise, rate, *ends)
    return StateSpace(*matrices, rate, *ends)


def _response(name: str, held: Mapping[str, Any]) -> FrequencyResponse:
    f_hz = np.atleast_1d(np.asarray(held["Frequency"], dtype=np.float64)).ravel()
    if str(held.get("FrequencyUnit", "Hz")).lower() in ("rad/s", "rad/timeunit"):
        f_hz = f_hz / (2.0 * np.pi)
    values = np.asarray(held["ResponseData"])
    ny, nu = (*values.shape, 1, 1)[:2]
    if values.size != ny * nu * f_hz.size:
        raise InputError(f"load: '{name}' holds {values.size} gains for {ny} x {nu} x {f_hz.size} lines.")
    shape = (ny, nu, f_hz.size)
    known = {key: np.reshape(held[key], shape) if key in held else None for key in QUALITIES}
    ends = _channels(held, "Input", nu), _channels(held, "Output", ny)
    estimator = str(held["estimator"]) if isinstance(held.get("estimator"), str) else ""
    return FrequencyResponse(
        f_hz, values.reshape(shape), known["coherence"], estimator, *ends, variance=known["variance"]
    )


def _ends(value: Any) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, end in ENDS:
        wires: Sequence[Channel] = getattr(value, name)
        out |= {f"{end}Name": _cells([c.name for c in wires]), f"{end}Unit": _cells([c.unit for c in wires])}
        out[f"{end}Limits"] = np.array([[c.low, c.high] for c in wires], dtype=np.float64)
    return out


def _channels(held: Mapping[str, Any], end: str, count: int) -> list[Channel] | None:
    names, units = (_texts(held.get(f"{end}{what}"), count) for what in ("Name", "Unit"))
    if names is None:
        return None
    limits = np.reshape(held.get(f"{end}Limits", np.tile([-np.inf, np.inf], count)), (-1, 2))
    ends = limits if len(limits) == count else np.tile([-np.inf, np.inf], (count, 1))
    rows = zip(names, units or [""] * count, ends, strict=True)
    return [Channel(name, unit, float(low), float(high)) for name, unit, (low, high) in rows]


def _texts(value: Any, count: int) -> list[str] | None:
    """Return texts of a cell; SciPy gives a cell of one text as the text, an empty text as an empty array."""
    if value is None or np.size(value) == 0:
        return [""] * count if value is not None and count == 1 else None
    texts = [value] if isinstance(value, str) else list(np.atleast_1d(value))
    return ["" if np.size(each) == 0 else str(each) for each in texts] if len(texts) == count else None


def _flat(found: Mapping[Any, Any]) -> dict[str, Any]:
    """Return variables; where there is one structure alone, its fields."""
    named = {key: value for key, value in found.items() if isinstance(key, str) and not key.startswith("__")}
    alone = next(iter(named.values())) if len(named) == 1 else None
    return dict(alone) if isinstance(alone, Mapping) else named


def _shaped(found: Mapping[Any, Any]) -> dict[str, Any]:
    """Return numbers in their own shapes, which texts are read without."""
    named = {key: value for key, value in found.items() if isinstance(key, str) and not key.startswith("__")}
    alone = next(iter(named.values())) if len(named) == 1 else None
    if isinstance(alone, np.ndarray) and alone.dtype.names and alone.size == 1:
        named = {key: alone.ravel()[0][key] for key in alone.dtype.names}
    return {key: value for key, value in named.items() if isinstance(value, np.ndarray) and value.dtype.kind in "fciu"}


def _cells(texts: Sequence[str]) -> np.ndarray:
    cells = np.empty((len(texts), 1), dtype=object)
    cells[:, 0] = texts
    return cells


def _written(variables: Mapping[str, Any]) -> bytes:
    import scipy.io

    memory = io.BytesIO()
    scipy.io.savemat(memory, dict(variables), do_compression=True)
    return memory.getvalue()
