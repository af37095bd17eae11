"""The loop of every bench that is stepped one sample at a time: the order of events stands here and nowhere else."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, few_finite, whole
from ultraquiet._base.errors import InputError, RunawayError
from ultraquiet._base.progress import require_wanted
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown.line import counted
from ultraquiet.bench._abstract import (
    Block,
    block_of,
    checked_controller,
    checked_signals,
    commands,
    fade,
    limits,
    ramp_of,
    require_unswapped,
)
from ultraquiet.bench.inner import recorded
from ultraquiet.values import Channel, Controller, Record
from ultraquiet.values.channel import at_limits

Stop = Callable[[], bool]


class AsOne(Protocol):
    """Plant and law as one, which keeps where both stand."""

    def __call__(
        self, held: FloatArray, u: FloatArray, d: FloatArray, gain: FloatArray, limits: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]:
        """Run over a block.

        Args:
            held: the command of the sample before, `(nu,)`; changed into the last one of the block.
            u: what is added to the law's answer, `(samples, nu)`.
            d: what is added to the command, `(samples, nu)`.
            gain: of what is sent, `(samples,)`.
            limits: lower and upper of the commands.

        Returns:
            Commands before their limits `(samples, nu)`, readings `(samples, ny)`, both as far as plant and law had
            finite answers, and where one had not the plant's readings or the law's answer.
        """
        ...


class SteppedPlant:
    """What the loop drives. A plant overrides `step`, and whatever else it can do better than here."""

    def start(self, run_index: int) -> None:
        """Return to rest; `run_index` numbers the run for plants that draw random numbers."""

    def step(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        """Apply the command `u` and the disturbance `d`, both `(nu,)`, at sample `k`; return the readings `(ny,)`."""
        raise NotImplementedError

    def advance(self, u: FloatArray, d: FloatArray, k: int) -> Iterator[FloatArray]:
        """Yield the readings of the samples from `k` on whose `u` and `d`, `(nu, m)`, are all known beforehand."""
        for j in range(u.shape[1]):
            yield self.step(u[:, j], d[:, j], k + j)

    def as_one(self, law: Controller | None) -> "AsOne | None":
        """Return what runs plant and law, or the plant alone, over a whole block; None where each sample is asked."""
        return None

    def overruns(self) -> int:
        """Return how many frames came too late since this was asked last."""
        return 0

    def rest(self, error: BaseException | None) -> None:
        """Come to rest at once: the run is over. `error` is what ended it, None when it came to its end or was closed.

        Called for every `start`, before anything else happens; once more where an interrupt or an error ended that,
        and what is at rest stays there.
        """


@dataclass(frozen=True)
class Setup:
    """A plant between its channels; `who` opens the sentence of a refusal."""

    who: str
    plant: SteppedPlant
    rate_hz: float
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]


class Stepped:
    """What all benches around a stepped plant share: `run` is `stream`, put together."""

    run_block: ClassVar[int | None] = None  # samples of a block of `run`, where 50 ms are too few to begin with

    @property
    def provenance(self) -> Provenance:
        """Who measures: the bench's name and settings."""
        raise NotImplementedError

    def _setup(self) -> Setup:
        raise NotImplementedError

    def run(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        run_index: int | None = None,
    ) -> Record:
        """Return the record of one run from rest; see `Bench.run`. `run_index` numbers it for the plant."""
        whole_run = self.stream(actuation, disturbance, controller, run_index=run_index, block_samples=self.run_block)
        return recorded(self, whole_run)

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
        """Yield the run of `run` in blocks as they are measured; see `Streaming.stream`.

        What was measured before a failure is handed over as a shorter block; the next step of the iterator raises.
        """
        setup = self._setup()
        block = block_of(setup.who, block_samples, setup.rate_hz)
        ramp = ramp_of(setup.who, ramp_samples, setup.rate_hz)
        index = self._next_run() if run_index is None else whole(setup.who, "run_index", run_index, 0)
        return driven(self._loop(setup, actuation, disturbance, controller), index, block, stop, ramp)

    def _next_run(self) -> int:
        """Return the number of a run that nobody numbered."""
        return 0

    def _loop(
        self, setup: Setup, actuation: ArrayLike, disturbance: ArrayLike | None, controller: Any | None
    ) -> "Loop":
        return Loop.of(setup, actuation, disturbance, controller)


class Loop:
    """One run from rest: what is to be sent, and where it stands."""

    def __init__(self, setup: Setup, u: FloatArray, d: FloatArray, law: Controller | None) -> None:
        self.setup, self.law = setup, law
        self.low, self.high = limits(setup.actuators)
        self.u, self.d = u, d
        self.gain = np.ones(u.shape[1])
        self.held_command = np.zeros(len(u))
        self.k, self.end = 0, u.shape[1]
        self.faded = False
        self.as_one = setup.plant.as_one(law)

    @classmethod
    def of(cls, setup: Setup, actuation: ArrayLike, disturbance: ArrayLike | None, controller: Any | None) -> "Loop":
        """Return the loop of a run after everything that goes into it was checked."""
        nu, ny = len(setup.actuators), len(setup.sensors)
        u, d = checked_signals(setup.who, nu, actuation, disturbance)
        law = None if controller is None else checked_controller(setup.who, controller, setup.rate_hz, ny, nu)
        require_unswapped(setup.who, controller, setup)
        return cls(setup, u, d, law)

    def fade(self, ramp_samples: int) -> None:
        """Let everything that is sent from here on fade to zero, and end there."""
        self.end = min(self.end, self.k + ramp_samples)
        self.gain[self.k :] = fade(self.gain.size - self.k, ramp_samples)
        self.faded = True

    def take(self, most: int) -> tuple[Block | None, BaseException | None]:
        """Run up to `most` further samples: what was measured, and what broke them off."""
        start, error = self.k, None
        m = min(most, self.end - start)
        requested, y = np.zeros((len(self.u), m)), np.zeros((len(self.setup.sensors), m))
        try:
            # One by one even in open loop, so that `self.k` always says how much was measured.
            for samples in self._samples(requested, y, start):
                self.k += samples
        except BaseException as caught:  # an interrupt, too, must bring the plant to rest before anything else
            error = caught
        done = self.k - start
        return (self._block(requested[:, :done], y[:, :done]) if done else None), error

    def _samples(self, requested: FloatArray, y: FloatArray, start: int) -> Iterator[int]:
        if self.as_one is not None:
            return self._together(self.as_one, requested, y, start)
        return self._open(requested, y, start) if self.law is None else self._closed(self.law, requested, y, start)

    def _together(self, as_one: AsOne, requested: FloatArray, y: FloatArray, start: int) -> Iterator[int]:
        now = slice(start, start + y.shape[1])
        gain = self.gain[now]
        u, d = (np.ascontiguousarray(signal.T) for signal in (self.u[:, now], gain * self.d[:, now]))
        asked, heard, ran_away, wrong = as_one(self.held_command, u, d, gain, (self.low, self.high))
        done = len(asked)
        requested[:, :done], y[:, :done] = asked.T, heard.T
        yield done
        if ran_away is not None:
            require_standing(self.setup.who, ran_away, start + done)
        if wrong is not None:
            commands(self.setup.who, wrong, wrong.size, start + done)

    def _open(self, requested: FloatArray, y: FloatArray, start: int) -> Iterator[int]:
        now = slice(start, start + y.shape[1])
        requested[:] = self.gain[now] * self.u[:, now]
        formed = np.clip(requested, self.low[:, None], self.high[:, None])
        applied = np.concatenate([self.held_command[:, None], formed[:, :-1]], axis=1)
        readings = self.setup.plant.advance(applied, self.gain[now] * self.d[:, now], start)
        for j in range(y.shape[1]):
            y[:, j] = next(readings)
            self.held_command = formed[:, j]
            yield 1

    def _closed(self, law: Controller, requested: FloatArray, y: FloatArray, start: int) -> Iterator[int]:
        # Everything here is done thousands of times a second: what is known beforehand is formed for the whole block.
        step, answer, who, nu = self.setup.plant.step, law.step, self.setup.who, len(self.u)
        low, high = self.low, self.high
        now = slice(start, start + y.shape[1])
        gain, u = self.gain[now].tolist(), np.ascontiguousarray(self.u[:, now].T)
        d = np.ascontiguousarray((self.gain[now] * self.d[:, now]).T)
        for j, k in enumerate(range(now.start, now.stop)):
            y[:, j] = step(self.held_command, d[j], k)
            wish = gain[j] * (u[j] + commands(who, answer(y[:, j].copy()), nu, k))
            requested[:, j] = wish
            self.held_command = np.minimum(np.maximum(wish, low), high)
            yield 1

    def _block(self, requested: FloatArray, y: FloatArray) -> Block:
        low, high = self.low[:, None], self.high[:, None]
        return Block(
            np.clip(requested, low, high),
            y,
            np.count_nonzero((requested < low) | (requested > high), axis=1),
            at_limits(y, self.setup.sensors),
            self.setup.plant.overruns(),
        )


def driven(loop: Loop, run_index: int, block_samples: int, stop: Stop | None, ramp_samples: int) -> Iterator[Block]:
    """Yield the blocks of a run; the plant is at rest before an error is raised or the generator is closed."""
    plant, resting = loop.setup.plant, False
    try:
        plant.start(run_index)
        while loop.k < loop.end:
            require_wanted()
            if stop is not None and not loop.faded and stop():
                loop.fade(ramp_samples)
            block, error = loop.take(block_samples)
            if error is not None:
                plant.rest(error)
                resting = True
            if block is not None:
                yield block
            if error is not None:
                raise error
    except GeneratorExit:
        raise
    except BaseException as error:
        if not resting:
            plant.rest(error)
            resting = True
        raise
    finally:
        if not resting:
            try:
                plant.rest(None)
            except BaseException:
                plant.rest(None)  # Ctrl-C may come before the first has begun
                raise


def require_standing(who: str, y: FloatArray, k: int) -> None:
    """Refuse readings of a model that are no longer finite numbers."""
    if not few_finite(y):
        raise RunawayError(
            f"{who}: at sample {k} the plant's readings were no longer finite numbers: it ran away; make the run"
            " shorter or give a controller that holds it."
        )


def checked_readings(who: str, answer: Any, sensors: int, k: int) -> FloatArray:
    """Return what a plant handed over at sample `k` as `(ny,)` finite numbers, or say what is wrong with it."""
    try:
        y = np.asarray(answer, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        y = np.empty(0)
    if y.size != sensors or not few_finite(y):
        raise (RunawayError if y.size == sensors else InputError)(
            f"{who}: at sample {k} the plant must return {counted(sensors, 'finite reading')}, got {answer!r}."
        )
    return y
