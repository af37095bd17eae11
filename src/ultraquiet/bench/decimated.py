"""Any bench at a control rate that is a fraction of its sampling rate."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench._abstract import (
    Bench,
    Block,
    block_of,
    checked_controller,
    checked_signals,
    commands,
    ramp_of,
    require_unswapped,
)
from ultraquiet.bench.inner import Around, blocks_of, ended, named_provenance
from ultraquiet.values import Channel, Controller, Decimation, StateSpace


@dataclass(frozen=True)
class Decimated(Around):
    """A bench whose readings are filtered and decimated and whose commands are held; see `values.Decimation`.

    A disturbance is held, not delayed. Filter, hold and latency are part of this bench: a model identified on it has
    them inside, and a law designed with it runs on the bench behind as `on_the_bench(law)`, which filters, decimates
    and holds by itself.

    Args:
        bench: any bench.
        decimation: of its clock.

    >>> from ultraquiet.bench.wrapped import Wrapped
    >>> fast = Wrapped(lambda u, d: u + d, lambda: None, 8000.0, ["force"], ["acceleration"])
    >>> slow = Decimated(fast, Decimation(4, averages=0))
    >>> slow.rate_hz, slow.run([[1.0, 2.0, 3.0]]).outputs.tolist()
    (2000.0, [[0.0, 1.0, 2.0]])
    """

    bench: Bench
    decimation: Decimation

    @property
    def rate_hz(self) -> float:
        """Control rate in Hz."""
        return self.bench.rate_hz / self.decimation.factor

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """The bench's actuators."""
        return self.bench.actuators

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The bench's sensors; an average stays within their limits."""
        return self.bench.sensors

    @property
    def provenance(self) -> Provenance:
        """Who measures, and how it is decimated."""
        d = self.decimation
        return named_provenance(
            "bench.decimated", self.bench, {"factor": d.factor, "averages": d.averages, "wait": d.wait}
        )

    def seen(self, model: StateSpace) -> StateSpace:
        """Return a linear model of the bench as it is seen through this one."""
        return self.decimation.plant(model)

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
        """Yield the run of `run` in blocks; see `Streaming.stream`."""
        N = self.decimation.factor
        u, d = checked_signals("Decimated.run", len(self.actuators), actuation, disturbance)
        size = block_of("Decimated.run", block_samples, self.rate_hz)
        ramp = ramp_of("Decimated.run", ramp_samples, self.rate_hz)
        law = None if controller is None else self.on_the_bench(controller)
        held = None if disturbance is None else np.repeat(d, N, axis=1)
        how = {"run_index": run_index, "block_samples": size * N, "stop": stop, "ramp_samples": ramp * N}
        return self._control_samples(blocks_of(self.bench, self.decimation.held(u), held, law, **how))

    def on_the_bench(self, controller: StateSpace | Controller) -> Controller:
        """Return a law at the control rate as a controller at the bench's rate."""
        nu, ny = len(self.actuators), len(self.sensors)
        require_unswapped("Decimated.run", controller, self)
        law = checked_controller("Decimated.run", controller, self.rate_hz, ny, nu)
        return HeldController(law, self.decimation, self.bench.rate_hz, (ny, nu))

    def _control_samples(self, blocks: Iterator[Block]) -> Iterator[Block]:
        N, wait, memory = self.decimation.factor, self.decimation.wait, self.decimation.taps.size - 1
        past = np.zeros((len(self.sensors), memory))
        rest_u, rest_y = np.zeros((len(self.actuators), 0)), np.zeros((len(self.sensors), 0))
        with ended(blocks):
            for block in blocks:
                u, y = np.hstack([rest_u, block.command]), np.hstack([rest_y, block.readings])
                whole_frames = u.shape[1] // N * N
                rest_u, rest_y = u[:, whole_frames:], y[:, whole_frames:]
                if not whole_frames:
                    continue
                seen = np.hstack([past, y[:, :whole_frames]])
                readings = self.decimation.filtered(
                    [seen[:, memory - j :][:, :whole_frames:N] for j in range(memory + 1)]
                )
                past = seen[:, seen.shape[1] - memory :]
                limited_u, limited_y = (-(-c // N) for c in (block.limited_commands, block.limited_readings))
                yield Block(u[:, wait:whole_frames:N], readings, limited_u, limited_y, block.overruns, block.further)


class HeldController:
    """A controller at the control rate, stepped at the bench's: it filters, decimates, waits and holds.

    Args:
        law: stepped once in `decimation.factor` samples.
        decimation: of the clock.
        rate_hz: of the bench.
        size: readings and commands, `(ny, nu)`.
    """

    def __init__(self, law: Controller, decimation: Decimation, rate_hz: float, size: tuple[int, int]) -> None:
        self._law, self._decimation, self.rate_hz = law, decimation, rate_hz
        self._ny, self._nu = size
        self.reset()

    def reset(self) -> None:
        """Return to rest: no reading remembered, no command held."""
        self._law.reset()
        taps = self._decimation.taps.size
        self._past: deque[FloatArray] = deque([np.zeros(self._ny)] * taps, maxlen=taps)
        self._next, self._now, self._k = np.zeros(self._nu), np.zeros(self._nu), 0

    def step(self, y: FloatArray) -> FloatArray:
        """Return the command that is held in this sample of the bench, `(nu,)`, for readings `(ny,)`."""
        self._past.appendleft(np.array(y, dtype=np.float64))
        phase = self._k % self._decimation.factor
        if phase == 0:
            answer = self._law.step(self._decimation.filtered(list(self._past)))
            self._next = commands("Decimated.run", answer, self._nu, self._k // self._decimation.factor)
        if phase == self._decimation.wait:
            self._now = self._next
        self._k += 1
        return self._now
