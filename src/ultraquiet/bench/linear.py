"""A linear model as a bench: its loop is the one that was designed and analysed."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, few_finite
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench.columns import called, spanned, turned
from ultraquiet.bench.stepped import AsOne, Setup, Stepped, SteppedPlant, require_standing
from ultraquiet.values import Channel, Controller, StateSpace
from ultraquiet.values.controller import MachineStep, SteppedController
from ultraquiet.values.interconnect import gain

WHO = "LinearBench.run"


@dataclass(frozen=True, eq=False)
class LinearBench(Stepped):
    """A bench that is a model: x+ = A x + B (u + d), y = C x + D (u + d), without noise, within the channels' limits.

    A model without D holds the sample of delay that every command has, as one identified from records does: its loop is
    y = G (u + d), u = K y, the one of `design` and `analyse`. Of a model with D the reading would answer a command of
    the same sample; here every command acts one sample late, so the loop has a sample of delay more (`delayed`).

    Args:
        model: in discrete time; its channels' limits bound commands, and readings are cut at theirs.

    Raises:
        InputError: a model in continuous time.

    >>> bench = LinearBench(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=10.0))
    >>> bench.run([[0.0, 0.0, 0.0]], disturbance=[[0.0, 1.0, 0.0]]).outputs.tolist()
    [[0.0, 1.0, 0.5]]
    """

    model: StateSpace
    real_time: ClassVar[bool] = False
    run_block: ClassVar[int | None] = 4096

    def __post_init__(self) -> None:
        if self.model.rate_hz is None:
            raise InputError("LinearBench: the model is in continuous time; discretise it first.")

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        return float(self.model.rate_hz or 0.0)

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """The model's inputs."""
        return self.model.actuators

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The model's outputs."""
        return self.model.sensors

    @property
    def delayed(self) -> bool:
        """Whether the loop has a sample of delay more than the model's own."""
        return bool(np.any(self.model.D))

    @property
    def provenance(self) -> Provenance:
        """Which model answers."""
        return Provenance("bench.linear", {"rate_hz": self.rate_hz}, parents=(self.model.hash,))

    def _setup(self) -> Setup:
        return Setup(WHO, _Linear(self.model), self.rate_hz, self.actuators, self.sensors)


class _Linear(SteppedPlant):
    """The model, one sample on, or many at once with a linear law."""

    def __init__(self, model: StateSpace) -> None:
        self.model, self.direct = model, bool(np.any(model.D))
        self.x = np.zeros(model.states)
        self.low, self.high = (np.array([getattr(c, end) for c in model.sensors]) for end in ("low", "high"))

    def start(self, run_index: int) -> None:
        self.x[:] = 0.0

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is told by the readings
    def step(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        m, e = self.model, u + d
        if self.direct:
            y = m.C @ self.x + m.D @ e
            self.x[:] = m.A @ self.x + m.B @ e
        else:  # what was sent a sample ago is what the model calls its input then
            self.x[:] = m.A @ self.x + m.B @ e
            y = m.C @ self.x
        y = np.minimum(np.maximum(y, self.low), self.high)  # a third of the time of `np.clip`
        require_standing(WHO, y, k)
        return y

    def as_one(self, law: Controller | None) -> "_LinearLoop | None":
        if type(law) is SteppedController:
            return _LinearLoop(self, law.law)
        machine: MachineStep | None = getattr(law, "machine_step", lambda: None)()
        nu, ny = self.model.D.shape[::-1]
        if law is not None and (machine is None or machine.channels != (ny, nu)):
            return None
        return _LinearLoop(self, gain(np.zeros((nu, ny)), self.model.rate_hz), machine)


class _LinearLoop(AsOne):
    """A model, a linear law and one of machine code, compiled; its twin is one `step` of each after the other."""

    def __init__(self, plant: _Linear, law: StateSpace, machine: MachineStep | None = None) -> None:
        m = plant.model
        self._plant = spanned(m.A), spanned(m.B), turned(m.C), turned(m.D), plant.direct
        self._law = spanned(law.A), spanned(law.B), turned(law.C), turned(law.D)
        self._code, self._machine = called(machine), machine
        self._x, self._of_law = plant.x, np.zeros(law.states)
        self._readings = plant.low, plant.high

    def __call__(
        self, held: FloatArray, u: FloatArray, d: FloatArray, gain: FloatArray, limits: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]:
        from ultraquiet.bench.kernels import linear_loop

        asked, heard, answer = np.empty_like(u), np.empty((len(u), self._readings[0].size)), np.empty_like(held)
        ends, state = (*limits, *self._readings), (self._x, self._of_law, held)
        done = linear_loop(self._plant, self._law, self._code, ends, (u, d, gain), state, (asked, heard, answer))
        if done == len(u):
            return asked, heard, None, None
        ran_away = None if few_finite(heard[done]) else heard[done]
        return asked[:done], heard[:done], ran_away, answer if ran_away is None else None
