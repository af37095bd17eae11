"""A bench that plays back what was recorded."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet.bench._abstract import checked_signals
from ultraquiet.values import Channel, Record


@register("bench", "replay")
@dataclass(frozen=True)
class Replay:
    """Answers an actuation that is in its records with the record it belongs to; it knows nothing else.

    Args:
        records: records of one bench.

    Raises:
        InputError: no records, an actuation that none of them holds, a disturbance or a controller (a recording cannot
            react).

    >>> record = Record([[1.0, 0.0]], [[0.0, 3.0]], rate_hz=10.0)
    >>> Replay((record,)).run([[1.0, 0.0]]).outputs.tolist()
    [[0.0, 3.0]]
    """

    records: tuple[Record, ...]

    def __post_init__(self) -> None:
        if not self.records:
            raise InputError("Replay: it needs at least one record, got none.")

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

    def run(self, actuation: ArrayLike, disturbance: ArrayLike | None = None, controller: Any | None = None) -> Record:
        """Return the record whose inputs equal `actuation`."""
        if disturbance is not None or controller is not None:
            raise InputError("Replay.run: a recording cannot react, so it takes neither disturbance nor controller.")
        u, _ = checked_signals("Replay.run", len(self.actuators), actuation, None)
        for record in self.records:
            if np.array_equal(record.inputs, u):
                return record
        raise InputError(
            f"Replay.run: none of the {len(self.records)} records holds this actuation of shape {u.shape}; "
            "send the inputs of one of them."
        )
