"""A plant from outside, given as a function of one sample."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench._abstract import checked_controller, checked_signals, commands, limits
from ultraquiet.values import Channel, Record
from ultraquiet.values.channel import channels


@register("bench", "wrapped")
@dataclass(frozen=True, init=False)
class Wrapped:
    """A bench around y = step(u, d), called once a sample.

    At sample k `step` gets the command u formed one sample before (zero at first) and the disturbance d of this sample,
    both `(nu,)`, and returns the readings `(ny,)`. How u and d meet inside is the plant's own affair.

    Args:
        step: the plant, one sample on.
        reset: returns the plant to rest; called before every run.
        rate_hz: samples per second.
        actuators, sensors: channels or names; the commands are limited to the actuators' range.

    Raises:
        InputError: readings of the wrong number or not finite, signals of the wrong shape.
        RateError: a controller made for another rate.

    >>> bench = Wrapped(lambda u, d: 2.0 * (u + d), lambda: None, 100.0, ["force"], ["speed"])
    >>> bench.run([[1.0, 0.0, 0.0]], disturbance=[[0.0, 0.0, 5.0]]).outputs.tolist()
    [[0.0, 2.0, 10.0]]
    """

    step: Callable[[FloatArray, FloatArray], ArrayLike]
    reset: Callable[[], Any]
    rate_hz: float
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]

    def __init__(
        self,
        step: Callable[[FloatArray, FloatArray], ArrayLike],
        reset: Callable[[], Any],
        rate_hz: float,
        actuators: Sequence[Channel | str],
        sensors: Sequence[Channel | str],
    ) -> None:
        for name, given in (("step", step), ("reset", reset)):
            if not callable(given):
                raise InputError(f"Wrapped: '{name}' must be a function, got {type(given).__name__}.")
        put = object.__setattr__
        put(self, "step", step)
        put(self, "reset", reset)
        put(self, "rate_hz", positive("Wrapped", "rate_hz", rate_hz, "Hz"))
        put(self, "actuators", channels("Wrapped", actuators, len(actuators), "input"))
        put(self, "sensors", channels("Wrapped", sensors, len(sensors), "output"))

    def run(self, actuation: ArrayLike, disturbance: ArrayLike | None = None, controller: Any | None = None) -> Record:
        """Return the record of one run from rest; see `Bench.run`."""
        nu, ny = len(self.actuators), len(self.sensors)
        u, d = checked_signals("Wrapped.run", nu, actuation, disturbance)
        law = None if controller is None else checked_controller("Wrapped.run", controller, self.rate_hz, ny, nu)
        low, high = limits(self.actuators)
        command, y = np.empty_like(u), np.empty((ny, u.shape[1]))
        self.reset()
        held = np.zeros(nu)
        for k in range(u.shape[1]):
            y[:, k] = self._readings(held, d[:, k], k)
            asked = u[:, k] if law is None else u[:, k] + commands("Wrapped.run", law.step(y[:, k]), nu, k)
            held = np.clip(asked, low, high)
            command[:, k] = held
        made = Provenance("bench.wrapped", {"rate_hz": self.rate_hz})
        return Record(command, y, self.rate_hz, self.actuators, self.sensors, made)

    def _readings(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        given = self.step(u.copy(), d.copy())
        y = np.asarray(given, dtype=np.float64).reshape(-1)
        if y.size != len(self.sensors) or not np.isfinite(y).all():
            raise InputError(
                f"Wrapped.run: at sample {k} the plant must return {len(self.sensors)} finite readings, got {given!r}."
            )
        return y
