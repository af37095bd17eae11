"""Frames: how an append-only log is laid out, so that any damage to it is noticed.

Each frame is a head of 48 bytes, a CRC-32 of it, so that no damaged length is ever believed, a payload, and a CRC-32 of
head and payload. That one leaves the first CRC-32 out: whatever is followed by its own CRC-32 leaves a register that is
the same for all, so a checksum that runs on from there would not know the head any more, and the head of one frame
could stand before the payload of another where a disk gives back a block of a file that was removed. Little endian. The
first frame (kind H) holds JSON that describes the run, those that follow (D) hold samples, channel by channel, and a
last one (E) holds JSON that says how the run ended. Every frame carries the number of its log, drawn by chance, and its
place in it: a block of another log that a disk gives back, one that is missing, doubled or in the wrong place are
noticed as well.
"""

import struct
import zlib
from dataclasses import dataclass
from typing import Any

MAGIC = b"\xf5UQ\n"  # no text begins so, and a transfer that changes line ends shows
VERSION = 2
UNBOUND = 1  # the version before, which is still read: its second checksum does not know the head
HEADER, DATA, END = b"H", b"D", b"E"
SAMPLE = b"<f8\0"  # the one type of samples: what records hold
RUN_BYTES = 8

# magic, kind, version, sequence number, run, sample offset, channels, samples, type of samples, bytes of payload
_HEAD = struct.Struct("<4scB2xI8sQII4sQ")
_CRC = struct.Struct("<I")
HEAD_BYTES = _HEAD.size + _CRC.size


class UnsoundError(Exception):
    """What is wrong with a frame; `torn` when the bytes merely end before it does."""

    def __init__(self, what: str, torn: bool = False) -> None:
        super().__init__(what)
        self.torn = torn


@dataclass(frozen=True)
class LogFrame:
    """One frame; `samples` columns of `channels` rows begin at sample `offset` of the run."""

    kind: bytes
    sequence: int
    run: bytes
    offset: int
    channels: int
    samples: int
    payload: bytes | memoryview

    def packed(self) -> bytes:
        """Return the bytes of the frame.

        >>> frame = LogFrame(DATA, 3, b"abcdefgh", 175, 1, 2, bytes(16))
        >>> frame_at(frame.packed(), 0) == frame, len(frame.packed())
        (True, 72)
        """
        place = (self.sequence, self.run, self.offset, self.channels, self.samples, SAMPLE, len(self.payload))
        head = _HEAD.pack(MAGIC, self.kind, VERSION, *place)
        check = zlib.crc32(head)
        return b"".join((head, _CRC.pack(check), self.payload, _CRC.pack(zlib.crc32(self.payload, check))))

    @property
    def size(self) -> int:
        """Number of bytes of the frame."""
        return HEAD_BYTES + len(self.payload) + _CRC.size


def frame_at(data: bytes | memoryview, at: int) -> LogFrame:
    """Return the frame that begins at byte `at`, its payload a view of `data`.

    Raises:
        UnsoundError: the bytes there are no whole and undamaged frame.
    """
    view = memoryview(data)[at:]
    if len(view) < HEAD_BYTES:
        raise UnsoundError("it is cut short", torn=True)
    if _CRC.unpack_from(view, _HEAD.size)[0] != zlib.crc32(view[: _HEAD.size]):
        raise UnsoundError("its head does not match its checksum")
    magic, kind, version, sequence, run, offset, channels, samples, sort, size = _HEAD.unpack_from(view)
    if magic != MAGIC or version not in (UNBOUND, VERSION) or sort != SAMPLE:
        raise UnsoundError(f"it is of a format (version {version}) that this version of ultraquiet does not read")
    end = HEAD_BYTES + size
    if len(view) < end + _CRC.size:
        raise UnsoundError("it is cut short", torn=True)
    begun = zlib.crc32(view[: HEAD_BYTES if version == UNBOUND else _HEAD.size])
    if _CRC.unpack_from(view, end)[0] != zlib.crc32(view[HEAD_BYTES:end], begun):
        raise UnsoundError("it does not match its checksum")
    return LogFrame(kind, sequence, run, offset, channels, samples, view[HEAD_BYTES:end])


def __getattr__(name: str) -> Any:
    if name == "Frame":  # its name until 0.1
        return LogFrame
    raise AttributeError(f"module 'ultraquiet.files.frames' has no attribute {name!r}")
