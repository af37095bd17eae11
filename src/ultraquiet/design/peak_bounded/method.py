"""Quiet in every direction of several plants at once, the price in amplification and control bounded beforehand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from ultraquiet._base.constraints import (
    FloatArray,
    between,
    over_frequency,
    positive,
    real_array,
    rising_band,
    same_rate,
    whole,
)
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import lookup, register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.margins import bounded_response
from ultraquiet.analyse.peaks import response_at
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design.hinf.band_attenuation import common_mode
from ultraquiet.design.law_structure.plane import plane_of
from ultraquiet.design.peak_bounded.campaign import SearchFromStarts, Start
from ultraquiet.design.peak_bounded.demands import Demands
from ultraquiet.design.peak_bounded.loops.scenarios import perturbed
from ultraquiet.design.peak_bounded.outcome import SearchFigures, among, figures, rms_reduction_db, with_price
from ultraquiet.design.peak_bounded.roof import roof
from ultraquiet.design.peak_bounded.start import Places, begun, hardly, starts, unasked_starts
from ultraquiet.design.peak_bounded.units import SearchUnits, units_of
from ultraquiet.design.peak_bounded.washout import behind, heard_through, require_room
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.structure_words import DECENTRALISED, FULL, REPEATED, SYMMETRIC, structure_word
from ultraquiet.design.verification import judged
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.door import system
from ultraquiet.values.interconnect import of_one_channel
from ultraquiet.values.state_space import StateSpace

WHO = "PeakBounded"
STRUCTURES = (REPEATED, DECENTRALISED, SYMMETRIC, FULL)
INVERSIONS = 60.0  # by default K S may be so many times what inverting the plant's weakest direction in the band takes
HEARD = 1e-3  # of the strongest direction: weaker ones do not count for that
BEGUN = 3  # plants for which a law to begin with is designed
ALIKE_COSINE = 0.5  # of the phases of a plant's eigenvalues: within 60 degrees of their mean one scalar law serves all
ALIKE_SHARE = 0.9  # of the lines of the band

Plants = StateSpace | Sequence[StateSpace]


@register("design", "peak-bounded")
@dataclass(frozen=True)
class PeakBounded(StatedRobustness):
    """The law that makes a band quietest while nothing is amplified, and no command driven, beyond stated bounds.

    max A subject to sigma(S) <= -A in the band, sigma(S) <= peak elsewhere, sigma(K S) <= limit, sigma(T) <= shape, in
    every direction of every plant, by steps on all singular values near the greatest at once. No direction of S can be
    small everywhere that a structure rings: without a band it is S G whose greatest singular value is lowered.

    Args:
        band_hz: the band to be quiet, Hz. Absent, the response S G is what is lowered, over the first plant's own band
            (`even_plant`).
        peak_db: largest amplification in dB anywhere, or a shape (frequencies in Hz, dB).
        states: of each part of the law, even; of the whole law where it is `full`.
        structure: `repeated` one scalar law on every channel; `decentralised` one for each; `symmetric` one along each
            of the `coordinates`, shared by those of one number in `blocks`; `full` one law for all. Absent, `repeated`
            where the plant moves all channels alike over the band, else `full`.
        coordinates: orthonormal columns, `(channels, channels)`.
        blocks: a number for each of them.
        control_limit: largest K S in command per reading, or a shape (frequencies in Hz, gains); absent, 60 times what
            inverting the weakest direction in the band takes.
        complementary_db: shape for T = G K S, in dB; none when absent.
        washout_hz: corner of a first-order high-pass that every reading passes first, below the band: an offset of a
            reading then moves no command, however large K S is near 0 Hz. No such filter when absent.
        tones_hz, tone_db: where S is to be lower still, by resonators inside the law, and how low, in dB.
        tone_zeta: damping of the resonators.
        gain_spread: by what share a channel may be off, in gain or in phase: what tolerances of sensors, actuators,
            amplifiers and filters add up to.
        mode_spread: by what share frequencies of modes may be off.
        draws: plants drawn within that spread round each one given, on which all bounds are to hold too; 0 for none.
            Those that decide join the search; the others are looked at.
        start: a design, its table with a `method`, or a law, to begin with; a scalar one for the scalar structures, or
            one that repeats it on every channel.
            `BandAttenuation` of each of the first three plants when absent, `Lqg` and `MixedSensitivity` where no band
            is given either, for what all channels share where the structure is scalar; for `decentralised` laws also
            what a search finds from there for all channels alike.
        steps: of the search on the plants given, and half as many whenever plants drawn join it, at most.
        seed: of the draws.

    A law's poles are stable and damped by 3 % at least, whatever the search does. Near Nyquist, where a mode's
    frequency is less certain than its width, the law stays so small that no phase can matter (`roof`).

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = PeakBounded(band_hz=(10.0, 100.0), states=2, draws=0).design(plant)
    >>> result.status.ok, result.peak_sensitivity_db < 6.1
    (True, True)

    Boyd, Hast and Astrom 2016, doi:10.1002/rnc.3376 (multivariable PID by convex steps, the idea); Fletcher 1987,
    "Practical Methods of Optimization", chapter 14 (exact penalty and second-order correction).
    """

    several_plants: ClassVar[bool] = True  # `design` takes a sequence of them

    band_hz: tuple[float, float] | None = None
    peak_db: Any = 6.0
    states: int = 16
    structure: str | None = None
    coordinates: tuple[tuple[float, ...], ...] | None = None
    blocks: tuple[int, ...] | None = None
    control_limit: Any = None
    complementary_db: Any = None
    washout_hz: float | None = None
    tones_hz: tuple[float, ...] = ()
    tone_db: float = 40.0
    tone_zeta: float = 0.002
    gain_spread: float = 0.1
    mode_spread: float = 0.03
    draws: int = 2
    start: Any = None
    steps: int = 40
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.structure is not None:
            object.__setattr__(self, "structure", structure_word(WHO, self.structure, STRUCTURES))
        if self.structure == SYMMETRIC and (self.coordinates is None or self.blocks is None):
            raise InputError(f"{WHO}: the structure 'symmetric' needs 'coordinates' and 'blocks'.")
        if whole(WHO, "states", self.states, 0) % 2:
            raise InputError(f"{WHO}: 'states' must be even, got {self.states}.")
        if self.band_hz is not None:
            rising_band(WHO, self.band_hz)
        for name in ("gain_spread", "mode_spread"):
            between(WHO, name, getattr(self, name), 0.0, 0.5)
        for name in ("tone_db", "tone_zeta", "washout_hz"):
            if getattr(self, name) is not None:
                positive(WHO, name, getattr(self, name))
        whole(WHO, "draws", self.draws, 0)
        whole(WHO, "steps", self.steps, 1)
        whole(WHO, "seed", self.seed, 0)
        over_frequency(WHO, "peak_db", self.peak_db, logarithmic=False)

    @property
    def square_plants(self) -> bool:
        """Whether `design` takes square plants alone, as for a law of scalar ones."""
        return self.structure not in (None, FULL)

    @single_threaded
    def design(self, plant: Plants) -> DesignResult:
        """Return the law u = K y; margins, poles and peak are those with the first plant, the verdict is on all.

        Args:
            plant: G, or several of one shape and rate: units, models from several records.

        `details["figures"]` holds what was reached on each (`SearchFigures`), `details["attenuation_db"]` and
        `details["tones_db"]` the least of it. The status is `fragile` where a plant keeps less than `disk_margin`, and
        `short` where a bound could not be met or nothing got quieter.

        Raises:
            InputError: no plants, shapes or rates that differ, a scalar structure for a plant that is not square, a
                washout within the band or for a plant with a pole at 0 Hz.
        """
        plants = _checked(plant)
        structure = self.structure or _structure_for(plants[0], self.band_hz)
        if structure != FULL and plants[0].D.shape[0] != plants[0].D.shape[1]:
            raise InputError(f"{WHO}: a '{structure}' law needs as many outputs as inputs, got {plants[0].D.shape}.")
        units = units_of(plants[0], self.band_hz, WHO, alike=structure in (REPEATED, SYMMETRIC))
        rising_band(WHO, units.band_hz, plants[0].rate_hz)
        require_room(WHO, plants[0], self.washout_hz, units.band_hz[0])
        scaled = [units.scaled(each) for each in plants]
        demands, top = self._demands(scaled, units, structure)
        # S and T of a law K W on G are those of K on W G, and K W S is nowhere larger than K S: every bound holds
        heard = [heard_through(g, self.washout_hz) for g in scaled]
        near = partial(self._near, scaled, units) if self.draws else None
        campaign = SearchFromStarts(demands, heard, near, self.steps, top[0])
        law = campaign.best(self._begin(scaled[0], structure, self._laws(scaled, units, structure, heard)))
        if law is None:
            return refused(f"{WHO}: no start is stable with every plant; give another 'start', or less spread.")
        law = behind(law, self.washout_hz)
        reached = self._figures(law, scaled, campaign, units, structure, top)
        tones = {tone: min(f.tones_db[f"{tone:g}"] for f in reached.plants) for tone in self.tones_hz}
        details = {"figures": reached, "attenuation_db": reached.attenuation_db, "tones_db": tones}
        if self.band_hz is None:
            quieter = rms_reduction_db(plants[0], units.own(law), units.band_hz)
            details |= {"band_hz": units.band_hz, "attenuation_rms_db": quieter}
        level = 10 ** (-reached.attenuation_db / 20)
        result = judged(plants[0], units.own(law), self, level, level, {}, details)
        result = among(result, plants, reached, self.disk_margin, units.band_hz)
        return with_price(result, reached, self.gain_spread, self.mode_spread)

    def _near(self, plants: Sequence[StateSpace], units: SearchUnits, share: float) -> list[StateSpace]:
        """Return the plants drawn near those given, as they are heard: every share has the same draws."""
        rng = np.random.default_rng(self.seed)
        gain, mode = share * self.gain_spread, share * self.mode_spread
        drawn = [p for g in plants for p in perturbed(g, self.draws, gain, mode, rng, units.band_hz)]
        return [heard_through(g, self.washout_hz) for g in drawn]

    def _figures(
        self,
        law: StateSpace,
        plants: Sequence[StateSpace],
        campaign: SearchFromStarts,
        units: SearchUnits,
        structure: str,
        top: tuple[float, float],
    ) -> SearchFigures:
        control = units.control if units.common else 1.0
        over = campaign.excess_db
        each = tuple(figures(g, law, campaign.demands, control, db) for g, db in zip(plants, over, strict=True))
        return SearchFigures(
            attenuation_db=min(f.attenuation_db for f in each),
            peak_db=max(f.peak_db for f in each),
            plants=each,
            alone_db=campaign.alone_db,
            drawn=tuple((f.attenuation_db, f.peak_db) for f in campaign.drawn),
            roof_hz=top[0],
            roof_gain=top[1] * control,
            structure=structure,
            states=self.states,
            lines=campaign.lines,
            steps=campaign.taken,
        )

    def _begin(self, first: StateSpace, structure: str, laws: Sequence[StateSpace]) -> list[Start]:
        """Return structures of the law with the parameters of laws to begin with, in the units of the search."""
        scalar, n, plane = structure != FULL, first.D.shape[0], plane_of(first)
        places = None
        if structure == REPEATED:
            places = Places.of(np.eye(n), (0,) * n)
        elif structure == DECENTRALISED:
            places = Places.of(np.eye(n), tuple(range(n)))
        elif structure == SYMMETRIC:
            places = Places.of(*_coordinates(self.coordinates, self.blocks, n))
        tones = plane.of_hz(np.array(self.tones_hz, dtype=np.float64))
        out: list[Start] = []
        for law in laws:
            if law.D.shape != ((1, 1) if scalar else first.D.shape[::-1]):
                raise InputError(f"{WHO}: the law to begin with has shape {law.D.shape}, which does not fit.")
            one = begun(plane, law, places, self.states, tones, self.tone_zeta)
            out += [] if one is None else [one]
        if not out:
            raise InputError(f"{WHO}: the law to begin with has modes that cannot be told apart; give another 'start'.")
        return out

    def _laws(
        self, plants: Sequence[StateSpace], units: SearchUnits, structure: str, heard: Sequence[StateSpace]
    ) -> list[StateSpace]:
        """Return laws to begin with, in the units of the search: the caller's where there is one.

        Laws of their own for all channels begin with what a search finds for all alike as well: from poorer ones, what
        bounds one channel keeps all others where they are.
        """
        scalar = structure != FULL
        own = self.start is None
        laws = self._own_laws(plants, units, scalar) if own else [self._given_law(plants[0], units, scalar)]
        if structure != DECENTRALISED or plants[0].D.shape[0] == 1:
            return laws
        demands, top = self._demands(plants, units, REPEATED)
        search = SearchFromStarts(demands, heard, None, self.steps, top[0])
        alike = search.best(self._begin(plants[0], REPEATED, laws))
        return laws if alike is None else [of_one_channel(alike)[0], *laws]

    def _own_laws(self, plants: Sequence[StateSpace], units: SearchUnits, scalar: bool) -> list[StateSpace]:
        """Return laws of other designs to begin with, and one that hardly acts, in the units of the search."""
        first = plants[0]
        limit = _inverting(first, units.band_hz)
        # a law begun with one unit's model inverts modes that another may not have, and keeps them
        begin = partial(starts, band_hz=units.band_hz, limit=limit, scalar=scalar)
        if self.band_hz is None:
            begin = partial(unasked_starts, disk_margin=self.disk_margin, scalar=scalar)
        own = [law for g in plants[:BEGUN] for law in begin(g)]
        little = [hardly(first, units.band_hz, self.states, scalar)] if first.is_stable() else []
        return [*own, *little]

    def _given_law(self, first: StateSpace, units: SearchUnits, scalar: bool) -> StateSpace:
        """Return the law to begin with that a caller gives or names, in the units of the search."""
        start = self.start
        if not isinstance(start, StateSpace):
            if isinstance(start, Mapping):
                settings = {key: value for key, value in start.items() if key != "method"}
                start = lookup("design", str(start.get("method")))(**settings)
            # the design is made in the plant's own units
            plant = SearchUnits(1 / units.inputs, 1 / units.outputs, units.band_hz).scaled(first)
            name, start = type(start).__name__, start.design(common_mode(plant) if scalar else plant).controller
            if start is None:
                raise InputError(f"{WHO}: the design to begin with, {name}, gives no law.")
        if scalar:
            start, _ = of_one_channel(start)
        if scalar and start.D.shape == (1, 1):
            return StateSpace(start.A, start.B, start.C / units.control, start.D / units.control, start.rate_hz)
        return units.taken(start)

    def _demands(
        self, plants: Sequence[StateSpace], units: SearchUnits, structure: str
    ) -> tuple[Demands, tuple[float, float]]:
        """Return the demands in the units of the search, and the roof: where it begins, and its gain."""
        peak = over_frequency(WHO, "peak_db", self.peak_db, logarithmic=False)
        scale_db = 20 * np.log10(units.control) if units.common else 0.0
        if self.control_limit is None:
            limit = over_frequency(WHO, "control_limit", _inverting(plants[0], units.band_hz), logarithmic=True)
            scale_db = 0.0
        else:
            limit = over_frequency(WHO, "control_limit", self.control_limit, logarithmic=True)
        ends = np.geomspace(*units.band_hz, 9)
        room = 1 - 10 ** (-max(float(np.min(peak(ends))), 0.1) / 20)
        begins, gain = roof(plants, units.band_hz, self.mode_spread, self.gain_spread, room)
        roof_db = 20 * np.log10(gain)

        def control(f_hz: FloatArray) -> FloatArray:
            level = limit(f_hz) - scale_db
            return np.where(f_hz >= begins, np.minimum(level, roof_db), level)

        T = self.complementary_db
        shape = None if T is None else over_frequency(WHO, "complementary_db", T, logarithmic=False)
        demands = Demands(
            band_hz=units.band_hz,
            sensitivity_db=peak,
            control_db=control,
            complementary_db=shape,
            tones_hz=tuple(self.tones_hz),
            tone_db=self.tone_db,
            response_db=_largest_db(plants[0]) if self.band_hz is None else None,
            disk_margin=self.disk_margin,
            one_loop=structure == REPEATED,
        )
        return demands, (begins, gain)


def _checked(plant: Plants) -> list[StateSpace]:
    several = list(plant) if isinstance(plant, Sequence) and not isinstance(plant, str) else [plant]
    plants = [system(WHO, "plant", each) for each in several]
    if not plants:
        raise InputError(f"{WHO}: a plant or a sequence of plants is needed, got {plant!r}.")
    for k, other in enumerate(plants[1:], 2):
        same_rate(WHO, "plant 1", plants[0].rate_hz, f"plant {k}", other.rate_hz)
        if other.D.shape != plants[0].D.shape:
            raise InputError(f"{WHO}: plant {k} is {other.D.shape}, plant 1 {plants[0].D.shape}; all need one shape.")
    return plants


def _structure_for(plant: StateSpace, band_hz: tuple[float, float] | None) -> str:
    """Return `repeated` for a plant whose eigenvalues have about one phase over the band, else `full`."""
    if plant.D.shape[0] != plant.D.shape[1]:
        return FULL
    units = units_of(plant, band_hz, WHO, alike=True)
    G = np.moveaxis(response_at(plant)(np.geomspace(*units.band_hz, 60)), 2, 0)
    values = np.linalg.eigvals(G)
    turns = values / np.maximum(np.abs(values), 1e-300)
    mean = turns.mean(axis=1)
    mean = mean / np.maximum(np.abs(mean), 1e-300)
    alike = (turns * mean.conj()[:, None]).real.min(axis=1) >= ALIKE_COSINE
    return REPEATED if alike.mean() >= ALIKE_SHARE else FULL


def _inverting(plant: StateSpace, band_hz: tuple[float, float]) -> float:
    """Return the default limit of K S."""
    gains = principal_gains(response_at(plant)(np.geomspace(*band_hz, 60)))
    heard = gains[gains > HEARD * gains[0]]
    return INVERSIONS / float(heard.min()) if heard.size else 1.0


def _largest_db(plant: StateSpace) -> float:
    """Return the largest gain of a plant in its own band, in dB; 0 dB of one that does nothing."""
    largest = principal_gains(bounded_response(plant)(even_plant(plant).f_hz))[0].max()
    return 20 * float(np.log10(largest or 1.0))


def _coordinates(
    columns: tuple[tuple[float, ...], ...] | None, blocks: tuple[int, ...] | None, channels: int
) -> tuple[FloatArray, tuple[int, ...]]:
    T = real_array(WHO, "coordinates", np.asarray(columns), 2)
    numbers = tuple(blocks or ())
    if T.shape != (channels, channels) or np.abs(T.T @ T - np.eye(channels)).max() > 1e-6 or len(numbers) != channels:
        raise InputError(
            f"{WHO}: 'coordinates' must be {channels} orthonormal columns of {channels} entries and 'blocks' a number "
            f"for each, got {T.shape} and {len(numbers)}."
        )
    return T, numbers
