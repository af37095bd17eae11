"""What a checked list comes to on a given bench: measurements, pauses and readings of temperature, in order."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.provenance import content_hash, plain
from ultraquiet._base.registry import older_names
from ultraquiet.values import StateSpace


@dataclass(frozen=True)
class Drive:
    """A signal on one actuator (counted from 0), with the seed of its draw; `unnamed` are levels that nobody named."""

    method: str
    signal: Any
    actuator: int
    seed: int
    unnamed: tuple[str, ...] = ()

    def describe(self) -> dict[str, Any]:
        """Return what makes this drive, in plain types: what is on a disk keeps the names that it was written with."""
        written = {newer: name for name, newer in older_names(type(self.signal)).items()}
        content: dict[str, Any] = plain(self.signal)
        settings = {written.get(name, name): value for name, value in content.items()}
        return {"method": self.method, **settings, "actuator": self.actuator + 1, "seed": self.seed}


@dataclass(frozen=True)
class Pause:
    """A wait between measurements."""

    seconds: float
    line: int


@dataclass(frozen=True)
class Thermometer:
    """A reading of the bench's temperature; later records carry it under `name`."""

    name: str
    line: int


@dataclass(frozen=True)
class Measurement:
    """One run of the bench that leaves one record called `name`; `group` is the name its command gave.

    The comment is for people and decides nothing: it is no part of the hash. `planned` is the hash of the measurement
    that was planned where the bench asked for less.
    """

    name: str
    group: str
    line: int
    samples: int
    drives: tuple[Drive, ...]
    disturbances: tuple[Drive, ...]
    controller: StateSpace | None
    controller_file: str
    comment: str = ""
    planned: str = ""

    def describe(self) -> dict[str, Any]:
        """Return everything that decides this measurement, in plain types."""
        return {
            "name": self.name,
            "group": self.group,
            "samples": self.samples,
            "excitation": [d.describe() for d in self.drives],
            "disturbance": [d.describe() for d in self.disturbances],
            "controller": self.controller_file,
            "controller_hash": "" if self.controller is None else self.controller.hash,
        }

    @property
    def hash(self) -> str:
        """Content hash of what decides the measurement: equal for equal measurements."""
        return self.planned or content_hash(self.describe())


Step = Measurement | Pause | Thermometer


def duration_s(steps: Iterable[Step], rate_hz: float) -> float:
    """Return the time steps take on the bench in seconds: samples and pauses, without what lies between runs."""
    lengths = (step.samples / rate_hz if isinstance(step, Measurement) else _pause_s(step) for step in steps)
    return float(sum(lengths))


def _pause_s(step: Pause | Thermometer) -> float:
    return step.seconds if isinstance(step, Pause) else 0.0


def sent(drives: Iterable[Drive], actuators: int, samples: int, rate_hz: float) -> FloatArray:
    """Return the drives as `(actuators, samples)`, each row in its actuator's unit."""
    u = np.zeros((actuators, samples))
    for drive in drives:
        u[drive.actuator] += drive.signal.generate(samples=samples, rate_hz=rate_hz, seed=drive.seed)
    return u
