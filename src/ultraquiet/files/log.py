"""Logs: the samples of a run written down while it runs, readable after a kill or a power cut at any instant."""

import contextlib
import hashlib
import json
import os
import secrets
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, real_array
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import Provenance, plain
from ultraquiet.files.atomic import reason, write_bytes
from ultraquiet.files.channel_rows import channel_rows
from ultraquiet.files.frames import DATA, END, HEADER, RUN_BYTES, LogFrame
from ultraquiet.values import Channel

SYNC_S = 0.1  # what a power cut may cost, and one block; a disk syncs some hundred times a second, and idles so
EARLY = 0.1  # of it: a block that comes a little early is not left for the next one to take to the disk
FRAME_SAMPLES = 1024  # longer blocks are cut, so that a disk that is full keeps what it can of one long block

_Path = str | os.PathLike[str]


def log_header(
    actuators: Sequence[Channel], sensors: Sequence[Channel], rate_hz: float, samples: int, provenance: Provenance
) -> dict[str, Any]:
    """Return the header of a log whose rows are the commands of `actuators`, then the readings of `sensors`.

    Args:
        actuators: `nu` channels with units and limits.
        sensors: `ny` channels.
        rate_hz: samples per second.
        samples: how many the whole run is to have.
        provenance: how the run is made; its settings hold the hashes of list and measurement.

    >>> header = log_header([Channel("force", "N")], [Channel("speed")], 3500.0, 4096, Provenance())
    >>> header["channels"][0], header["inputs"]
    (['force', 'N', None, None], 1)
    """
    rows = channel_rows((*actuators, *sensors))
    origin = json.loads(provenance.to_json())
    return {"channels": rows, "inputs": len(actuators), "rate_hz": rate_hz, "samples": samples, "provenance": origin}


class _Written(NamedTuple):
    """How far a log is sound; replaced as a whole, so that an interrupt finds the old or the new."""

    size: int
    sequence: int
    samples: int
    digest: Any


class LogWriter:
    """An append-only log of the samples of one run.

    A block that `append` took survives a kill of this process; at most `SYNC_S` and one block later it survives a
    power cut. Leaving the `with` without `close` ends the log as aborted.

    Args:
        path: the log, a name that is free.
        header: plain data that describes the run, as `log_header` makes it; `channels` says how many rows there are.

    Raises:
        InputError: no channels, or a header that JSON cannot hold.
        StorageError: the name is taken, the disk is full or gone. Blocks that were appended before stay readable.

    >>> import tempfile
    >>> from ultraquiet.files import read_log
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "push.log"
    ...     with LogWriter(path, {"channels": ["force", "speed"]}) as log:
    ...         log.append([[1.0, 2.0, 3.0], [0.0, 0.1, 0.2]])
    ...         log.close(complete=True)
    ...     read_log(path).samples
    array([[1. , 2. , 3. ],
           [0. , 0.1, 0.2]])
    """

    def __init__(self, path: _Path, header: Mapping[str, Any]) -> None:
        channels = header.get("channels")
        if not isinstance(channels, list | tuple) or not channels:
            raise InputError("LogWriter: the header must name the 'channels'.")
        try:
            text = json.dumps(header, sort_keys=True, default=plain, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise InputError(f"LogWriter: the header must be plain data ({reason(error)}).") from None
        self.path = Path(path)
        self._channels = len(channels)
        self._run = secrets.token_bytes(RUN_BYTES)
        self._failure = ""
        first = LogFrame(HEADER, 0, self._run, 0, self._channels, 0, text).packed()
        # A log appears with its whole header or not at all, so there is no log that cannot be read.
        write_bytes(self.path, first, overwrite=False)
        try:
            self._handle: int | None = os.open(self.path, os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0))
        except OSError as error:
            raise StorageError(f"log: '{self.path}' cannot be opened ({reason(error)}).") from error
        self._written = _Written(len(first), 1, 0, hashlib.sha256())
        self._synced_s = time.monotonic()

    @property
    def samples(self) -> int:
        """Number of samples written so far."""
        return self._written.samples

    def append(self, block: ArrayLike) -> None:
        """Write a block `(channels, m)`; when this returns, a kill of this process cannot take it any more.

        Raises:
            InputError: another number of channels, NaN or infinite samples; nothing is written then.
            StorageError: the disk is full or gone; the log ends with the block before.
        """
        rows = real_array("LogWriter.append", "block", block, 2)
        if len(rows) != self._channels:
            raise InputError(f"LogWriter.append: 'block' must have {self._channels} rows, got shape {rows.shape}.")
        for start in range(0, rows.shape[1], FRAME_SAMPLES):
            self._put(DATA, rows[:, start : start + FRAME_SAMPLES])
        if time.monotonic() - self._synced_s >= (1.0 - EARLY) * SYNC_S:
            self._sync()

    def close(self, complete: bool = True, reason: str = "", notes: Mapping[str, Any] | None = None) -> None:
        """End the log and wait until the disk has it; closing twice does nothing.

        Args:
            complete: whether the run came to its end.
            reason: why it did not, in a sentence.
            notes: what is known only now; goes into the settings of the record's provenance.

        Raises:
            StorageError: the disk is full or gone, now or before; what was written before stays.
        """
        if self._handle is None:
            return
        try:
            if not self._failure:
                end = {
                    "samples": self.samples,
                    "sha256": self._written.digest.hexdigest(),
                    "complete": complete,
                    "reason": "" if complete else reason or "the run was broken off",
                    "notes": dict(notes or {}),
                }
                self._put(END, json.dumps(end, sort_keys=True, default=plain).encode())
                self._sync()
            elif complete:
                raise StorageError(self._failure)
        finally:
            handle, self._handle = self._handle, None
            os.close(handle)

    def _put(self, kind: bytes, content: FloatArray | bytes) -> None:
        if self._handle is None or self._failure:
            raise StorageError(self._failure or f"log: '{self.path}' is closed.")
        payload = content if isinstance(content, bytes) else content.astype("<f8").tobytes()
        columns = 0 if isinstance(content, bytes) else content.shape[1]
        size, sequence, samples, digest = self._written
        frame = LogFrame(kind, sequence, self._run, samples, self._channels, columns, payload).packed()
        digest = digest.copy()
        if kind == DATA:
            digest.update(payload)
        try:
            rest = memoryview(frame)
            while rest:
                rest = rest[os.write(self._handle, rest) :]
            self._written = _Written(size + len(frame), sequence + 1, samples + columns, digest)
        except BaseException as error:
            # Also after an interrupt: behind half a frame nothing could be read.
            with contextlib.suppress(OSError):
                os.ftruncate(self._handle, self._written.size)
            if isinstance(error, OSError):
                raise self._failed("written", error) from error
            raise

    def _sync(self) -> None:
        assert self._handle is not None
        try:
            getattr(os, "fdatasync", os.fsync)(self._handle)
        except OSError as error:
            # Not tried again: a second sync may succeed without having written what the first one lost.
            raise self._failed("forced to the disk", error) from error
        self._synced_s = time.monotonic()

    def _failed(self, what: str, error: OSError) -> StorageError:
        self._failure = (
            f"log: '{self.path}' could not be {what} ({reason(error)}); {self.samples} samples before are in it."
        )
        return StorageError(self._failure)

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close(complete=False, reason="its writer left it without closing it")
            return
        # What ended the run is what must be told, not that its log could not be ended either.
        with contextlib.suppress(StorageError):
            words = " ".join(str(error).split())[:500]
            self.close(complete=False, reason=f"{type(error).__name__}: {words}" if words else type(error).__name__)
