"""Values as trees of arrays and texts, and back: what an archive holds of each kind of value."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.files.channel_rows import channel_rows, from_rows
from ultraquiet.values import (
    FrequencyResponse,
    InnovationForm,
    PolynomialMatrix,
    PolynomialModel,
    Record,
    StateSpace,
    Status,
)

Tree = dict[str, Any]
Value = Record | StateSpace | FrequencyResponse | PolynomialModel | PolynomialMatrix | Status


@dataclass(frozen=True)
class Kind:
    """How one class of values is taken apart and put together."""

    cls: type[Any]
    pack: Callable[[Any], Tree]
    unpack: Callable[[Tree], Any]


def pack(value: Value) -> tuple[str, Tree]:
    """Return the kind's name and the tree of a value.

    >>> pack(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]]))[0]
    'state-space'
    """
    for name, kind in KINDS.items():
        if isinstance(value, kind.cls):
            return name, kind.pack(value)
    raise InputError(f"archive: cannot hold a {type(value).__name__}; it holds {', '.join(KINDS)}.")


def unpack(kind: str, tree: Tree) -> Value:
    """Return the value that `pack` took apart."""
    if kind not in KINDS:
        raise InputError(f"archive: '{kind}' is no kind of value; known are {', '.join(KINDS)}.")
    return KINDS[kind].unpack(tree)


def _named_out(value: Any) -> Tree:
    return {
        "actuators": json.dumps(channel_rows(value.actuators), allow_nan=False),
        "sensors": json.dumps(channel_rows(value.sensors), allow_nan=False),
        "provenance": value.provenance.to_json(),
    }


def _named_in(tree: Tree) -> dict[str, Any]:
    return {
        "actuators": from_rows(json.loads(tree["actuators"])),
        "sensors": from_rows(json.loads(tree["sensors"])),
        "provenance": Provenance.from_json(tree["provenance"]),
    }


def _number(value: float) -> NDArray[np.float64]:
    return np.array(value, dtype=np.float64)


def _rate_out(rate_hz: float | None) -> Tree:
    return {} if rate_hz is None else {"rate_hz": _number(rate_hz)}


def _rate_in(tree: Tree) -> float | None:
    return float(tree["rate_hz"]) if "rate_hz" in tree else None


def _record_out(record: Record) -> Tree:
    return {"inputs": record.inputs, "outputs": record.outputs, **_rate_out(record.rate_hz), **_named_out(record)}


def _record_in(tree: Tree) -> Record:
    return Record(tree["inputs"], tree["outputs"], float(tree["rate_hz"]), **_named_in(tree))


def _state_space_out(system: StateSpace) -> Tree:
    matrices = {"A": system.A, "B": system.B, "C": system.C, "D": system.D}
    return {**matrices, **_rate_out(system.rate_hz), **_named_out(system)}


def _state_space_in(tree: Tree) -> StateSpace:
    return StateSpace(*(tree[k] for k in "ABCD"), rate_hz=_rate_in(tree), **_named_in(tree))


def _innovation_form_out(system: InnovationForm) -> Tree:
    return {**_state_space_out(system), "K": system.K, "noise_covariance": system.noise_covariance}


def _innovation_form_in(tree: Tree) -> InnovationForm:
    matrices = (tree[k] for k in ("A", "B", "C", "D", "K", "noise_covariance"))
    return InnovationForm(*matrices, rate_hz=float(tree["rate_hz"]), **_named_in(tree))


def _response_out(response: FrequencyResponse) -> Tree:
    known = {"coherence": response.coherence, "variance": response.variance}
    quality = {name: array for name, array in known.items() if array is not None}
    return {
        "f_hz": response.f_hz,
        "values": response.values,
        "estimator": json.dumps(response.estimator),
        **quality,
        **_named_out(response),
    }


def _response_in(tree: Tree) -> FrequencyResponse:
    return FrequencyResponse(
        tree["f_hz"],
        tree["values"],
        tree.get("coherence"),
        json.loads(tree["estimator"]),
        variance=tree.get("variance"),
        **_named_in(tree),
    )


def _list_out(items: Sequence[Any]) -> Tree:
    return {str(i): item for i, item in enumerate(items)}


def _list_in(tree: Tree) -> list[Any]:
    return [tree[str(i)] for i in range(len(tree))]


def _polynomials_out(model: PolynomialModel) -> Tree:
    return {
        "b": _list_out(model.b),
        "f": _list_out(model.f),
        "a": model.a,
        "c": model.c,
        "d": model.d,
        "rate_hz": _number(model.rate_hz),
        "noise_variance": _number(model.noise_variance),
    }


def _polynomials_in(tree: Tree) -> PolynomialModel:
    b: list[ArrayLike] = _list_in(tree["b"])
    f: list[ArrayLike] = _list_in(tree["f"])
    noise = {key: tree[key] for key in "acd"}
    return PolynomialModel(b, f, float(tree["rate_hz"]), **noise, noise_variance=float(tree["noise_variance"]))


def _matrix_out(matrix: PolynomialMatrix) -> Tree:
    rows = _list_out([_list_out([_polynomials_out(m) for m in row]) for row in matrix.rows])
    return {"rows": rows, **_named_out(matrix)}


def _matrix_in(tree: Tree) -> PolynomialMatrix:
    rows = [[_polynomials_in(m) for m in _list_in(row)] for row in _list_in(tree["rows"])]
    return PolynomialMatrix(rows, **_named_in(tree))


def _status_out(status: Status) -> Tree:
    return {"word": json.dumps(status.word), "sentence": json.dumps(status.sentence)}


def _status_in(tree: Tree) -> Status:
    return Status(json.loads(tree["word"]), json.loads(tree["sentence"]))


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "record": Kind(Record, _record_out, _record_in),
        # before the class it is one of
        "innovation-form": Kind(InnovationForm, _innovation_form_out, _innovation_form_in),
        "state-space": Kind(StateSpace, _state_space_out, _state_space_in),
        "frequency-response": Kind(FrequencyResponse, _response_out, _response_in),
        "polynomial-model": Kind(PolynomialModel, _polynomials_out, _polynomials_in),
        "polynomial-matrix": Kind(PolynomialMatrix, _matrix_out, _matrix_in),
        "status": Kind(Status, _status_out, _status_in),
    }
)
