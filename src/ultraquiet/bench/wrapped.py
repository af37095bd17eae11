"""A plant from outside, given as a function of one sample."""

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any

from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench.stepped import Setup, Stepped, SteppedPlant, checked_readings
from ultraquiet.values import Channel
from ultraquiet.values.channel import channels

NUMBER = "run_index"
POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


@register("bench", "wrapped")
@dataclass(frozen=True, init=False)
class Wrapped(Stepped):
    """A bench around y = step(u, d), called once a sample.

    At sample k `step` gets the command u formed one sample before (zero at first) and the disturbance d of this sample,
    both `(nu,)`, and returns the readings `(ny,)`. How u and d meet inside is the plant's own affair.

    Args:
        step: the plant, one sample on.
        reset: returns the plant to rest; called before every run. One that takes an argument gets the number of the
            run, to draw other noise in each: the `run_index` of `run`, or how many runs there were so far.
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
    reset: Callable[..., Any]
    rate_hz: float
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]

    def __init__(
        self,
        step: Callable[[FloatArray, FloatArray], ArrayLike],
        reset: Callable[..., Any],
        rate_hz: float,
        actuators: Sequence[Channel | str],
        sensors: Sequence[Channel | str],
    ) -> None:
        for name, function in (("step", step), ("reset", reset)):
            if not callable(function):
                raise InputError(f"Wrapped: '{name}' must be a function, got {type(function).__name__}.")
        put = object.__setattr__
        put(self, "step", step)
        put(self, "reset", reset)
        put(self, "rate_hz", positive("Wrapped", "rate_hz", rate_hz, "Hz"))
        put(self, "actuators", channels("Wrapped", actuators, len(actuators), "input"))
        put(self, "sensors", channels("Wrapped", sensors, len(sensors), "output"))

    @property
    def provenance(self) -> Provenance:
        """Who measures; what a function does inside is not known here."""
        return Provenance("bench.wrapped", {"rate_hz": self.rate_hz})

    def _setup(self) -> Setup:
        plant = _Called(self.step, _numbered(self.reset), len(self.sensors))
        return Setup("Wrapped.run", plant, self.rate_hz, self.actuators, self.sensors)

    @cached_property
    def _runs(self) -> Iterator[int]:
        """Numbers of the runs that nobody numbers: what changes, kept out of the settings."""
        return count()

    def _next_run(self) -> int:
        return next(self._runs)


def _numbered(reset: Callable[..., Any]) -> Callable[[int], Any]:
    """Return a function of the run's number that hands it to a reset which takes it."""
    try:
        parameters = inspect.signature(reset).parameters
    except (TypeError, ValueError):  # some of C have no signature
        return lambda _: reset()
    if (named := parameters.get(NUMBER)) is not None and named.kind is not named.POSITIONAL_ONLY:
        return lambda number: reset(**{NUMBER: number})
    needed = [p for p in parameters.values() if p.kind in POSITIONAL and p.default is p.empty]
    return reset if needed else lambda _: reset()


class _Called(SteppedPlant):
    """Two functions as a plant."""

    def __init__(
        self, step: Callable[[FloatArray, FloatArray], ArrayLike], reset: Callable[[int], Any], ny: int
    ) -> None:
        self._step, self._reset, self._ny = step, reset, ny

    def start(self, run_index: int) -> None:
        self._reset(run_index)

    def step(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        # Copies, so that a plant that keeps or changes its arguments cannot spoil the record.
        return checked_readings("Wrapped.run", self._step(u.copy(), d.copy()), self._ny, k)
