"""What closes the simulated loop: a linear law compiled with the plant, or a controller asked sample by sample."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench._abstract import checked_controller, checked_law, commands, linear_part
from ultraquiet.bench.columns import Spanned, called, spanned, turned
from ultraquiet.linalg.balance import modal
from ultraquiet.values import Controller, StateSpace
from ultraquiet.values.controller import MachineStep

WHO = "Hexapod.run"
LAWS_KEPT = 16  # in the coordinates of a run, while a study measures them
Matrices = tuple[FloatArray, ...]
Plant = tuple[Spanned, Spanned, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits in volts of commands and actuators `(nu,)` and of readings `(ny,)`; the converter's step (0: none)."""

    command_v: FloatArray
    actuator_v: FloatArray
    reading_v: FloatArray
    step_v: float

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """The limits as the kernels take them."""
        return self.command_v, self.actuator_v, self.reading_v, self.step_v


class FeedbackLaw(Protocol):
    """What closes the loop."""

    def advance(self, plant: Plant, signals: Matrices, limits: Limits, state: Matrices, results: Matrices) -> None:
        """Run the loop on over all samples of `signals`; see `kernels.loop`."""
        ...


class CompiledLaw:
    """A linear law and one of machine code, added; both may read and drive some of the channels only."""

    def __init__(self, law: StateSpace, sensors: int, actuators: int, machine: MachineStep | None = None) -> None:
        (nu, ny), n = law.D.shape, law.states
        B, C, D = np.zeros((n, sensors)), np.zeros((actuators, n)), np.zeros((actuators, sensors))
        A, B[:, :ny], C[:nu] = _in_blocks(law)
        D[:nu, :ny] = law.D
        self._law = spanned(A), spanned(B), turned(C), turned(D)
        self._x = np.zeros(n)
        self._code, self._machine = called(machine), machine

    def advance(self, plant: Plant, signals: Matrices, limits: Limits, state: Matrices, results: Matrices) -> None:
        """Run the loop on over all samples of `signals`."""
        from ultraquiet.bench import kernels

        kernels.loop(plant, self._law, self._code, signals, limits.arrays, state, self._x, results)
        _require_finite(results[0])


class SteppedLaw:
    """A controller of Python, asked sample by sample; it may read and drive the leading channels only."""

    def __init__(self, law: Controller, readings: int, answers: int) -> None:
        self._law, self._ny, self._nu, self._k = law, readings, answers, 0

    def advance(self, plant: Plant, signals: Matrices, limits: Limits, state: Matrices, results: Matrices) -> None:
        """Run the loop on over all samples of `signals`."""
        from ultraquiet.bench import kernels

        u, d, noise, gain = signals
        command, y, limited = results
        A, B, C, *plays = plant
        x, held, anchors = state
        work = np.empty_like(x)
        y[:] = noise
        for k in range(len(u)):
            kernels.read(C, x, limits.reading_v, limits.step_v, y[k])
            try:
                answer = commands(WHO, self._law.step(y[k, : self._ny].copy()), self._nu, self._k)
            except BaseException as error:  # an interrupt, too, leaves the samples before it to be handed over
                raise LostError(k, error) from error
            requested = u[k].copy()
            requested[: self._nu] += answer
            driven = held + gain[k] * d[k]
            kernels.clip(driven, limits.actuator_v, driven, limited[1])
            kernels.slip(*plays, anchors, driven)
            kernels.advance(*A, *B, x, driven, work)
            kernels.clip(gain[k] * requested, limits.command_v, held, limited[0])
            command[k] = held
            self._k += 1


def _require_finite(command: FloatArray) -> None:
    finite = np.isfinite(command)
    if not finite.all():
        raise LostError(int(np.flatnonzero(~finite.all(axis=1))[0]))


class LostError(Exception):
    """The controller failed at a sample of the block, counted from its start."""

    def __init__(self, sample: int, error: BaseException | None = None) -> None:
        super().__init__(sample)
        self.sample, self.error = sample, error


def closing(controller: Any | None, actuators: int, sensors: int, rate_hz: float, leading: int) -> FeedbackLaw:
    """Return the law of a loop with `actuators` and `sensors`, checked; None never acts.

    A controller takes and gives all channels, or the first `leading` of either only: one made for the struts may stay
    when further instruments are read. How many channels a stepped one has is told by its `law`, a `StateSpace` or the
    like; without, it has all.
    """
    if controller is None:
        return CompiledLaw(_silent(rate_hz), sensors, actuators)
    law = controller if isinstance(controller, StateSpace) else linear_part(controller)
    shape = getattr(getattr(law, "D", None), "shape", None)
    nu, ny = (leading, leading) if shape == (leading, leading) else (actuators, sensors)
    if isinstance(controller, StateSpace):
        checked_law(WHO, controller, rate_hz, ny, nu)
        return CompiledLaw(controller, sensors, actuators)
    law = checked_controller(WHO, controller, rate_hz, ny, nu)
    machine: MachineStep | None = getattr(law, "machine_step", lambda: None)()
    if machine is None or machine.channels != (ny, nu):
        return SteppedLaw(law, ny, nu)  # one of other channels is refused when it answers
    return CompiledLaw(_silent(rate_hz), sensors, actuators, machine)


@lru_cache(maxsize=LAWS_KEPT)
def _in_blocks(law: StateSpace) -> Matrices:
    """Return A, B and C in coordinates in which a step costs least: some ten times less than with a full A."""
    return modal(law.A, law.B, law.C)[:3]


def _silent(rate_hz: float) -> StateSpace:
    """Return the law that never acts, so that open loop needs no kernel of its own."""
    return StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.zeros((1, 1)), rate_hz)
