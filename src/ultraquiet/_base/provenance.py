"""Where a value comes from: settings, seed, content hashes of its parents and the versions that made it."""

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from functools import cache
from importlib import metadata
from typing import Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.regular import parse_json

T = TypeVar("T")
VERSIONED = ("ultraquiet", "numpy", "scipy", "numba")


@dataclass(frozen=True)
class Provenance:
    """How a value was made.

    `made_by` names the method, `settings` are its plain settings, `seed` what its random draws started from,
    `parents` the content hashes of the values it was made from.
    """

    made_by: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    seed: int | None = None
    parents: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict[str, str])

    def to_json(self) -> str:
        """Return the provenance as one JSON text."""
        return json.dumps(asdict(self), sort_keys=True, default=plain)

    @classmethod
    def from_json(cls, text: str) -> "Provenance":
        """Read what `to_json` wrote.

        Raises:
            ValueError: what no provenance says, however well it is written.
        """
        content = parse_json(text)
        if not isinstance(content, dict):
            raise ValueError("its provenance is no table")
        stated = cast("dict[str, Any]", content)
        if not set(stated) <= set(_KINDS) or not all(isinstance(stated[key], _KINDS[key]) for key in stated):
            raise ValueError("its provenance says what no provenance says")
        texts = [*stated.get("parents", ()), *stated.get("versions", {}).values()]
        if not all(isinstance(each, str) for each in texts):
            raise ValueError("its provenance names parents or versions that are no texts")
        stated["parents"] = tuple(stated.get("parents", ()))
        return cls(**stated)


_KINDS: Mapping[str, Any] = {
    "made_by": str,
    "settings": dict,
    "seed": int | None,
    "parents": list,
    "versions": dict,
}


def versions() -> dict[str, str]:
    """Return the versions that decide a number: this package, its numerical libraries and Python."""
    return dict(_versions())


@cache
def _versions() -> Mapping[str, str]:
    # Asked for by every value that is made, and slow: the metadata of four packages are parsed.
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in VERSIONED}}


def plain(value: Any) -> Any:
    """Turn settings into JSON's types: dataclasses to mappings, arrays to lists."""
    if is_dataclass(value) and not isinstance(value, type):
        return {"type": type(value).__name__, **asdict(value)}
    if isinstance(value, np.ndarray):
        return cast("NDArray[Any]", value).tolist()
    if isinstance(value, np.generic):
        return cast("np.generic[Any]", value).item()
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, set | frozenset):
        return sorted(cast("set[Any] | frozenset[Any]", value))
    return str(value)


def content_hash(*parts: Any) -> str:
    """Return a SHA-256 over arrays (dtype, shape, bytes) and plain settings; equal content, equal hash.

    >>> content_hash([1, 2]) == content_hash([1, 2])
    True
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            array = cast("NDArray[Any]", part)
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        else:
            digest.update(json.dumps(part, sort_keys=True, default=plain).encode())
        digest.update(b"\0")
    return digest.hexdigest()


class ByContents(Generic[T]):
    """A value that equals another one of the same contents: what a cache is asked with.

    Args:
        value: anything.
        contents: its content hash.

    >>> ByContents([1, 2], content_hash([1, 2])) == ByContents((1, 2), content_hash([1, 2]))
    True
    """

    def __init__(self, value: T, contents: str) -> None:
        self.value = value
        self._contents = contents

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ByContents) and self._contents == cast("ByContents[Any]", other)._contents

    def __hash__(self) -> int:
        return hash(self._contents)
