"""What a log holds: every sound block up to the first unsound one, and the record that is made of them."""

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, frozen
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.regular import parse_json, read_regular
from ultraquiet.files.archive import load, save
from ultraquiet.files.atomic import name_taken, reason, sync_folder
from ultraquiet.files.channel_rows import from_rows
from ultraquiet.files.frames import DATA, END, HEADER, LogFrame, UnsoundError, frame_at
from ultraquiet.values import Record

_Path = str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Log:
    """The sound content of a log.

    Args:
        header: what the writer was given.
        samples: `(channels, n)`, exactly as appended, without gaps from the first sample on.
        ended: the log says itself how the run ended; False after a kill, a power cut or a failing disk.
        reason: why the run is not complete, or the log not sound, in a sentence; empty for a complete run.
        lost_bytes: bytes behind the last sound block, of which nothing is used.
        damaged: these bytes are not merely a block cut short: something has changed them.
        complete: the run came to its end, and every sample of it is here.
        notes: what the writer added at the end.
    """

    header: dict[str, Any]
    samples: FloatArray
    ended: bool
    reason: str
    lost_bytes: int
    damaged: bool = False
    complete: bool = False
    notes: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def record(self) -> Record:
        """Return the samples as a record; the provenance of an incomplete one says `partial`, how much and why.

        Raises:
            InputError: no samples, or a header that `log_header` did not make.
        """
        try:
            rows = from_rows(self.header["channels"])
            inputs, rate_hz = _planned(self.header)
            provenance = Provenance.from_json(json.dumps(self.header["provenance"]))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"log: its header describes no record ({reason(error)}).") from None
        settings = dict(provenance.settings)
        for key, note in self.notes.items():
            setting = settings.get(key)
            settings[key] = {**setting, **note} if isinstance(setting, dict) and isinstance(note, dict) else note
        if not self.complete:
            planned = self.header.get("samples")
            settings["partial"] = {"samples": self.samples.shape[1], "of": planned, "reason": self.reason}
        provenance = replace(provenance, settings=settings)
        return Record(self.samples[:inputs], self.samples[inputs:], rate_hz, rows[:inputs], rows[inputs:], provenance)


def read_log(path: _Path) -> Log:
    """Read every sound block of a log, up to the first that is cut short, damaged, missing or out of place.

    Raises:
        StorageError: the file cannot be read, or its header is damaged.
    """
    try:
        data = memoryview(read_regular(path))
    except OSError as error:
        raise StorageError(f"log: '{path}' cannot be read ({reason(error)}).") from error
    try:
        first = frame_at(data, 0)
        header = _header(first) if first.kind == HEADER else None
    except UnsoundError as error:
        raise StorageError(f"log: '{path}' has no sound header: {error}.") from None
    except (ValueError, KeyError, TypeError) as error:
        raise StorageError(f"log: the header of '{path}' is none that a writer makes ({reason(error)}).") from None
    if header is None or first.sequence:
        raise StorageError(f"log: '{path}' does not begin with a header.")
    return _Reading(data, first).log(header)


def _header(frame: LogFrame) -> dict[str, Any]:
    """Return the header, whose checksum says that it is whole, not who wrote it.

    Raises:
        ValueError, KeyError: it does not describe the rows of the log.
    """
    header = parse_json(bytes(frame.payload))
    if not isinstance(header, dict) or not isinstance(header["channels"], list):
        raise ValueError("it names no channels")
    if len(header["channels"]) != frame.channels:
        raise ValueError(f"it names {len(header['channels'])} channels of {frame.channels}")
    return header


def _planned(header: Mapping[str, Any]) -> tuple[int, float]:
    """Return how many rows are inputs, and the rate."""
    inputs, rate_hz = header["inputs"], header["rate_hz"]
    if not isinstance(inputs, int) or isinstance(inputs, bool) or not 0 < inputs < len(header["channels"]):
        raise ValueError(f"{inputs!r:.40} of its {len(header['channels'])} channels are inputs")
    if not isinstance(rate_hz, int | float) or isinstance(rate_hz, bool) or not 0 < rate_hz <= sys.float_info.max:
        raise ValueError(f"its rate is {rate_hz!r:.40}")
    return inputs, float(rate_hz)


def finalise(path: _Path, record_path: _Path, overwrite: bool = False) -> Record:
    """Turn a log into an archive of its record, then remove the log; killed in between, it can be called again.

    Args:
        path: the log. A damaged one is not removed but takes the suffix `.damaged`.
        record_path: the archive; it appears whole.
        overwrite: False refuses a name that is taken by another record.

    Returns:
        The record, also when an earlier call had already made it.

    Raises:
        StorageError: log or record cannot be read or written, the name is taken; the log is still there then.
        InputError: no samples, or a header that `log_header` did not make.
    """
    if not os.path.lexists(path) and os.path.lexists(record_path):
        return load(record_path)
    log = read_log(path)
    record = log.record()
    # A kill may have come between the archive and the removal of the log.
    if overwrite or not _is_there(record, record_path):
        save(record, record_path, overwrite)
    try:
        if log.damaged:
            Path(path).replace(f"{os.fspath(path)}.damaged")
        else:
            Path(path).unlink()
        sync_folder(Path(path).parent)
    except OSError as error:
        raise StorageError(f"log: '{path}' cannot be removed ({reason(error)}); '{record_path}' is whole.") from error
    return record


class _Reading:
    """One pass over the blocks behind a header."""

    def __init__(self, data: memoryview, first: LogFrame) -> None:
        self._data, self._first = data, first
        self._at, self._sequence, self._samples = first.size, 1, 0
        self._blocks: list[FloatArray] = []
        self._digest = hashlib.sha256()
        self._end: dict[str, Any] | None = None
        self._problem: UnsoundError | None = None
        try:
            while self._at < len(data):
                self._take(frame_at(data, self._at))
        except UnsoundError as error:
            self._problem = error

    def log(self, header: dict[str, Any]) -> Log:
        """Return what was found."""
        samples = np.concatenate(self._blocks, axis=1) if self._blocks else np.zeros((self._first.channels, 0))
        samples = frozen(samples)
        lost = len(self._data) - self._at
        damaged = self._problem is not None and (self._end is not None or not self._problem.torn)
        ended = self._end is not None
        end = self._end or {"complete": False, "reason": "", "notes": {}}
        complete = end["complete"] and not damaged
        why = [self._unsound(lost)] if self._problem else []
        if not ended and not why:
            why = [
                f"the log stops after {self._samples} samples without an end: the process was killed or its disk failed"
            ]
        why = [end["reason"]] * bool(end["reason"]) + why
        return Log(header, samples, ended, "; ".join(why), lost, damaged, complete, end["notes"])

    def _unsound(self, lost: int) -> str:
        consequence = f"{self._samples} samples before it are sound, {lost} bytes from it on are dropped"
        return f"the block at byte {self._at} is unsound ({self._problem}); {consequence}"

    def _take(self, frame: LogFrame) -> None:
        if self._end is not None:
            raise UnsoundError("it stands behind the end")
        place = (frame.run, frame.sequence, frame.offset, frame.channels)
        if place != (self._first.run, self._sequence, self._samples, self._first.channels):
            raise UnsoundError("it is not the one that belongs here")
        if frame.kind == DATA:
            self._take_samples(frame)
        elif frame.kind == END:
            self._take_end(frame)
        else:
            raise UnsoundError("it is of no known kind")
        self._at += frame.size
        self._sequence += 1

    def _take_samples(self, frame: LogFrame) -> None:
        if len(frame.payload) != 8 * frame.channels * frame.samples or not frame.samples:
            raise UnsoundError("its size does not fit its samples")
        self._blocks.append(np.frombuffer(frame.payload, "<f8").reshape(frame.channels, frame.samples))
        self._digest.update(frame.payload)
        self._samples += frame.samples

    def _take_end(self, frame: LogFrame) -> None:
        try:
            end = parse_json(bytes(frame.payload))
            told = end["samples"], end["sha256"]
            said = isinstance(end["complete"], bool), isinstance(end["reason"], str), isinstance(end["notes"], dict)
        except (ValueError, KeyError, TypeError):
            raise UnsoundError("it is no end that a writer makes") from None
        if not all(said):
            raise UnsoundError("it is no end that a writer makes")
        if told != (self._samples, self._digest.hexdigest()):
            raise UnsoundError("it does not agree with the samples before it")
        self._end = end


def _is_there(record: Record, path: _Path) -> bool:
    """Return whether a file holds this very record; refuse when it holds something else."""
    if not os.path.lexists(path):
        return False
    with contextlib.suppress(StorageError):
        stored = load(path)
        same = isinstance(stored, Record) and stored.hash == record.hash
        if same and stored.provenance.to_json() == record.provenance.to_json():
            return True
    raise name_taken(path)
