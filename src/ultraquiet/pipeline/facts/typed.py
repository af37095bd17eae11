"""Facts: frozen dataclasses that check their types when they are made, and their one way to JSON and back."""

import math
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, TypeVar, cast, dataclass_transform

import numpy as np
from pydantic import ConfigDict, PlainSerializer, PlainValidator, TypeAdapter, WithJsonSchema
from pydantic.dataclasses import dataclass
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from ultraquiet._base.constraints import FloatArray

T = TypeVar("T")
_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True, ser_json_inf_nan="constants")
# JSON knows no other word for what is not a finite number.
_NUMBER: JsonSchemaValue = {"type": ["number", "null"]}


@dataclass_transform(kw_only_default=True, frozen_default=True)
def fact(kind: type[T]) -> type[T]:
    """Make a class a frozen dataclass, its fields given by keyword and checked; a key it does not know is refused."""
    return cast("type[T]", dataclass(frozen=True, kw_only=True, eq=False, config=_CONFIG)(kind))


def _array_of(dimensions: int) -> Callable[[Any], FloatArray]:
    def checked(value: Any) -> FloatArray:
        array = np.array(value, dtype=np.float64)
        if array.ndim != dimensions:
            raise ValueError(f"it must have {dimensions} dimensions, got shape {array.shape}")
        array.setflags(write=False)
        return array

    return checked


def _plain_array(array: FloatArray) -> list[Any]:
    return array.tolist()


Vector = Annotated[
    FloatArray,
    PlainValidator(_array_of(1)),
    PlainSerializer(_plain_array),
    WithJsonSchema({"type": "array", "items": _NUMBER}),
]
Matrix = Annotated[
    FloatArray,
    PlainValidator(_array_of(2)),
    PlainSerializer(_plain_array),
    WithJsonSchema({"type": "array", "items": {"type": "array", "items": _NUMBER}}),
]


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def to_plain(facts: Any) -> Any:
    """Return facts as JSON's types, their keys in the order of the fields."""
    return _adapter(type(facts)).dump_python(facts, mode="json")


def from_plain(kind: Any, content: Any) -> Any:
    """Read what `to_plain` wrote as facts of a kind, perhaps one of a union.

    Raises:
        ValueError: the content has another shape.
    """
    return _adapter(kind).validate_python(content)


def finite(value: Any) -> Any:
    """Return JSON's types with null for every number that is not finite."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Schema(GenerateJsonSchema):
    def float_schema(self, schema: Any) -> JsonSchemaValue:
        return dict(_NUMBER)


def schema_of(kind: type[Any]) -> dict[str, Any]:
    """Return the JSON schema of `finite(to_plain(...))` of a kind of facts."""
    return _adapter(kind).json_schema(mode="serialization", schema_generator=_Schema)
