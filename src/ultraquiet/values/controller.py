"""A controller: anything that turns one sample of measurements into one sample of commands."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.values.state_space import StateSpace


@runtime_checkable
class Controller(Protocol):
    """u = K y, sample by sample, its sign inside. `rate_hz` is the rate it was made for."""

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        ...

    def reset(self) -> None:
        """Return to rest."""
        ...

    def step(self, y: FloatArray) -> FloatArray:
        """Return the commands `(nu,)` for the measurements `(ny,)` of this sample."""
        ...


@dataclass(frozen=True, eq=False)
class MachineStep:
    """One step of a controller as machine code, for a bench whose loop is machine code too.

    `function` is the address of `void step(void *state, const real *readings, real *commands)`, `state` that of its
    state. `readings` `(ny,)` and `commands` `(nu,)` are the arrays that a step reads and fills, in the code's
    precision. `reads` and `drives` are the places of these channels among those that the controller takes and gives,
    `(ny, nu)` in `channels`. `owner` keeps all of it alive.

    A controller offers it by a method `machine_step()`, None where it cannot; a loop that calls it does what as many
    calls of the controller's `step` would.
    """

    function: int
    state: int
    readings: NDArray[Any]
    commands: NDArray[Any]
    reads: NDArray[np.int64]
    drives: NDArray[np.int64]
    channels: tuple[int, int]
    owner: Any


class SteppedController:
    """A linear law run sample by sample: the plain twin of every faster implementation.

    >>> law = SteppedController(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0))
    >>> [float(law.step(np.array([1.0]))[0]) for _ in range(3)]
    [0.0, 1.0, 1.5]
    """

    def __init__(self, law: StateSpace) -> None:
        if law.rate_hz is None:
            raise InputError("SteppedController: the law is in continuous time; discretise it first.")
        self.law = law
        self._x = np.zeros(law.states)

    @property
    def rate_hz(self) -> float | None:
        """Sampling rate in Hz."""
        return self.law.rate_hz

    def reset(self) -> None:
        """Return the state to zero."""
        self._x = np.zeros(self.law.states)

    def step(self, y: FloatArray) -> FloatArray:
        """Return C x + D y and advance the state."""
        u = self.law.C @ self._x + self.law.D @ y
        self._x = self.law.A @ self._x + self.law.B @ y
        return u
