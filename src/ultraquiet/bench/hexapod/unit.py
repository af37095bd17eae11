"""The hexapod as a bench: two units and a rigid floor, sampled at 3.5 kHz."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, one_of, whole
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench._abstract import (
    BLOCK_SAMPLES,
    RAMP_SAMPLES,
    Block,
    checked_controller,
    checked_law,
    checked_signals,
)
from ultraquiet.bench.hexapod.assemble import Mechanics, assemble
from ultraquiet.bench.hexapod.chain import Chain, chain, sampled_response
from ultraquiet.bench.hexapod.hysteresis import none, typical
from ultraquiet.bench.hexapod.parameters import BASES, RATE_HZ, STRUTS, Electronics, Geometry, Strut
from ultraquiet.bench.hexapod.simulation import Law, Limits, Linear, Matrices, Simulation, Stepped, turned
from ultraquiet.values import Channel, Record, StateSpace

_NAMES = tuple(f"strut {i + 1}" for i in range(STRUTS))


@register("bench", "hexapod")
@dataclass(frozen=True)
class Hexapod:
    """SUITE's hexapod, simulated: six piezo commands in volts, six geophone readings in volts.

    M q'' + C q' + K q = E_p' K_p d V; amplifier, viscoelastic stages, geophones and anti-alias filter included, held
    and sampled exactly at 3.5 kHz. The stacks take command[k-1] + disturbance[k], limited to -15..150 V, bias included.

    Args:
        unit: "ground" (150 kg base on 6 Hz mounts), "flight" (52 kg base, floating) or "rigid" (immovable floor).
        seed: where the noise starts; each run of one bench draws its own, by its number.
        noise: 10 mV of white noise on each reading.
        adc_bits: resolution of the readings over +-10 V.
        quantise: round the readings to the converter's steps.
        saturate: limit commands (+-25 V), stacks (-15..150 V) and readings (+-10 V).
        hysteresis: let the stacks lag by plays, a loop 5 to 8 % wide at +-25 V; gain one at 15 V.
        linear: shorthand for no noise, no rounding, no limits and no hysteresis.

    Raises:
        InputError: an unknown unit; signals of the wrong shape or with NaN; a controller of other dimensions.
        RateError: a controller made for another rate.

    What is left out, and where it would go: proof-mass actuators and tri-axial geophones, as further columns and rows
    of `assemble.Mechanics`, and struts that differ from one another, as vectors in `parameters.Strut`.

    >>> bench = Hexapod(unit="ground", seed=0)
    >>> record = bench.run(np.zeros((6, 100)))
    >>> record.outputs.shape, record.sensors[0].name
    ((6, 100), 'strut 1')

    Reference: sections 2 and 3.2 of the paper.
    """

    unit: str = "ground"
    seed: int = 0
    noise: bool = True
    adc_bits: int = 12
    quantise: bool = True
    saturate: bool = True
    hysteresis: bool = False
    linear: bool = False

    def __post_init__(self) -> None:
        one_of("Hexapod", "unit", self.unit, tuple(BASES))
        whole("Hexapod", "seed", self.seed, 0)
        whole("Hexapod", "adc_bits", self.adc_bits, 4, 32)

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        return RATE_HZ

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """Commands of the six stacks about their bias, in volts."""
        limits = self._limits.command_v
        return tuple(Channel(n, "V", -v, v) for n, v in zip(_NAMES, limits.tolist(), strict=True))

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """Readings of the six strut geophones, in volts."""
        limits = self._limits.reading_v
        return tuple(Channel(n, "V", -v, v) for n, v in zip(_NAMES, limits.tolist(), strict=True))

    def run(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        run_index: int | None = None,
    ) -> Record:
        """Start at rest, send `actuation`, return the record.

        Args:
            actuation: `(6, n)` volts.
            disturbance: `(6, n)` volts, added at the stacks without the computing delay.
            controller: a `StateSpace` or an object with `step(y)` and `reset()`; u = K y, its sign inside.
            run_index: which draw of the noise to take; the number of runs so far when absent.

        Returns:
            Inputs: actuation + K y as limited, in the sample it was formed; outputs: the readings. The provenance
            counts the samples in which a command, a stack or a reading met its limit.
        """
        index = self._numbered(run_index)
        run = self._simulation(actuation, disturbance, controller, index)
        (block,) = run.blocks(run.samples, None, RAMP_SAMPLES)
        made = self.provenance
        told = {
            "run_index": index,
            "limited_commands": block.limited_commands.tolist(),
            "limited_stacks": run.limited_actuators[:STRUTS].tolist(),
            "limited_readings": block.limited_readings.tolist(),
        }
        made = Provenance(made.made_by, {**made.settings, **told}, made.seed)
        return Record(block.command, block.readings, RATE_HZ, self.actuators, self.sensors, made)

    def stream(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        *,
        run_index: int | None = None,
        block_samples: int = BLOCK_SAMPLES,
        stop: Callable[[], bool] | None = None,
        ramp_samples: int = RAMP_SAMPLES,
    ) -> Iterator[Block]:
        """Yield the run of `run` in blocks, bit for bit; see `Streaming.stream`.

        What was measured before a controller failed is handed over as a shorter block; the next step raises.
        """
        block = whole("Hexapod.stream", "block_samples", block_samples, 1)
        ramp = whole("Hexapod.stream", "ramp_samples", ramp_samples, 1)
        index = self._numbered(run_index)
        return self._simulation(actuation, disturbance, controller, index).blocks(block, stop, ramp)

    @property
    def provenance(self) -> Provenance:
        """Who measures: the settings, as far as `linear` leaves them in force, and the seed."""
        settings = {
            "unit": self.unit,
            "noise": self.noise and not self.linear,
            "adc_bits": self.adc_bits,
            "quantise": self.quantise and not self.linear,
            "saturate": self.saturate and not self.linear,
            "hysteresis": self.hysteresis and not self.linear,
        }
        return Provenance("bench.hexapod", settings, self.seed)

    def linear_model(self) -> StateSpace:
        """Return the linear truth from command to reading, computing delay included: for judging, not for design."""
        A, B, C = self._sampled
        n = len(A)
        Ad = np.block([[A, B], [np.zeros((STRUTS, n + STRUTS))]])
        Bd = np.vstack([np.zeros((n, STRUTS)), np.eye(STRUTS)])
        Cd = np.hstack([C, np.zeros((STRUTS, STRUTS))])
        made = Provenance("bench.hexapod.linear_model", {"unit": self.unit})
        return StateSpace(Ad, Bd, Cd, np.zeros((STRUTS, STRUTS)), RATE_HZ, self.actuators, self.sensors, made)

    def linear_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return the truth at `f_hz` (Hz), `(6, 6, nf)`, by another route: complex stiffnesses, hold and images."""
        f = frequency_array("Hexapod.linear_response", f_hz)
        delay = np.exp(-2j * np.pi * f / RATE_HZ)
        return sampled_response(self.mechanics, self.electronics, f) * delay

    @property
    def electronics(self) -> Electronics:
        """Amplifier, conditioning and converters."""
        return Electronics()

    @cached_property
    def mechanics(self) -> Mechanics:
        """Bodies, struts and mounts."""
        return assemble(BASES[self.unit], Geometry(), Strut())

    @cached_property
    def continuous(self) -> Chain:
        """The linear chain in continuous time, stack command to sensor volts."""
        return chain(self.mechanics, self.electronics)

    @cached_property
    def _sampled(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.continuous.sampled(RATE_HZ)

    @cached_property
    def _plant(self) -> Matrices:
        """The plant as the kernels take it."""
        A, B, C = self._sampled
        plays = typical() if self.hysteresis and not self.linear else none()
        return turned(A), turned(B), turned(C), plays.thresholds_v, plays.weights

    @cached_property
    def _limits(self) -> Limits:
        """Where commands, stacks and readings saturate."""
        e = self.electronics
        # The converter is used symmetrically: of its 2^bits codes the lowest stays unused, so both ends are +-10 V.
        step = e.reading_limit_v / (2 ** (self.adc_bits - 1) - 1) if self.quantise and not self.linear else 0.0
        each = np.ones(STRUTS)
        if self.linear or not self.saturate:
            return Limits(np.inf * each, np.inf * each, np.inf * each, step)
        return Limits(e.command_limit_v * each, (e.stack_high_v - e.bias_v) * each, e.reading_limit_v * each, step)

    @cached_property
    def _runs(self) -> list[int]:
        """Number of runs so far: the one thing that changes, kept out of the settings."""
        return [0]

    def _numbered(self, run_index: int | None) -> int:
        if run_index is not None:
            return whole("Hexapod.run", "run_index", run_index, 0)
        self._runs[0] += 1
        return self._runs[0] - 1

    def _simulation(
        self, actuation: ArrayLike, disturbance: ArrayLike | None, controller: Any | None, index: int
    ) -> Simulation:
        u, d = checked_signals("Hexapod.run", STRUTS, actuation, disturbance)
        law = self._law(controller)
        return Simulation(lambda _: (self._plant, u.shape[1]), law, self._limits, u, d, self._noise(index), STRUTS)

    def _law(self, controller: Any | None) -> Law:
        if controller is None:
            return Linear(_silent(), STRUTS, STRUTS)
        if isinstance(controller, StateSpace):
            checked_law("Hexapod.run", controller, RATE_HZ, STRUTS, STRUTS)
            return Linear(controller, STRUTS, STRUTS)
        return Stepped(checked_controller("Hexapod.run", controller, RATE_HZ, STRUTS, STRUTS), STRUTS, STRUTS)

    def _noise(self, index: int) -> Callable[[int], FloatArray]:
        """Return what draws the noise of a run, `(samples, 6)` at a time."""
        if self.linear or not self.noise:
            return lambda samples: np.zeros((samples, STRUTS))
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index,)))
        return lambda samples: self.electronics.noise_v * rng.standard_normal((samples, STRUTS))


def _silent() -> StateSpace:
    """Return the law that never acts, so that open loop needs no kernel of its own."""
    return StateSpace(
        np.zeros((0, 0)), np.zeros((0, STRUTS)), np.zeros((STRUTS, 0)), np.zeros((STRUTS, STRUTS)), RATE_HZ
    )
