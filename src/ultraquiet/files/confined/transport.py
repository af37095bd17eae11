"""Plain trees of numbers, texts and arrays through a file descriptor: nothing in them can run when they are read."""

import json
import mmap
import os
import re
import struct
from typing import Any

import numpy as np

_HEAD = struct.Struct("<QQ")  # bytes of the text, bytes of the arrays behind it
_ALIGN = 64
_DTYPE = re.compile(r"[<>|=][fiucbUS]\d{1,9}")
_CHUNK_BYTES = 1 << 28


def send(handle: int, tree: Any) -> None:
    """Write a tree of dicts with text keys, lists, tuples, None, texts, numbers and plain arrays."""
    arrays: list[np.ndarray] = []
    text = json.dumps(_marked(tree, arrays)).encode()
    starts = np.cumsum([0, *(-(-a.nbytes // _ALIGN) * _ALIGN for a in arrays)])
    _put(handle, _HEAD.pack(len(text), int(starts[-1])) + text)
    first = -(-(_HEAD.size + len(text)) // _ALIGN) * _ALIGN
    for start, array in zip(starts.tolist(), arrays, strict=False):
        os.lseek(handle, first + start, os.SEEK_SET)
        _put(handle, np.ascontiguousarray(array).reshape(-1).view(np.uint8).data if array.size else b"")
    os.ftruncate(handle, first + int(starts[-1]))


def receive(handle: int) -> Any:
    """Return the tree that `send` wrote; its arrays lie in a private image of the file.

    Raises:
        ValueError: what is there is no such tree.
    """
    size = os.fstat(handle).st_size
    if size < _HEAD.size:
        raise ValueError("nothing was delivered")
    image = mmap.mmap(handle, size, access=mmap.ACCESS_COPY)
    length, behind = _HEAD.unpack_from(image)
    first = -(-(_HEAD.size + length) // _ALIGN) * _ALIGN
    if first + behind != size:
        raise ValueError("what was delivered is cut short")
    try:
        return _unmarked(json.loads(image[_HEAD.size : _HEAD.size + length]), image, first)
    except (KeyError, TypeError, RecursionError) as error:
        raise ValueError("what was delivered is no tree") from error


def _put(handle: int, data: Any) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(handle, rest[:_CHUNK_BYTES]) :]


def _marked(item: Any, arrays: list[np.ndarray]) -> Any:
    """Return what JSON can hold of an item: lists that begin with a mark."""
    if isinstance(item, dict):
        return ["d", {str(key): _marked(value, arrays) for key, value in item.items()}]
    if isinstance(item, list | tuple):
        return ["t" if isinstance(item, tuple) else "l", *(_marked(value, arrays) for value in item)]
    if isinstance(item, np.ndarray):
        if not _DTYPE.fullmatch(item.dtype.str):
            raise TypeError(f"an array of {item.dtype} is no plain array")
        at = sum(-(-a.nbytes // _ALIGN) * _ALIGN for a in arrays)
        arrays.append(item)
        return ["a", item.dtype.str, list(item.shape), at]
    if isinstance(item, np.generic):
        item = item.item()
    if isinstance(item, complex):
        return ["c", item.real, item.imag]
    if item is None or isinstance(item, bool | int | float | str):
        return item
    raise TypeError(f"a {type(item).__name__} is nothing plain")


def _unmarked(item: Any, image: mmap.mmap, first: int) -> Any:
    if not isinstance(item, list):
        return item
    mark, *rest = item
    if mark == "d":
        return {key: _unmarked(value, image, first) for key, value in rest[0].items()}
    if mark in ("l", "t"):
        values = [_unmarked(value, image, first) for value in rest]
        return tuple(values) if mark == "t" else values
    if mark == "c":
        return complex(*rest)
    dtype, shape, at = rest
    if mark != "a" or not _DTYPE.fullmatch(dtype):
        raise ValueError("an item of no known kind was delivered")
    count = int(np.prod(shape, dtype=np.int64))
    return np.frombuffer(image, dtype, count, first + at).reshape(shape)
