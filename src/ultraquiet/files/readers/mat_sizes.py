"""What the variables of a MAT file of version 5 say they unpack into, before SciPy unpacks anything.

Layout: "MAT-File Format", MathWorks: a head of 128 bytes, then elements, each a type and a number of bytes; a
compressed element holds one whole element, whose own head says what it comes to.
"""

import struct
import zlib

from ultraquiet._base.errors import StorageError

HEAD_BYTES = 128
TAG_BYTES = 8
COMPRESSED, MATRIX = 15, 14
ORDERS = {b"IM": "<", b"MI": ">"}
FLOAT_BYTES = 8  # what one byte, the smallest sample, may become


def declared_bytes(name: str, data: bytes) -> int:
    """Return how many bytes all variables together say they come to, unpacked; 0 for a file of another version.

    Raises:
        StorageError: an element that ends behind the end of the file.
    """
    order = ORDERS.get(data[126:HEAD_BYTES])
    if order is None or data[124:126] not in (b"\0\1", b"\1\0"):
        return 0
    at, total = HEAD_BYTES, 0
    while at + TAG_BYTES <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        at += TAG_BYTES
        if at + size > len(data):
            raise StorageError(f"read_record: '{name}' was cut short, or is damaged: an element ends behind its end.")
        total += _unpacked(data, at, size, order) if kind == COMPRESSED else size
        at += size
    return total


def _unpacked(data: bytes, at: int, size: int, order: str) -> int:
    """Return what the element within a compressed one says; what does not fit it is found when it is unpacked."""
    try:
        head = zlib.decompressobj().decompress(data[at : at + min(size, 4096)], TAG_BYTES)
    except zlib.error:
        return 0  # SciPy says what is wrong
    return struct.unpack(f"{order}II", head)[1] if len(head) == TAG_BYTES else 0
