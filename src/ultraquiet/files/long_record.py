"""Records longer than memory: HDF5 files of chunked samples, read block by block."""

import math
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, whole
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.regular import check_regular, parse_json
from ultraquiet.files.atomic import reason
from ultraquiet.files.channel_rows import from_rows
from ultraquiet.values import Channel, Record
from ultraquiet.values.channel import channels
from ultraquiet.values.joined.wires import places

FORMAT = "ultraquiet-long"
CHUNK_SAMPLES = 65_536  # of one channel: 256 kB of float32, a size that disks and HDF5's cache take at once
BLOCK_SAMPLES = CHUNK_SAMPLES
SAMPLED_BLOCKS = 8  # blocks that a fingerprint looks at

_Path = str | os.PathLike[str]


@dataclass(frozen=True, init=False, eq=False)
class LongRecord:
    """A record on disk, of any length: the wires of a `Record`, its samples read in blocks.

    Args:
        path: an HDF5 file; one of `LongWriter` needs no more.
        inputs, outputs: names of the datasets, `(channel, sample)` or `(sample, channel)`; the longer axis is time.
        rate_hz: samples per second, when the file does not say (attribute `rate_hz`).

    Raises:
        StorageError: a file that is missing, foreign, cut short or damaged, also when that shows only while reading.
        InputError: datasets of unequal length, no rate.

    >>> import tempfile
    >>> from ultraquiet.files import LongWriter
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with LongWriter(Path(folder) / "hour.h5", rate_hz=3500.0, inputs=1, outputs=2) as file:
    ...         for block in range(3):
    ...             file.append(np.ones((1, 1000)), np.zeros((2, 1000)))
    ...     record = LongRecord(Path(folder) / "hour.h5")
    ...     record.samples, [u.shape[1] for u, y in record.blocks(2000)]
    (3000, [2000, 1000])
    """

    path: Path
    rate_hz: float
    samples: int
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    _places: tuple[str, str] = field(repr=False)
    _rows: tuple[tuple[int, ...], tuple[int, ...]] = field(repr=False)
    _ours: bool = field(repr=False)  # of `LongWriter`, whose samples go along a row however few they are

    def __init__(
        self, path: _Path, inputs: str = "inputs", outputs: str = "outputs", rate_hz: float | None = None
    ) -> None:
        put = object.__setattr__
        if not isinstance(path, str | os.PathLike):
            raise InputError(f"LongRecord: 'path' must be the name of a file, got {path!r}.")
        put(self, "path", Path(path))
        for name, place in (("inputs", inputs), ("outputs", outputs)):
            if not isinstance(place, str):
                raise InputError(f"LongRecord: '{name}' must be the name of a dataset, got {place!r}.")
        put(self, "_places", (inputs, outputs))
        with _opened(self.path) as file:
            attributes = dict(file.attrs)
            put(self, "_ours", attributes.get("format") == FORMAT)
            shapes = [_shape(self.path, file, name, self._ours) for name in self._places]
        rate_hz = attributes.get("rate_hz") if rate_hz is None else rate_hz
        if isinstance(rate_hz, np.ndarray) and rate_hz.size == 1:  # some programs know no attribute but arrays
            rate_hz = rate_hz.item()
        if rate_hz is None:
            raise InputError(f"LongRecord: '{self.path}' does not say its rate; give rate_hz.")
        put(self, "rate_hz", positive("LongRecord", "rate_hz", rate_hz, "Hz"))
        if shapes[0][1] != shapes[1][1]:
            raise InputError(f"LongRecord: inputs have {shapes[0][1]} samples but outputs have {shapes[1][1]}.")
        put(self, "samples", shapes[0][1])
        if self._ours and attributes.get("samples") != self.samples:
            raise StorageError(f"LongRecord: '{self.path}' was not finished: its writer stopped before the end.")
        named = _named(self.path, attributes.get("channels"))
        for kind, name, (count, _), declared in zip(
            ("actuators", "sensors"), ("input", "output"), shapes, named, strict=True
        ):
            put(self, kind, channels("LongRecord", declared, count, name))
        put(self, "_rows", (tuple(range(shapes[0][0])), tuple(range(shapes[1][0]))))

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return self.samples / self.rate_hz

    @property
    def hash(self) -> str:
        """Fingerprint of header, length and a few blocks spread over the file: a whole hash would cost a pass."""
        starts = sorted({int(s) for s in np.linspace(0, max(0, self.samples - CHUNK_SAMPLES), SAMPLED_BLOCKS)})
        parts = [a for s in starts for a in self.read(s, min(self.samples, s + CHUNK_SAMPLES // SAMPLED_BLOCKS))]
        return content_hash(self.rate_hz, self.samples, list(self._rows), *parts)

    def pick(
        self, inputs: Sequence[int | str] | None = None, outputs: Sequence[int | str] | None = None
    ) -> "LongRecord":
        """Return some input and output channels, by index from 0 or by name; all of a side when absent.

        The others are not read.

        Raises:
            InputError: no such channel, or none of a side.
        """
        chosen: list[list[int]] = []
        for name, given, wires in (("inputs", inputs, self.actuators), ("outputs", outputs, self.sensors)):
            chosen.append(places("LongRecord.pick", given, wires))
            if not chosen[-1]:
                raise InputError(f"LongRecord.pick: '{name}' must name at least one channel, got none.")
        picked = object.__new__(LongRecord)
        for key, value in self.__dict__.items():
            object.__setattr__(picked, key, value)
        object.__setattr__(picked, "actuators", tuple(self.actuators[k] for k in chosen[0]))
        object.__setattr__(picked, "sensors", tuple(self.sensors[k] for k in chosen[1]))
        rows = tuple(tuple(r[k] for k in c) for r, c in zip(self._rows, chosen, strict=True))
        object.__setattr__(picked, "_rows", rows)
        return picked

    def blocks(
        self, size: int = BLOCK_SAMPLES, start: int = 0, stop: int | None = None
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield inputs `(nu, m)` and outputs `(ny, m)` in float64 from `start` to `stop`, `size` samples at a time."""
        whole("LongRecord.blocks", "size", size, 1)
        start, end = self._span("LongRecord.blocks", start, stop)
        with _opened(self.path) as file:
            for at in range(start, end, size):
                yield self._block(file, at, min(end, at + size))

    def read(self, start: int = 0, stop: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Return inputs and outputs of one stretch; as of a list, what is negative counts from the end."""
        start, stop = self._span("LongRecord.read", start, stop)
        with _opened(self.path) as file:
            return self._block(file, start, stop)

    def part(self, start: int = 0, stop: int | None = None) -> Record:
        """Return samples `start` to `stop` (excluded) as a record in memory; counted as by `Record.part`.

        Raises:
            InputError: no whole numbers, or a stretch that holds no samples.
        """
        first, last = self._span("LongRecord.part", start, stop)
        return Record(*self.read(first, last), self.rate_hz, self.actuators, self.sensors)

    def _span(self, who: str, start: int, stop: int | None) -> tuple[int, int]:
        """Return first and last sample (excluded) of a stretch, cut to what there is."""
        for name, value in (("start", start), ("stop", stop)):
            whole(who, name, 0 if value is None else value, -sys.maxsize)
        first, last, _ = slice(start, stop).indices(self.samples)
        if first >= last:
            raise InputError(f"{who}: there are no samples from {start} to {stop}; there are {self.samples}.")
        return first, last

    def _block(self, file: Any, start: int, stop: int) -> tuple[FloatArray, FloatArray]:
        u, y = (self._signals(file[p], r, start, stop) for p, r in zip(self._places, self._rows, strict=True))
        return u, y

    def _signals(self, dataset: Any, rows: tuple[int, ...], start: int, stop: int) -> FloatArray:
        out = np.empty((len(rows), stop - start))
        try:
            if dataset.ndim == 1:
                out[0] = dataset[start:stop]
            elif dataset.shape[0] > dataset.shape[1] and not self._ours:
                out[:] = dataset[start:stop][:, list(rows)].T
            else:
                for k, row in enumerate(rows):
                    out[k] = dataset[row, start:stop]
        except (OSError, RuntimeError, ValueError) as error:
            raise StorageError(
                f"LongRecord: '{self.path}' cannot be read from sample {start} to {stop} ({reason(error)}); the file "
                f"is damaged, or went away."
            ) from error
        if not np.isfinite(out.sum()):
            channel, sample = np.argwhere(~np.isfinite(out))[0]
            raise InputError(
                f"LongRecord: '{self.path}' holds a NaN or infinite value at sample {start + int(sample)} of channel "
                f"{rows[int(channel)]} of '{dataset.name}'; cut it out."
            )
        return out


def _opened(path: Path) -> Any:
    import h5py

    try:
        check_regular(path)
    except FileNotFoundError as error:
        raise StorageError(f"LongRecord: '{path}' does not exist.") from error
    except OSError as error:
        raise StorageError(f"LongRecord: '{path}' cannot be read ({reason(error)}).") from error
    try:
        return h5py.File(path, "r")
    except OSError as error:
        why = "was cut short" if "truncated" in str(error) else "is no HDF5 file that can be read"
        raise StorageError(f"LongRecord: '{path}' {why} ({reason(error)}).") from error


def _shape(path: Path, file: Any, name: str, ours: bool) -> tuple[int, int]:
    """Return channels and samples of a dataset; of one that is not ours the longer axis is time."""
    import h5py

    if isinstance(file.get(name, getlink=True), h5py.ExternalLink):
        raise StorageError(f"LongRecord: '{name}' in '{path}' is a link outside itself, which is not followed.")
    if name not in file or not hasattr(file[name], "shape"):
        names = ", ".join(f"'{k}'" for k in file)
        raise InputError(f"LongRecord: '{path}' has no dataset '{name}', only {names or 'nothing'}.")
    if file[name].external or file[name].is_virtual:
        raise StorageError(
            f"LongRecord: '{path}' keeps '{name}' outside itself, in other files; such storage is not followed: copy "
            "the samples into one file first (h5repack)."
        )
    shape = file[name].shape
    if len(shape) not in (1, 2) or file[name].dtype.kind not in "fiu" or math.prod(shape) == 0:
        raise InputError(f"LongRecord: '{name}' in '{path}' has shape {shape}; numbers (channel, sample) are needed.")
    if len(shape) == 1:
        return 1, shape[0]
    return (shape[0], shape[1]) if ours else (min(shape), max(shape))


def _named(path: Path, text: Any) -> tuple[list[Channel] | None, list[Channel] | None]:
    if text is None:
        return None, None
    try:
        u, y = (from_rows(rows) for rows in parse_json(text))
    except (ValueError, TypeError) as error:
        raise StorageError(f"LongRecord: '{path}' names its channels as no writer does ({reason(error)}).") from None
    return u, y
