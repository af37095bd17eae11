"""The hexapod as a bench: two units and a rigid floor, sampled at 3.5 kHz."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, one_of, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.registry import register
from ultraquiet.bench._abstract import checked_controller, checked_law, checked_signals, commands
from ultraquiet.bench.hexapod.assemble import Mechanics, assemble
from ultraquiet.bench.hexapod.chain import Chain, chain, sampled_response
from ultraquiet.bench.hexapod.hysteresis import none, typical
from ultraquiet.bench.hexapod.parameters import BASES, RATE_HZ, STRUTS, Electronics, Geometry, Strut
from ultraquiet.values import Channel, Record, StateSpace

_NAMES = tuple(f"strut {i + 1}" for i in range(STRUTS))


@register("bench", "hexapod")
@dataclass(frozen=True)
class Hexapod:
    """SUITE's hexapod, simulated: six piezo commands in volts, six geophone readings in volts.

    M q'' + C q' + K q = E_p' k_p d V; amplifier, viscoelastic stages, geophones and anti-alias filter included, held
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
        limit = self._limits[0]
        return tuple(Channel(name, "V", -limit, limit) for name in _NAMES)

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """Readings of the six strut geophones, in volts."""
        limit = self._limits[2]
        return tuple(Channel(name, "V", -limit, limit) for name in _NAMES)

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
        u, d = checked_signals("Hexapod.run", STRUTS, actuation, disturbance)
        index = self._next_run() if run_index is None else whole("Hexapod.run", "run_index", run_index, 0)
        noise = self._noise(u.shape[1], index)
        if controller is None or isinstance(controller, StateSpace):
            command, y, limited = self._compiled(u, d, noise, controller)
        else:
            command, y, limited = self._stepped(u, d, noise, controller)
        lost = np.flatnonzero(~np.isfinite(command).all(axis=0))
        if lost.size:
            raise InputError(
                f"Hexapod.run: at sample {lost[0]} the controller's command was no longer a finite number; "
                f"it is unstable by itself or with this bench."
            )
        return self._record(command, y, limited, index)

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
    def _plant(self) -> tuple[FloatArray, ...]:
        """The plant as the kernels take it."""
        A, B, C = self._sampled
        plays = typical() if self.hysteresis and not self.linear else none()
        return _turned(A), _turned(B), np.array(C), plays.thresholds_v, plays.weights

    @cached_property
    def _limits(self) -> tuple[float, float, float, float]:
        """Limits of command, stack and reading in volts, and the step of the converter (0: none)."""
        e = self.electronics
        # The converter is used symmetrically: of its 2^bits codes the lowest stays unused, so both ends are +-10 V.
        step = e.reading_limit_v / (2 ** (self.adc_bits - 1) - 1) if self.quantise and not self.linear else 0.0
        if self.linear or not self.saturate:
            return np.inf, np.inf, np.inf, step
        return e.command_limit_v, e.stack_high_v - e.bias_v, e.reading_limit_v, step

    @cached_property
    def _runs(self) -> list[int]:
        """Number of runs so far: the one thing that changes, kept out of the settings."""
        return [0]

    def _next_run(self) -> int:
        self._runs[0] += 1
        return self._runs[0] - 1

    def _noise(self, samples: int, index: int) -> FloatArray:
        if self.linear or not self.noise:
            return np.zeros((samples, STRUTS))
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index,)))
        return self.electronics.noise_v * rng.standard_normal((samples, STRUTS))

    def _compiled(
        self, u: FloatArray, d: FloatArray, noise: FloatArray, law: StateSpace | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        from ultraquiet.bench import kernels

        if law is None:
            law = _silent()
        checked_law("Hexapod.run", law, RATE_HZ, STRUTS, STRUTS)
        command, y = np.empty((u.shape[1], STRUTS)), np.empty((u.shape[1], STRUTS))
        limited = np.zeros((2, STRUTS))
        inside = (_turned(law.A), _turned(law.B), _turned(law.C), _turned(law.D))
        kernels.loop(self._plant, inside, _turned(u), _turned(d), noise, self._limits, command, y, limited)
        return _turned(command), _turned(y), limited

    def _stepped(
        self, u: FloatArray, d: FloatArray, noise: FloatArray, controller: Any
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        from ultraquiet.bench import kernels

        law = checked_controller("Hexapod.run", controller, RATE_HZ, STRUTS, STRUTS)
        plant = self._plant
        u, d = _turned(u), _turned(d)
        command, y = np.empty_like(u), np.empty_like(u)
        limited = np.zeros((2, STRUTS))
        x, work = np.zeros(len(plant[0])), np.zeros(len(plant[0]))
        anchors = np.zeros((STRUTS, plant[4].size))
        held, stack = np.zeros(STRUTS), np.zeros(STRUTS)
        command_limit, stack_limit, reading_limit, step = self._limits
        for k in range(len(u)):
            kernels.read(plant[2], x, noise[k], reading_limit, step, y[k])
            asked = u[k] + commands("Hexapod.run", law.step(y[k].copy()), STRUTS, k)
            kernels.move(plant, x, anchors, held, d[k], stack_limit, stack, work, limited[1])
            kernels.clip(asked, command_limit, held, limited[0])
            command[k] = held
        return _turned(command), _turned(y), limited

    def _record(self, command: FloatArray, y: FloatArray, limited: FloatArray, index: int) -> Record:
        settings = {
            "unit": self.unit,
            "noise": self.noise and not self.linear,
            "adc_bits": self.adc_bits,
            "quantise": self.quantise and not self.linear,
            "saturate": self.saturate and not self.linear,
            "hysteresis": self.hysteresis and not self.linear,
            "run_index": index,
            "limited_commands": [int(v) for v in limited[0]],
            "limited_stacks": [int(v) for v in limited[1]],
            "limited_readings": [int(v) for v in np.count_nonzero(np.abs(y) >= self._limits[2], axis=1)],
        }
        made = Provenance("bench.hexapod", settings, self.seed)
        return Record(command, y, RATE_HZ, self.actuators, self.sensors, made)


def _silent() -> StateSpace:
    """Return the law that never acts, so that open loop needs no kernel of its own."""
    return StateSpace(
        np.zeros((0, 0)), np.zeros((0, STRUTS)), np.zeros((STRUTS, 0)), np.zeros((STRUTS, STRUTS)), RATE_HZ
    )


def _turned(matrix: FloatArray) -> FloatArray:
    """Return the transpose, contiguous and writable as the kernels expect."""
    return np.array(matrix.T, order="C")
