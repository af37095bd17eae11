"""A linear model as a bench: its loop is the one that was designed and analysed."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench.stepped import Setup, Stepped, SteppedPlant
from ultraquiet.values import Channel, StateSpace

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
    """The model, one sample on."""

    def __init__(self, model: StateSpace) -> None:
        self.model, self._direct = model, bool(np.any(model.D))
        self._x = np.zeros(model.states)
        self._low, self._high = (np.array([getattr(c, end) for c in model.sensors]) for end in ("low", "high"))

    def start(self, run_index: int) -> None:
        self._x = np.zeros(self.model.states)

    def step(self, u: FloatArray, d: FloatArray, k: int) -> FloatArray:
        m, e = self.model, u + d
        if self._direct:
            y = m.C @ self._x + m.D @ e
            self._x = m.A @ self._x + m.B @ e
        else:  # what was sent a sample ago is what the model calls its input then
            self._x = m.A @ self._x + m.B @ e
            y = m.C @ self._x
        return np.minimum(np.maximum(y, self._low), self._high)  # a third of the time of `np.clip`
