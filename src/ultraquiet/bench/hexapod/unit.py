"""The hexapod as a bench: two units and a rigid floor, sampled at 3.5 kHz."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import in_threads
from ultraquiet.bench._abstract import Block, Tally, block_of, checked_signals, ramp_of, require_unswapped
from ultraquiet.bench.hexapod.laws import Plant, closing
from ultraquiet.bench.hexapod.physics.drift import RENEWED_EVERY_S, RUN_EVERY_S
from ultraquiet.bench.hexapod.physics.parameters import RATE_HZ, STRUTS
from ultraquiet.bench.hexapod.physics.spread import told
from ultraquiet.bench.hexapod.settings import HexapodSettings
from ultraquiet.bench.hexapod.simulation import Simulation
from ultraquiet.values import Record, StateSpace


@register("bench", "hexapod")
@dataclass(frozen=True)
class Hexapod(HexapodSettings):
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
        geophone_hz: corner of the struts' geophones, 12 Hz in the paper; 4.5 and 1 Hz are sold too. Below it they hear
            jerk instead of velocity, and their own noise: it bounds how low the band of a law may begin.

    Raises:
        InputError: an unknown unit; signals of the wrong shape or with NaN; a controller of other dimensions.
        RateError: a controller made for another rate.

    >>> import numpy as np
    >>> bench = Hexapod(unit="ground", seed=0)
    >>> record = bench.run(np.zeros((6, 100)))
    >>> record.outputs.shape, record.sensors[0].name
    ((6, 100), 'strut 1')
    >>> [c.name for c in Hexapod(instruments="all").actuators[-2:]]
    ['base proof mass', 'payload proof mass']

    Reference: sections 2 and 3.2 of the paper.
    """

    side_by_side: ClassVar[bool] = True  # copies share nothing: a study may run several at once

    @property
    def temperature_c(self) -> float:
        """What the bench's thermometer says now, after the last block of the last run, in degrees Celsius."""
        return self._weather(self._clock[1])

    def drawn(self, seed: int) -> "Hexapod":
        """Return a unit drawn by a seed within `spread` times the tolerances, once them without a spread; own noise."""
        return replace(self, spread=self.spread or 1.0, unit_seed=seed, seed=seed)

    def drawn_parameters(self) -> dict[str, float]:
        """Return what was drawn of this unit: numbers by name, of struts and lines their mean and their spread."""
        return told(self.model.parts)

    def instrumented(self) -> "Hexapod":
        """Return this unit with its proof masses free and the geophones of base and payload read."""
        return replace(self, instruments="all")

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
        (block,) = run.blocks(run.samples, None, 1)
        tally = Tally()
        tally.take(block)
        facts = {"run_index": index, "temperature_c": self._weather(RUN_EVERY_S * index), **tally.counts()}
        provenance = replace(self.provenance, settings={**self.provenance.settings, **facts})
        return Record(block.command, block.readings, RATE_HZ, self.actuators, self.sensors, provenance)

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
        """Yield the run of `run` in blocks, bit for bit; see `Streaming.stream`.

        What was measured before a controller failed is handed over as a shorter block; the next step raises.
        """
        block = block_of("Hexapod.stream", block_samples, self.rate_hz)
        ramp = ramp_of("Hexapod.stream", ramp_samples, self.rate_hz)
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

        The compiled loop lets go of Python's lock, so threads share the processors and the unit's matrices. A
        controller that is stepped holds the lock and has one state: its runs follow one another.

        Args:
            seeds: where noise and drift of each run start.
            actuation: as in `run`, the same for all.
            disturbance: likewise.
            controller: likewise.
            own_units: draw each run's unit, too, by its seed; needs a spread.

        >>> import numpy as np
        >>> first, second = Hexapod().campaign(range(2), np.zeros((6, 100)))
        >>> bool((second.outputs == Hexapod(seed=1).run(np.zeros((6, 100))).outputs).all())
        True
        """
        if not len(seeds):
            raise InputError("Hexapod.campaign: 'seeds' must name at least one run, got none.")
        if own_units and not self.spread:
            raise InputError("Hexapod.campaign: units of their own need a 'spread' above zero, or all are the same.")
        checked = [whole("Hexapod.campaign", "seeds", seed, 0) for seed in seeds]

        def first_run(seed: int) -> Record:
            bench = replace(self, seed=seed, unit_seed=seed if own_units else self.unit_seed)
            return bench.run(actuation, disturbance, controller, run_index=0)

        stepped = controller is not None and not isinstance(controller, StateSpace)
        records = in_threads("campaign", first_run, list(dict.fromkeys(checked)), 1 if stepped else None)
        return tuple(records[seed] for seed in checked)

    @cached_property
    def _clock(self) -> list[float]:
        """Number of runs so far and seconds on the bench's clock: what changes, kept out of the settings."""
        return [0, 0.0]

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
        require_unswapped("Hexapod.run", controller, self)
        law = closing(controller, nu, ny, RATE_HZ, STRUTS)
        return Simulation(self._plants(index), law, self._limits, u, d, self._noise(index), STRUTS)

    def _plants(self, index: int) -> Callable[[int], tuple[Plant, int]]:
        """Return what gives the plant at a sample of a run, and for how many samples it holds."""
        every, celsius = round(RENEWED_EVERY_S * RATE_HZ), self._weather
        renewed: dict[int, Plant] = {}  # the matrices of one second, the present one

        def at(sample: int) -> tuple[Plant, int]:
            second = sample // every
            self._clock[1] = RUN_EVERY_S * index + sample / RATE_HZ
            if second not in renewed:
                renewed.clear()
                renewed[second] = self._matrices(celsius(RUN_EVERY_S * index + RENEWED_EVERY_S * second))
            return renewed[second], every * (second + 1) - sample

        return at
