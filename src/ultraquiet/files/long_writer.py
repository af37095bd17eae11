"""Writing records longer than memory, block by block."""

import contextlib
import json
import os
import secrets
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from numpy.typing import ArrayLike

from ultraquiet._base.constraints import one_of, positive, signal_array, whole
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.files.atomic import name_taken, reason
from ultraquiet.files.channel_rows import channel_rows
from ultraquiet.files.long_record import CHUNK_SAMPLES, FORMAT
from ultraquiet.values import Channel
from ultraquiet.values.channel import channels


class LongWriter:
    """Write a `LongRecord` block by block; it takes its name when it is whole, used as `with LongWriter(...) as file`.

    Args:
        path: the file.
        rate_hz: samples per second.
        inputs, outputs: channels, their names, or how many; a single one may stand by itself.
        precision: "float32" (half the disk, 24 bits: beyond any converter) or "float64".
        overwrite: False refuses a name that is taken.

    Raises:
        InputError: no rate above zero, no channels.
        StorageError: the disk is full, the folder missing, the name taken; what was there before is untouched.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        rate_hz: float,
        inputs: int | str | Channel | Sequence[Channel | str],
        outputs: int | str | Channel | Sequence[Channel | str],
        precision: str = "float32",
        overwrite: bool = True,
    ) -> None:
        one_of("LongWriter", "precision", precision, ("float32", "float64"))
        rate_hz = positive("LongWriter", "rate_hz", rate_hz, "Hz")
        self._path, self._overwrite, self._samples = Path(path), overwrite, 0
        if not overwrite and self._path.exists():
            raise name_taken(path)
        self._part = self._path.with_name(f".{self._path.name[:200]}.{secrets.token_hex(6)}.part")
        self.actuators = _wires(inputs, "input")
        self.sensors = _wires(outputs, "output")
        named = json.dumps([channel_rows(w) for w in (self.actuators, self.sensors)])
        with _writing(self._path):
            import h5py

            self._file = h5py.File(self._part, "w")
            self._file.attrs["format"], self._file.attrs["rate_hz"] = FORMAT, rate_hz
            self._file.attrs["channels"] = named
            self._datasets = [
                self._file.create_dataset(
                    name,
                    (len(wires), 0),
                    precision,
                    maxshape=(len(wires), None),
                    chunks=(1, CHUNK_SAMPLES),
                    fletcher32=True,  # a flipped bit is a read error, never a sample
                )
                for name, wires in (("inputs", self.actuators), ("outputs", self.sensors))
            ]

    def append(self, inputs: ArrayLike, outputs: ArrayLike) -> None:
        """Write the next samples, `(nu, m)` and `(ny, m)`."""
        blocks = [signal_array("LongWriter", k, v) for k, v in (("inputs", inputs), ("outputs", outputs))]
        shapes = [b.shape for b in blocks]
        expected = (len(self.actuators), len(self.sensors))
        if (shapes[0][0], shapes[1][0]) != expected or shapes[0][1] != shapes[1][1]:
            raise InputError(
                f"LongWriter: got inputs {shapes[0]} and outputs {shapes[1]}, the file has {expected[0]} and "
                f"{expected[1]} channels of one length."
            )
        stop = self._samples + shapes[0][1]
        with _writing(self._path):
            for dataset, block in zip(self._datasets, blocks, strict=True):
                dataset.resize(stop, axis=1)
                dataset[:, self._samples : stop] = block
        self._samples = stop

    def __enter__(self) -> "LongWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        try:
            with _writing(self._path):
                self._file.attrs["samples"] = self._samples
                self._file.close()
                if kind is None:
                    self._part.replace(self._path)
        finally:
            with contextlib.suppress(OSError):
                self._part.unlink()


def _wires(wires: Any, prefix: str) -> tuple[Channel, ...]:
    if not isinstance(wires, str | Channel | Iterable):
        return channels("LongWriter", None, whole("LongWriter", f"{prefix}s", wires, 1), prefix)
    listed = [wires] if isinstance(wires, str | Channel) else list(wires)
    if not listed:
        raise InputError(f"LongWriter: '{prefix}s' must name at least one channel, got none.")
    return channels("LongWriter", listed, len(listed), prefix)


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise StorageError(f"LongWriter: '{path}' could not be written ({reason(error)}).") from error
