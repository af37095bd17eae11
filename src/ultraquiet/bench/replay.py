"""A bench that plays back what was recorded."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench._abstract import Block, block_of, checked_signals, limits, ramp_of
from ultraquiet.bench.stepped import Stop
from ultraquiet.values import Channel, Record
from ultraquiet.values.channel import at_limits


@register("bench", "replay")
@dataclass(frozen=True)
class Replay:
    """Answers an actuation that is in its records with the record it belongs to; it knows nothing else.

    What is asked is limited to the actuators' range first, as every bench does, and must then equal the recorded
    inputs to the bit. Several records of one actuation are repetitions: `run_index` chooses among them in their order.

    Args:
        records: records of one bench.

    Raises:
        InputError: no records, records of different channels, an actuation that none of them holds, a disturbance or
            a controller (a recording cannot react).
        RateError: records of different rates.

    >>> record = Record([[1.0, 0.0]], [[0.0, 3.0]], rate_hz=10.0)
    >>> Replay((record,)).run([[1.0, 0.0]]).outputs.tolist()
    [[0.0, 3.0]]
    """

    records: tuple[Record, ...]
    reacts: ClassVar[bool] = False  # a study closes no loop on it

    def __post_init__(self) -> None:
        if not self.records:
            raise InputError("Replay: it needs at least one record, got none.")
        for number, record in enumerate(self.records, start=1):
            if not isinstance(record, Record):
                raise InputError(f"Replay: 'records' must be a tuple of records, got {record!r} as number {number}.")
        first = self.records[0]
        for number, record in enumerate(self.records[1:], start=2):
            same_rate("Replay", "record 1", first.rate_hz, f"record {number}", record.rate_hz)
            if (record.actuators, record.sensors) != (first.actuators, first.sensors):
                raise InputError(f"Replay: record {number} has other channels than record 1; replay each bench alone.")

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        return self.records[0].rate_hz

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """The recorded inputs."""
        return self.records[0].actuators

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The recorded outputs."""
        return self.records[0].sensors

    @property
    def provenance(self) -> Provenance:
        """Who plays, and the hashes of what it plays."""
        return Provenance("bench.replay", {"records": len(self.records)}, parents=tuple(r.hash for r in self.records))

    def run(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        run_index: int | None = None,
    ) -> Record:
        """Return the record whose inputs equal `actuation`, its own provenance included."""
        if controller is not None or (disturbance is not None and np.any(disturbance)):
            raise InputError("Replay.run: a recording cannot react, so it takes neither disturbance nor controller.")
        u, _ = checked_signals("Replay.run", len(self.actuators), actuation, disturbance)
        low, high = limits(self.actuators)
        command = np.clip(u, low[:, None], high[:, None])
        matches = [record for record in self.records if np.array_equal(record.inputs, command)]
        if not matches:
            raise InputError(self._refusal(command))
        index = 0 if run_index is None else whole("Replay.run", "run_index", run_index, 0)
        return matches[index % len(matches)]

    def stream(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        *,
        run_index: int | None = None,
        block_samples: int | None = None,
        stop: Stop | None = None,
        ramp_samples: int | None = None,
    ) -> Iterator[Block]:
        """Yield the record of `run` in blocks; a stop ends it at once, since nothing moves and nothing can be faded."""
        ramp_of("Replay.run", ramp_samples, self.rate_hz)
        size = block_of("Replay.run", block_samples, self.rate_hz)
        return _cut(self.run(actuation, disturbance, controller, run_index), size, stop)

    def _refusal(self, command: FloatArray) -> str:
        count, samples = len(self.records), command.shape[1]
        refusal = f"Replay.run: none of the {count} records holds this actuation of shape {command.shape}"
        matching = [(k, r.inputs) for k, r in enumerate(self.records, 1) if r.samples == samples]
        if not matching:
            lengths = sorted({r.samples for r in self.records})
            return f"{refusal}, they are {', '.join(map(str, lengths))} samples long; send the inputs of one of them."
        number, inputs = min(matching, key=lambda numbered: np.count_nonzero(numbered[1] != command))
        row, k = (int(i) for i in np.argwhere(inputs != command)[0])
        return (
            f"{refusal}: the nearest, record {number}, differs first in '{self.actuators[row].name}' at sample {k}, "
            f"where {inputs[row, k]:.17g} was recorded and {command[row, k]:.17g} is asked; send the inputs of one."
        )


def _cut(record: Record, size: int, stop: Stop | None) -> Iterator[Block]:
    for start in range(0, record.samples, size):
        if stop is not None and stop():
            return
        part = slice(start, start + size)
        y = record.outputs[:, part]
        # A record does not tell which of its commands had been limited.
        unknown = np.zeros(len(record.actuators), dtype=np.int64)
        yield Block(record.inputs[:, part], y, unknown, at_limits(y, record.sensors))
