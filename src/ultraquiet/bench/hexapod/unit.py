"""The hexapod as a bench: two units and a rigid floor, sampled at 3.5 kHz."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frequency_array, one_of, whole
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench._abstract import BLOCK_SAMPLES, RAMP_SAMPLES, Block, Tally, checked_signals
from ultraquiet.bench.hexapod.campaign import campaign
from ultraquiet.bench.hexapod.chain import Chain
from ultraquiet.bench.hexapod.laws import Limits, Matrices, closing, turned
from ultraquiet.bench.hexapod.model import Model, built
from ultraquiet.bench.hexapod.physics.drift import REFERENCE_C, RENEWED_EVERY_S, RUN_EVERY_S, weather
from ultraquiet.bench.hexapod.physics.hysteresis import none, typical
from ultraquiet.bench.hexapod.physics.parameters import BASES, RATE_HZ, STRUTS
from ultraquiet.bench.hexapod.physics.parts import INSTRUMENTS
from ultraquiet.bench.hexapod.simulation import Simulation
from ultraquiet.bench.hexapod.wiring import ACTUATORS, SENSORS, channels, limits, noise
from ultraquiet.values import Channel, Record, StateSpace

MOST_SPREAD = 5.0  # times the tolerances: beyond, a draw may have no stiffness or mass left
TEMPERATURES_C = -50.0, 100.0  # where the linear laws of `drift.py` may still be believed, and every part is sound
MOST_DRIFT = 10.0  # times the stated temperatures: beyond, the stages would stiffen by half


@register("bench", "hexapod")
@dataclass(frozen=True)
class Hexapod:
    """SUITE's hexapod, simulated: piezo commands in volts, geophone readings in volts.

    M q'' + C q' + K q = E_p' K_p d V + F; amplifiers, viscoelastic stages, geophones and anti-alias filters included,
    held and sampled exactly at 3.5 kHz. Actuators take command[k-1] + disturbance[k], limited: stacks to -15..150 V,
    bias included.

    Args:
        unit: "ground" (150 kg base on 6 Hz mounts), "flight" (65 kg base, floating) or "rigid" (immovable floor).
        seed: where noise and drift start; each run of one bench draws its own, by its number.
        noise: 10 mV of white noise on each reading.
        adc_bits: resolution of the readings over +-10 V.
        quantise: round the readings to the converter's steps.
        saturate: limit commands (+-25 V, proof masses +-10 V), stacks (-15..150 V) and readings (+-10 V).
        hysteresis: let the stacks lag by plays, a loop 5 to 8 % wide at +-25 V; gain one at 15 V.
        linear: shorthand for no noise, no rounding, no limits, no hysteresis and no drift.
        instruments: "struts" (6 actuators, 6 sensors; proof masses held fast) or "all": 8 actuators, proof masses of
            base and payload last, and 12 sensors, x, y and z of the base's and the payload's geophone last. On a rigid
            floor those of the base are there, but move nothing and read nothing but noise.
        spread: how far this unit differs from the drawing; 1 draws all numbers within the tolerances of `spread.py`.
        unit_seed: which unit is drawn.
        drift: how far the temperature moves within and between runs; 1 takes the cycles of `drift.py`. A run starts
            each minute of the bench's clock.

    Raises:
        InputError: an unknown unit; signals of the wrong shape or with NaN; a controller of other dimensions.
        RateError: a controller made for another rate.

    >>> bench = Hexapod(unit="ground", seed=0)
    >>> record = bench.run(np.zeros((6, 100)))
    >>> record.outputs.shape, record.sensors[0].name
    ((6, 100), 'strut 1')
    >>> [c.name for c in Hexapod(instruments="all").actuators[-2:]]
    ['base proof mass', 'payload proof mass']

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
    instruments: str = "struts"
    spread: float = 0.0
    unit_seed: int = 0
    drift: float = 0.0

    def __post_init__(self) -> None:
        one_of("Hexapod", "unit", self.unit, tuple(BASES))
        one_of("Hexapod", "instruments", self.instruments, INSTRUMENTS)
        whole("Hexapod", "seed", self.seed, 0)
        whole("Hexapod", "unit_seed", self.unit_seed, 0)
        whole("Hexapod", "adc_bits", self.adc_bits, 4, 32)
        between("Hexapod", "spread", self.spread, 0.0, MOST_SPREAD)
        between("Hexapod", "drift", self.drift, 0.0, MOST_DRIFT)

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        return RATE_HZ

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """Commands in volts: those of the six stacks about their bias, then those of the proof masses."""
        return channels(ACTUATORS, self._limits.command_v)

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """Readings in volts: the six strut geophones, then the axes of base and payload."""
        return channels(SENSORS, self._limits.reading_v)

    @property
    def temperature_c(self) -> float:
        """What the bench's thermometer says now, after the last block of the last run, in degrees Celsius."""
        return self._weather(self._clock[1])

    def run(
        self,
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        run_index: int | None = None,
    ) -> Record:
        """Start at rest, send `actuation`, return the record.

        Args:
            actuation: `(6, n)` volts, `(8, n)` with all instruments.
            disturbance: likewise, added at the actuators without the computing delay.
            controller: a `StateSpace` or an object with `step(y)` and `reset()`; u = K y, its sign inside. With all
                instruments it may still be one from six readings of the struts to their six commands.
            run_index: which draw of the noise, and minute of drift, to take; the number of runs so far when absent.

        Returns:
            Inputs: actuation + K y as limited, in the sample it was formed; outputs: the readings. The provenance
            counts the samples in which a command, a stack, a proof mass or a reading met its limit, and tells the
            temperature at the start.
        """
        index = self._numbered(run_index)
        run = self._simulation(actuation, disturbance, controller, index)
        (block,) = run.blocks(run.samples, None, RAMP_SAMPLES)
        made = self.provenance
        met = Tally()
        met.take(block)
        told = {"run_index": index, "temperature_c": self._weather(RUN_EVERY_S * index), **met.told()}
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

    def campaign(
        self,
        seeds: Sequence[int],
        actuation: ArrayLike,
        disturbance: ArrayLike | None = None,
        controller: Any | None = None,
        own_units: bool = False,
    ) -> tuple[Record, ...]:
        """Return one record per seed, each bit for bit the first run of this bench with that seed, on all processors.

        Args:
            seeds: where noise and drift of each run start.
            actuation: as in `run`, the same for all.
            disturbance: likewise.
            controller: likewise.
            own_units: draw each run's unit, too, by its seed; needs a spread.

        >>> first, second = Hexapod().campaign(range(2), np.zeros((6, 100)))
        >>> bool((second.outputs == Hexapod(seed=1).run(np.zeros((6, 100))).outputs).all())
        True
        """
        return campaign(self, seeds, actuation, disturbance, controller, own_units)

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
            "instruments": self.instruments,
            "spread": self.spread,
            "unit_seed": self.unit_seed,
            "drift": 0.0 if self.linear else self.drift,
        }
        return Provenance("bench.hexapod", settings, self.seed)

    def linear_model(self, temperature_c: float = REFERENCE_C) -> StateSpace:
        """Return the linear truth from command to reading, computing delay included: for judging, not for design."""
        between("Hexapod.linear_model", "temperature_c", temperature_c, *TEMPERATURES_C, "degrees Celsius")
        A, B, C = self.model.sampled_at(temperature_c)
        (n, nu), ny = B.shape, len(C)
        Ad = np.block([[A, B], [np.zeros((nu, n + nu))]])
        Bd = np.vstack([np.zeros((n, nu)), np.eye(nu)])
        Cd = np.hstack([C, np.zeros((ny, nu))])
        made = Provenance("bench.hexapod.linear_model", {**self.provenance.settings, "temperature_c": temperature_c})
        return StateSpace(Ad, Bd, Cd, np.zeros((ny, nu)), RATE_HZ, self.actuators, self.sensors, made)

    def linear_response(self, f_hz: ArrayLike, temperature_c: float = REFERENCE_C) -> ComplexArray:
        """Return the truth at `f_hz` (Hz), `(ny, nu, nf)`, by another route: complex stiffnesses, hold and images."""
        f = frequency_array("Hexapod.linear_response", f_hz)
        between("Hexapod.linear_response", "temperature_c", temperature_c, *TEMPERATURES_C, "degrees Celsius")
        return self.model.response(f, temperature_c) * np.exp(-2j * np.pi * f / RATE_HZ)

    @property
    def model(self) -> Model:
        """The unit's parts, put together; benches of the same unit share it."""
        return built(self.unit, self.instruments, float(self.spread), self.unit_seed)

    @property
    def continuous(self) -> Chain:
        """The linear chain in continuous time, command to sensor volts."""
        return self.model.continuous

    def _matrices(self, temperature_c: float) -> Matrices:
        """Return the plant as the kernels take it."""
        A, B, C = self.model.sampled_at(temperature_c)
        plays = typical() if self.hysteresis and not self.linear else none()
        return turned(A), turned(B), turned(C), plays.thresholds_v, plays.weights

    @cached_property
    def _limits(self) -> Limits:
        """Where commands, actuators and readings saturate, and how readings are rounded."""
        bits = self.adc_bits if self.quantise and not self.linear else None
        return limits(self.model.parts, bits, self.saturate and not self.linear)

    @cached_property
    def _clock(self) -> list[float]:
        """Number of runs so far and seconds on the bench's clock: what changes, kept out of the settings."""
        return [0, 0.0]

    @property
    def _weather(self) -> Callable[[float], float]:
        return weather(self.unit, self.seed, 0.0 if self.linear else self.drift)

    def _numbered(self, run_index: int | None) -> int:
        if run_index is not None:
            return whole("Hexapod.run", "run_index", run_index, 0)
        self._clock[0] += 1
        return int(self._clock[0]) - 1

    def _simulation(
        self, actuation: ArrayLike, disturbance: ArrayLike | None, controller: Any | None, index: int
    ) -> Simulation:
        nu, ny = len(self._limits.command_v), len(self._limits.reading_v)
        u, d = checked_signals("Hexapod.run", nu, actuation, disturbance)
        law = closing(controller, nu, ny, RATE_HZ, STRUTS)
        return Simulation(self._plants(index), law, self._limits, u, d, self._noise(index), STRUTS)

    def _plants(self, index: int) -> Callable[[int], tuple[Matrices, int]]:
        """Return what gives the plant at a sample of a run, and for how many samples it holds."""
        every, celsius = round(RENEWED_EVERY_S * RATE_HZ), self._weather
        held: dict[int, Matrices] = {}

        def at(sample: int) -> tuple[Matrices, int]:
            second = sample // every
            self._clock[1] = RUN_EVERY_S * index + sample / RATE_HZ
            if second not in held:
                held.clear()
                held[second] = self._matrices(celsius(RUN_EVERY_S * index + RENEWED_EVERY_S * second))
            return held[second], every * (second + 1) - sample

        return at

    def _noise(self, index: int) -> Callable[[int], FloatArray]:
        """Return what draws the noise of a run, `(samples, ny)` at a time."""
        ny = len(self._limits.reading_v)
        if self.linear or not self.noise:
            return lambda samples: np.zeros((samples, ny))
        return noise(self.seed, index, ny)
