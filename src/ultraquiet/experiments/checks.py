"""What is held against the bench before anything moves: signals against channels and times, controllers as well."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes
from ultraquiet.bench import Hexapod
from ultraquiet.bench.hexapod.physics.parameters import STRUTS
from ultraquiet.experiments.plan import Drive
from ultraquiet.values import Channel, StateSpace

RATE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Disturbance:
    """The signals that are on, and where the list says so."""

    drives: tuple[Drive, ...]
    place: Place


class Checks:
    """Holds signals against a bench; without a bench there is nothing to hold them against."""

    def __init__(self, bench: Any | None, mistakes: Mistakes) -> None:
        self._bench = bench
        self._mistakes = mistakes

    def signals(
        self, drives: Sequence[Drive], place: Place, samples: int, limit: float, under: Disturbance | None = None
    ) -> None:
        """Check the signals of one command, alone and together with the disturbance that is on.

        What is checked is what would really be sent: every signal is generated with its own seed and length.
        """
        if self._bench is None:
            return
        base: dict[int, FloatArray] = {}
        line = self._mistakes.line(under.place) if under else 0
        for drive in under.drives if under else ():
            u = self._sent(drive, under.place if under else (), samples, limit)
            if u is None:
                break
            base[drive.actuator] = u
        for drive in drives:
            u = self._sent(drive, place, samples, limit)
            if u is None:
                return
            if drive.actuator in base:
                # A command acts one sample after it was formed, a disturbance at once: Bench.run.
                u = base[drive.actuator] + np.concatenate([[0.0], u[:-1]])
                fault = self._beyond(u, drive.actuator, limit)
                if fault:
                    self._mistakes.add(place, f"with the disturbance of line {line} {fault}")
                    return

    def _sent(self, drive: Drive, place: Place, samples: int, limit: float) -> FloatArray | None:
        """Return what a drive sends; None when it cannot, with the mistake noted."""
        if drive.signal is None:
            return None
        rate_hz = float(self._bench.rate_hz) if self._bench is not None else 0.0
        late = list(_late(drive.signal, samples, rate_hz))
        for key, sentence in late:
            self._mistakes.add((*place, key), sentence)
        try:
            u = np.asarray(drive.signal.generate(samples=samples, rate_hz=rate_hz, seed=drive.seed), np.float64)
        except UltraquietError as error:
            self._mistakes.add(place, str(error))
            return None
        except Exception as error:  # a signal may be anybody's
            self._mistakes.add(place, f"'{drive.method}' cannot be generated ({type(error).__name__}: {error}).")
            return None
        if u.shape != (samples,):
            self._mistakes.add(place, f"'{drive.method}' comes in shape {u.shape}, {samples} samples are needed.")
            return None
        fault = self._beyond(u, drive.actuator, limit)
        if fault:
            self._mistakes.add(place, fault)
        return None if fault or late else u

    def _beyond(self, u: FloatArray, actuator: int, limit: float) -> str:
        # An actuator that does not exist is told elsewhere; its signal is checked but for the limits.
        assert self._bench is not None
        return _beyond(u, self._bench.actuators[actuator], limit) if actuator >= 0 else ""

    def misfit(self, law: Any) -> str:
        """Return why a controller cannot run on the bench, or nothing."""
        if not isinstance(law, StateSpace) or law.rate_hz is None:
            return f"holds a {type(law).__name__}; a controller is a StateSpace in discrete time"
        if self._bench is None:
            return ""
        if abs(law.rate_hz - self._bench.rate_hz) > RATE_TOLERANCE * law.rate_hz:
            return f"runs at {law.rate_hz:g} Hz, the bench at {self._bench.rate_hz:g} Hz"
        shape = (len(self._bench.actuators), len(self._bench.sensors))
        # A law of the struts alone stays usable on a hexapod that is read with all its instruments.
        fits = {shape} | ({(STRUTS, STRUTS)} if isinstance(self._bench, Hexapod) else set())
        return "" if law.D.shape in fits else f"has (commands, readings) {law.D.shape}, the bench {shape}"


def _late(signal: Any, samples: int, rate_hz: float) -> Iterator[tuple[str, str]]:
    """Yield each setting that names a time or a period beyond the measurement's end, and what to do about it."""
    if not is_dataclass(signal):
        return
    end_s = samples / rate_hz
    for field in fields(signal):
        value = getattr(signal, field.name)
        if not isinstance(value, int | float):
            continue
        if field.name.endswith("_s") and value > end_s * (1 + RATE_TOLERANCE):
            fault = f"'{field.name}' of {value:g} s lies beyond the measurement's end at {end_s:.4g} s"
            yield field.name, f"{fault}; bring it forward or take more samples."
        if field.name.endswith("_samples") and value > samples:
            yield field.name, f"'{field.name}' of {value} is longer than the measurement of {samples} samples."


def _beyond(u: FloatArray, channel: Channel, limit: float) -> str:
    low, high = max(channel.low, -limit), min(channel.high, limit)
    if low <= u.min() and u.max() <= high:
        return ""
    whose = "the list's own limit" if limit < min(-channel.low, channel.high) else f"the limits of '{channel.name}'"
    spans = f"the signal spans {u.min():g} to {channel.in_unit(u.max())}"
    return f"{spans}, beyond {whose}, {low:g} to {high:g}; lower it."
