"""One hexapod as it is set up: settings, channels and its linear truth. What runs it stands in `unit.py`."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frequency_array, one_of, whole
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench.columns import spanned, turned
from ultraquiet.bench.hexapod.chain import Chain
from ultraquiet.bench.hexapod.laws import Limits, Plant
from ultraquiet.bench.hexapod.model import Model, built
from ultraquiet.bench.hexapod.physics.drift import REFERENCE_C, weather
from ultraquiet.bench.hexapod.physics.hysteresis import none, typical
from ultraquiet.bench.hexapod.physics.parameters import BASES, GEOPHONE_HZ, RATE_HZ
from ultraquiet.bench.hexapod.physics.parts import INSTRUMENTS
from ultraquiet.bench.hexapod.physics.sketched import sketch
from ultraquiet.bench.hexapod.wiring import ACTUATORS, SENSORS, channels, limits, noise
from ultraquiet.values import Channel, StateSpace
from ultraquiet.values.sketch import Sketch

MOST_SPREAD = 5.0  # times the tolerances: beyond, a draw may have no stiffness or mass left
TEMPERATURES_C = -50.0, 100.0  # where the linear laws of `drift.py` may still be believed, and every part is sound
GEOPHONES_HZ = 0.5, 30.0  # corners of geophones that are sold
MOST_DRIFT = 10.0  # times the stated temperatures: beyond, the stages would stiffen by half


@dataclass(frozen=True)
class HexapodSettings:
    """What a `Hexapod` is, whatever is sent to it; its fields are explained there."""

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
    geophone_hz: float = GEOPHONE_HZ

    def __post_init__(self) -> None:
        one_of("Hexapod", "unit", self.unit, tuple(BASES))
        one_of("Hexapod", "instruments", self.instruments, INSTRUMENTS)
        whole("Hexapod", "seed", self.seed, 0)
        whole("Hexapod", "unit_seed", self.unit_seed, 0)
        whole("Hexapod", "adc_bits", self.adc_bits, 4, 32)
        between("Hexapod", "spread", self.spread, 0.0, MOST_SPREAD)
        between("Hexapod", "drift", self.drift, 0.0, MOST_DRIFT)
        between("Hexapod", "geophone_hz", self.geophone_hz, *GEOPHONES_HZ, "Hz")

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
            "geophone_hz": float(self.geophone_hz),
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
        made_by = Provenance("bench.hexapod.linear_model", {**self.provenance.settings, "temperature_c": temperature_c})
        return StateSpace(Ad, Bd, Cd, np.zeros((ny, nu)), RATE_HZ, self.actuators, self.sensors, made_by)

    def linear_response(self, f_hz: ArrayLike, temperature_c: float = REFERENCE_C) -> ComplexArray:
        """Return the truth at `f_hz` (Hz), `(ny, nu, nf)`, by another route: complex stiffnesses, hold and images."""
        f = frequency_array("Hexapod.linear_response", f_hz)
        between("Hexapod.linear_response", "temperature_c", temperature_c, *TEMPERATURES_C, "degrees Celsius")
        return self.model.response(f, temperature_c) * np.exp(-2j * np.pi * f / RATE_HZ)

    def sketch(self) -> Sketch:
        """Return its joints and struts, and how the platform moves with the readings of the struts, base at rest."""
        return sketch(self.model.parts.at, len(self.sensors))

    @property
    def model(self) -> Model:
        """The unit's parts, put together; benches of the same unit share it."""
        return built(self.unit, self.instruments, float(self.spread), self.unit_seed, float(self.geophone_hz))

    @property
    def continuous(self) -> Chain:
        """The linear chain in continuous time, command to sensor volts."""
        return self.model.continuous

    def _matrices(self, temperature_c: float) -> Plant:
        """Return the plant as the kernels take it."""
        A, B, C = self.model.stepped_at(temperature_c)
        plays = typical() if self.hysteresis and not self.linear else none()
        return spanned(A), spanned(B), turned(C), plays.thresholds_v, plays.weights

    @cached_property
    def _limits(self) -> Limits:
        """Where commands, actuators and readings saturate, and how readings are rounded."""
        bits = self.adc_bits if self.quantise and not self.linear else None
        return limits(self.model.parts, bits, self.saturate and not self.linear)

    @property
    def _weather(self) -> Callable[[float], float]:
        return weather(self.unit, self.seed, 0.0 if self.linear else self.drift)

    def _noise(self, index: int) -> Callable[[int], FloatArray]:
        """Return what draws the noise of a run, `(samples, ny)` at a time."""
        ny = len(self._limits.reading_v)
        if self.linear or not self.noise:
            return lambda samples: np.zeros((samples, ny))
        return noise(self.seed, index, ny)
