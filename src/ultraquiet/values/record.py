"""A record: what went in and what came out, sampled together."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, frozen, positive, signal_array, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, content_hash
from ultraquiet._base.shown import Shown, counted
from ultraquiet.values.channel import Channel, at_limits, channels
from ultraquiet.values.joined.wires import places
from ultraquiet.values.neighbours.records import RecordNeighbours


@dataclass(frozen=True, init=False, eq=False)
class Record(Shown, RecordNeighbours):
    """Inputs and outputs of a system on one clock.

    Args:
        inputs: `(nu, n)`, the commands as they were sent, in the unit of each actuator.
        outputs: `(ny, n)`, the readings, in the unit of each sensor; column k was read when column k was sent.
        rate_hz: samples per second.
        actuators: `nu` channels or names; numbered when absent.
        sensors: `ny` channels or names; numbered when absent.
        provenance: how the record was made.

    Raises:
        InputError: NaN or infinite samples, unequal lengths, no samples, a rate that is not positive.

    >>> record = Record([[0.0, 1.0, 0.0]], [[0.0, 0.0, 0.5]], rate_hz=3500.0)
    >>> record.samples, record.actuators[0].name
    (3, 'input 1')
    """

    inputs: FloatArray
    outputs: FloatArray
    rate_hz: float
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    provenance: Provenance = field(default_factory=Provenance)

    def __init__(
        self,
        inputs: ArrayLike,
        outputs: ArrayLike,
        rate_hz: float,
        actuators: Sequence[Channel | str] | None = None,
        sensors: Sequence[Channel | str] | None = None,
        provenance: Provenance | None = None,
    ) -> None:
        u = signal_array("Record", "inputs", inputs)
        y = signal_array("Record", "outputs", outputs)
        if u.shape[1] != y.shape[1]:
            raise InputError(f"Record: inputs have {u.shape[1]} samples but outputs have {y.shape[1]}; align them.")
        if 0 in u.shape or 0 in y.shape:
            raise InputError(f"Record: inputs of shape {u.shape} and outputs of shape {y.shape} hold no samples.")
        put = object.__setattr__
        put(self, "inputs", frozen(u))
        put(self, "outputs", frozen(y))
        put(self, "rate_hz", positive("Record", "rate_hz", rate_hz, "Hz"))
        put(self, "actuators", channels("Record", actuators, u.shape[0], "input"))
        put(self, "sensors", channels("Record", sensors, y.shape[0], "output"))
        put(self, "provenance", provenance or Provenance())

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.inputs.shape[1]

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return self.samples / self.rate_hz

    @property
    def time_s(self) -> FloatArray:
        """Time of each sample from the start, in seconds, `(n,)`."""
        return np.arange(self.samples) / self.rate_hz

    @property
    def hash(self) -> str:
        """Content hash of samples and rate; equal for equal records."""
        return content_hash(self.inputs, self.outputs, self.rate_hz)

    def _in_a_line(self) -> str:
        named = ", ".join(c.label for c in (*self.actuators[:1], *self.sensors[:1]))
        wires = f"{counted(len(self.actuators), 'input')}, {counted(len(self.sensors), 'output')}"
        size = f"{counted(self.samples, 'sample')} at {self.rate_hz:g} Hz ({self.duration_s:.4g} s)"
        return f"{wires}, {size}, {named}"

    def _as_curve(self) -> tuple[str, FloatArray]:
        return f"{self.sensors[0].label} over {self.duration_s:.4g} s", self.outputs[0]

    def part(self, start: int = 0, stop: int | None = None) -> "Record":
        """Return samples `start` to `stop` (excluded) as a record."""
        for name, value in (("start", start), ("stop", stop)):
            whole("Record.part", name, 0 if value is None else value, -sys.maxsize)
        rows = slice(start, stop)
        return Record(
            self.inputs[:, rows], self.outputs[:, rows], self.rate_hz, self.actuators, self.sensors, self.provenance
        )

    def pick(self, inputs: Sequence[int | str] | None = None, outputs: Sequence[int | str] | None = None) -> "Record":
        """Return some input and output channels, by index from 0 or by name, as a record; all of a side when absent.

        Raises:
            InputError: no such channel.
        """
        i, o = places("Record.pick", inputs, self.actuators), places("Record.pick", outputs, self.sensors)
        return Record(
            self.inputs[i],
            self.outputs[o],
            self.rate_hz,
            [self.actuators[k] for k in i],
            [self.sensors[k] for k in o],
            self.provenance,
        )

    def clipped(self) -> tuple[int, ...]:
        """Return for each sensor how many samples stand at or beyond its limits."""
        return tuple(int(count) for count in at_limits(self.outputs, self.sensors))
