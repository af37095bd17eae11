"""The one protocol of every bench, and the checks of what is sent to it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import FloatArray, few_finite, real_array, same_rate, whole
from ultraquiet._base.errors import InputError, RunawayError
from ultraquiet._base.provenance import Provenance
from ultraquiet.values import Channel, Controller, Record, StateSpace, SteppedController
from ultraquiet.values.joined.wires import Wired, unswapped

IntArray = NDArray[np.int64]
BLOCK_S = 0.05  # a killed process loses at most what one block and the disk's queue hold
RAMP_S = 0.1  # to zero: short for whoever pressed the button


@runtime_checkable
class Bench(Protocol):
    """A plant with actuators and sensors on one clock."""

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        ...

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """The `nu` commands."""
        ...

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The `ny` readings."""
        ...

    def run(self, actuation: ArrayLike, disturbance: ArrayLike | None = None, controller: Any | None = None) -> Record:
        """Start at rest, send `actuation` `(nu, n)`, return the record.

        At sample k the readings y[k] are taken, the command actuation[k] + (K y)[k] is formed and limited to the
        actuators' range, and it acts from sample k + 1 on; `disturbance` `(nu, n)` is added at the plant's input
        without that delay. The record holds the limited commands and the readings.
        """
        ...


@dataclass(frozen=True, eq=False)
class Block:
    """A stretch of a run as it was measured: what a bench hands over while it runs.

    Args:
        command: `(nu, m)`, actuation + K y as limited, in the sample it was formed.
        readings: `(ny, m)`.
        limited_commands: samples of this block in which each command met its limit, `(nu,)`.
        limited_readings: samples of this block in which each reading met its limit, `(ny,)`.
        overruns: frames of this block that came too late (hardware and processes).
        further: what else met its limit in this block, `limited_...` -> samples of each, for benches that know more.
    """

    command: FloatArray
    readings: FloatArray
    limited_commands: IntArray
    limited_readings: IntArray
    overruns: int = 0
    further: Mapping[str, IntArray] = field(default_factory=dict[str, IntArray])


class Tally:
    """What met its limit in a run so far, and how many frames came too late.

    >>> tally = Tally()
    >>> for _ in range(2):
    ...     tally.take(Block(np.zeros((1, 5)), np.zeros((1, 5)), np.array([3]), np.array([0])))
    >>> tally.counts()
    {'limited_commands': [6], 'limited_readings': [0], 'overruns': 0}
    """

    def __init__(self) -> None:
        self._counts: dict[str, Any] = {}

    def take(self, block: Block) -> None:
        """Count one block."""
        limited = {"limited_commands": block.limited_commands, "limited_readings": block.limited_readings}
        for name, count in {**limited, **block.further, "overruns": block.overruns}.items():
            self._counts[name] = self._counts.get(name, 0) + count

    @property
    def overruns(self) -> int:
        """Frames that came too late."""
        return int(self._counts.get("overruns", 0))

    def counts(self) -> dict[str, Any]:
        """Return the counts as a provenance holds them."""
        return {name: np.asarray(count).tolist() for name, count in self._counts.items()}

    told = counts  # its name until 0.1


@runtime_checkable
class Streaming(Protocol):
    """A bench that hands over its readings while it runs, and can be stopped softly."""

    @property
    def provenance(self) -> Provenance:
        """Who measures: the bench's name, settings and seed."""
        ...

    def stream(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        *,
        run_index: int | None = None,
        block_samples: int | None = None,
        stop: Callable[[], bool] | None = None,
        ramp_samples: int | None = None,
    ) -> Iterator[Block]:
        """Yield the run of `run` in blocks of `block_samples`, each as soon as it is measured.

        Before each block `stop()` is asked. Once it says yes, the commands (actuation + K y) and the disturbance are
        faded linearly to zero within `ramp_samples`, the readings of that stretch are handed over too, and the run
        ends. A generator that is closed early brings the actuators to zero by itself. A block is 50 ms long when
        absent, the ramp 0.1 s.
        """
        ...


def block_of(who: str, block_samples: int | None, rate_hz: float) -> int:
    """Return the samples of a block: as asked for, else those of 50 ms."""
    return _samples(who, "block_samples", block_samples, BLOCK_S * rate_hz)


def ramp_of(who: str, ramp_samples: int | None, rate_hz: float) -> int:
    """Return in how many samples a stopped run comes to zero: as asked for, else those of a tenth of a second."""
    return _samples(who, "ramp_samples", ramp_samples, RAMP_S * rate_hz)


def _samples(who: str, name: str, asked: int | None, usual: float) -> int:
    return max(1, round(usual)) if asked is None else whole(who, name, asked, 1)


def fade(samples: int, ramp_samples: int) -> FloatArray:
    """Return the gains of a soft stop: from just below one, linearly to zero and zero from there on, `(samples,)`.

    >>> fade(6, 4).tolist()
    [0.75, 0.5, 0.25, 0.0, 0.0, 0.0]
    """
    return np.maximum(1.0 - np.arange(1, samples + 1) / ramp_samples, 0.0)


def checked_signals(
    who: str, actuators: int, actuation: ArrayLike, disturbance: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    """Return actuation and disturbance as `(nu, n)` of equal shape, the disturbance zero when absent."""
    u = real_array(who, "actuation", actuation, 2)
    if u.shape[0] != actuators or u.shape[1] == 0:
        raise InputError(f"{who}: 'actuation' must have shape ({actuators}, samples), got {u.shape}.")
    if disturbance is None:
        return u, np.zeros_like(u)
    d = real_array(who, "disturbance", disturbance, 2)
    if d.shape != u.shape:
        raise InputError(f"{who}: 'disturbance' must have the shape of 'actuation', {u.shape}, got {d.shape}.")
    return u, d


def checked_law(who: str, law: StateSpace, rate_hz: float, sensors: int, actuators: int) -> None:
    """Refuse a linear law of another rate or of other dimensions."""
    same_rate(who, "the controller", law.rate_hz, "the bench", rate_hz)
    if law.D.shape != (actuators, sensors):
        raise InputError(
            f"{who}: the controller must take {sensors} readings and give {actuators} commands, "
            f"got one from {law.D.shape[1]} to {law.D.shape[0]}."
        )


def checked_controller(who: str, controller: Any, rate_hz: float, sensors: int, actuators: int) -> Controller:
    """Return a controller that can be stepped, reset to rest."""
    if isinstance(controller, StateSpace):
        checked_law(who, controller, rate_hz, sensors, actuators)
        return SteppedController(controller)
    if not (hasattr(controller, "step") and hasattr(controller, "reset")):
        raise InputError(
            f"{who}: 'controller' must be a StateSpace or have the methods step(y) and reset(), "
            f"got {type(controller).__name__}."
        )
    made_for = getattr(controller, "rate_hz", None)
    if made_for is not None:
        same_rate(who, "the controller", made_for, "the bench", rate_hz)
    controller.reset()
    return controller


def linear_part(controller: Any) -> Any:
    """Return the law that a stepped controller runs, as this package's own hold it; None where it shows none."""
    return getattr(controller, "law", getattr(getattr(controller, "library", None), "law", None))


def require_unswapped(who: str, controller: Any, bench: Wired) -> None:
    """Refuse a controller that names a bench's channels at other places; one without names may be any."""
    law = controller if isinstance(controller, StateSpace) else linear_part(controller)
    if hasattr(law, "actuators") and hasattr(law, "sensors"):
        unswapped(who, law, bench, "bench")


def commands(who: str, output: Any, actuators: int, sample: int) -> FloatArray:
    """Return one sample of a controller's output as `(nu,)`, or say what is wrong with it."""
    u = np.asarray(output, dtype=np.float64).reshape(-1)
    if u.size != actuators or not few_finite(u):
        raise (RunawayError if u.size == actuators else InputError)(
            f"{who}: at sample {sample} the controller must return {actuators} finite commands, got {output!r}."
        )
    return u


def limits(channels: tuple[Channel, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper limits of channels."""
    return np.array([c.low for c in channels]), np.array([c.high for c in channels])
