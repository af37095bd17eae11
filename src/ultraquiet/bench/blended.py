"""Any bench seen through blending matrices."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
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
    limits,
    ramp_of,
    require_unswapped,
)
from ultraquiet.bench.inner import Around, blocks_of, ended, named_provenance
from ultraquiet.values import Blending, Channel, Controller, StateSpace
from ultraquiet.values.blended.matrices import blend

# Of a command, what a product of matrices and a limit at its very end may change by rounding.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Blended(Around):
    """A bench in modes: commands u = Ta v go out, readings q = Ts y come back; see `values.Blending`.

    Commands without a law are limited to the modes' range, within which no actuator is limited; with a law the
    actuators limit what it asks for, as they would on the bench itself. A disturbance is one of modes, too. Noise comes
    through the matrix: Ts R Ts'.

    Args:
        bench: any bench.
        blending: of its sensors and actuators.

    Raises:
        InputError: a blending of other channels.

    >>> from ultraquiet.bench.wrapped import Wrapped
    >>> pair = Wrapped(lambda u, d: [u[0] + d[0], u[0]], lambda: None, 100.0, ["shaker"], ["left", "right"])
    >>> bench = Blended(pair, Blending([[0.5, 0.5]], [[2.0]], pair.sensors, pair.actuators, ["heave"]))
    >>> bench.run([[1.0, 0.0]]).outputs.tolist()
    [[0.0, 2.0]]
    """

    bench: Bench
    blending: Blending

    def __post_init__(self) -> None:
        self.blending.check("of the bench", self.bench.actuators, self.bench.sensors)

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        return self.bench.rate_hz

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """The modes that are driven."""
        return self.blending.actuator_modes

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The modes that are read."""
        return self.blending.sensor_modes

    @property
    def provenance(self) -> Provenance:
        """Who measures, and through what."""
        return named_provenance("bench.blended", self.bench, {"blending": self.blending.hash})

    def seen(self, model: StateSpace) -> StateSpace:
        """Return a linear model of the bench as it is seen through this one."""
        return self.blending.plant(model)

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
        low, high = limits(self.actuators)
        v, d = checked_signals("Blended.run", len(self.actuators), actuation, disturbance)
        allowed = np.clip(v, low[:, None], high[:, None])
        Ta = self.blending.actuator_matrix
        law = None if controller is None else self.on_the_bench(controller)
        sizes = block_of("Blended.run", block_samples, self.rate_hz), ramp_of("Blended.run", ramp_samples, self.rate_hz)
        how = {"run_index": run_index, "block_samples": sizes[0], "stop": stop, "ramp_samples": sizes[1]}
        given = None if disturbance is None else blend(Ta, d)
        return self._modes(blocks_of(self.bench, blend(Ta, allowed), given, law, **how), allowed, v != allowed)

    def on_the_bench(self, controller: StateSpace | Controller) -> StateSpace | Controller:
        """Return a law of modes as one of the bench's own readings and commands, u = Ta K Ts y."""
        require_unswapped("Blended.run", controller, self)
        if isinstance(controller, StateSpace):
            return self.blending.law(controller)
        law = checked_controller("Blended.run", controller, self.rate_hz, len(self.sensors), len(self.actuators))
        return _InModes(law, self.blending, self.rate_hz)

    def _commands(self, sent: FloatArray, u: FloatArray) -> FloatArray:
        """Return the modes of commands: what was sent, to the bit, and beside it what a law or a limit has changed."""
        beside = u - blend(self.blending.actuator_matrix, sent)
        return sent + self.blending.commands(np.where(np.abs(beside) > ROUNDING * np.abs(u), beside, 0.0))

    def _modes(
        self, blocks: Iterator[Block], sent: FloatArray, limited: "np.ndarray[Any, np.dtype[np.bool_]]"
    ) -> Iterator[Block]:
        start = 0
        with ended(blocks):
            for block in blocks:
                stop = start + block.command.shape[1]
                # A mode met its limit where one of the channels that it is made of did.
                commands = _shared(self.blending.actuator_matrix.T, block.limited_commands)
                own = np.count_nonzero(limited[:, start:stop], axis=1)
                yield replace(
                    block,
                    command=self._commands(sent[:, start:stop], block.command),
                    readings=blend(self.blending.sensor_matrix, block.readings),
                    limited_commands=np.minimum(commands + own, stop - start),
                    limited_readings=_shared(self.blending.sensor_matrix, block.limited_readings),
                )
                start = stop


class _InModes:
    """A controller of modes, stepped with the bench's readings."""

    def __init__(self, law: Controller, blending: Blending, rate_hz: float) -> None:
        self._law, self._blending, self.rate_hz = law, blending, rate_hz

    def reset(self) -> None:
        self._law.reset()

    def step(self, y: FloatArray) -> FloatArray:
        answer = np.asarray(self._law.step(blend(self._blending.sensor_matrix, y)), dtype=np.float64).reshape(-1)
        return blend(self._blending.actuator_matrix, answer)


def _shared(rows: FloatArray, counts: "np.ndarray[Any, np.dtype[np.int64]]") -> "np.ndarray[Any, np.dtype[np.int64]]":
    """Return for each mode the count of the worst channel that it is made of."""
    return np.max(np.where(rows != 0.0, np.asarray(counts)[None, :], 0), axis=1)
