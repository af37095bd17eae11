"""Broadband attenuation: the sensitivity pressed down over a band, its peak held down elsewhere."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import positive, rising_band
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet._base.shown.line import rounded
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.loop_response import largest_in_band, loop_response
from ultraquiet.analyse.margins import even_inputs, peak_sensitivity
from ultraquiet.analyse.plant_scale import EvenPlant, below_nyquist, even_plant
from ultraquiet.design.gain_search import from_plant, without_weights
from ultraquiet.design.hinf.normalised import absolute_shape, band_shape, normalised_four_block, normalised_sketch
from ultraquiet.design.hinf.synthesis import synthesize_calm
from ultraquiet.design.hinf.usual_numbers import FLOOR, HEIGHT, UsualNumbers
from ultraquiet.design.mean_channel import designed_for, require_square
from ultraquiet.design.result import STABLE_WORDS, DesignResult
from ultraquiet.design.robust_stability import stands, tallest
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.structure_words import FULL, REPEATED, structure_word
from ultraquiet.design.verification import from_synthesis
from ultraquiet.design.weights.filters import high_pass, with_tones
from ultraquiet.design.weights.weight import Weight, weight
from ultraquiet.linalg import balance
from ultraquiet.values.door import takes_systems
from ultraquiet.values.generalised import output_shaping
from ultraquiet.values.interconnect import append, sensitivity
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

WHO = "BandAttenuation"
ORDER = 8  # of W1 in absolute weights
# Where one of these is given, the others are what is usual for the plant; with none, it is the measure.
NUMBERS = ("height", "floor", "control_limit", "control_hz", "roll_off_hz")
T_WEIGHT = 0.4  # |T| may reach gamma / 0.4 below the roll-off
RISE = 10.0  # the weights on KS and T grow by this factor, one decade in frequency
HEIGHTS = (2.0, 200.0)  # range of the search for the height that meets a peak
PEAK_OFF_DB = 0.1  # by which a peak may miss what was asked for
HEIGHT_STEPS = 8  # halvings of the logarithm of that range: 2 % in height
CALMER = (1.1, 1.2)
WHOLE = 1.1  # a Butterworth edge has lost half of the weight's height at its corner; a tenth inside it is whole
LOST_DB = 3.0  # of a scalar promise, beyond which the plant has not the one function that the law is for
NEGLIGIBLE = 1e-6  # Hankel values below this share of the largest leave the scalar function


@register("design", "band-attenuation")
@dataclass(frozen=True)
class BandAttenuation(StatedRobustness):
    """The controller that makes a band quiet in every direction, at a price in amplification outside.

    min || [W1 S; W2 K S; W3 T] || with W1 a steep band-pass over a floor, W2 and W3 rising at high frequency: W1's
    height asks for attenuation, its floor bounds the amplification elsewhere, W2 bounds |K S|, W3 ends the control.

    By default the plant is the measure: the four-block form with all weights one, on the plant in units of its own
    (`even_plant`), its loop shaped to be high over the band, its gain halved from 32 until it keeps `disk_margin` at
    both ends; any number of inputs and outputs. Who gives one of `height`, `floor`, `control_limit`, `control_hz`,
    `roll_off_hz`, `peak_db`, `uncertainty`, or asks for the structure `repeated`, gets exactly the weights above, in
    the plant's own units, for a square plant; the numbers left out are what is usual for it (`UsualNumbers`).

    Args:
        band_hz: corners of W1, Hz, a little outside the band to be quiet; the plant's own band when absent.
        height: gain of W1 in the band, 12 where only others are given. Doubling it buys about 4 dB and costs about 2 dB
            of peak.
        floor: gain of W1 outside, 0.6 where only others are given; the peak of S is near gamma / floor.
        order: states per channel of W1, 8 when absent, or of the default's shape, 2 when absent; even. Steep weights
            attenuate more at the same peak than high ones.
        control_limit: largest wanted gain of K S, input units per output unit; 500 times the inverse of the plant's
            typical gain over the band likewise.
        control_hz: from where on less is wanted, Hz; four times the band's end likewise, 0.4 of the rate at most, as
            the next.
        roll_off_hz: where the loop is to end, Hz; five times the band's end likewise.
        tones_hz: frequencies at which W1 has peaks besides, Hz: steady tones inside or outside the band.
        tone_height: extra gain of W1 at each tone; 40 dB of it cost about 0.5 dB of peak when they are narrow.
        tone_zeta: half the relative width of the peaks.
        peak_db: when given, `height` is chosen such that the peak of S is this, within a tenth of a decibel or so.
        uncertainty: a bound on the plant's relative error at its outputs, G_true = (I + E) G with ||E|| <= |W|: a
            system as `validate.from_covariance(...).weight(rate_hz).system` gives it, or numbers `(low, corner_hz,
            high)`. It joins W3 as a second weight on T; without a `peak_db` the height is lowered until the loop stands
            every such error.
        structure: `full` designs one controller for all channels; `repeated` one scalar controller, used on each of
            them, for what the channels share, the mean of the plant's eigenvalues (`mean_channel`).
            `alike` is an older word for `repeated`.
        margin: the controller is formed at margin times the smallest norm; where that controller is unstable by itself,
            which nobody wants to switch on, larger margins up to 1.2 are tried first.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = BandAttenuation(band_hz=(9.0, 108.0), height=5.0, order=4).design(plant)
    >>> s = abs(1 / (1 - plant.frequency_response([30.0]) * result.controller.frequency_response([30.0])))
    >>> bool(s[0, 0, 0] < 0.5), result.peak_sensitivity_db < 8
    (True, True)

    Skogestad and Postlethwaite 2005, section 2.8.3.
    """

    band_hz: tuple[float, float] | None = None
    height: float | None = None
    floor: float | None = None
    order: int | None = None
    control_limit: float | None = None
    control_hz: float | None = None
    roll_off_hz: float | None = None
    tones_hz: tuple[float, ...] = ()
    tone_height: float = 100.0
    tone_zeta: float = 0.002
    peak_db: float | None = None
    uncertainty: Weight | None = None
    structure: str = FULL
    margin: float = 1.05

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "structure", structure_word(WHO, self.structure, (FULL, REPEATED)))
        for name in ("tone_height", "tone_zeta", "margin"):
            positive(WHO, name, getattr(self, name))
        for name in (*NUMBERS, "peak_db"):
            if getattr(self, name) is not None:
                positive(WHO, name, getattr(self, name))

    @property
    def square_plants(self) -> bool:
        """Whether `design` takes square plants alone, as with numbers of one's own."""
        return not self._measured_by_the_plant()

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of a square plant; peak, margins and poles are those with the whole plant.

        `details` holds `attenuation_db` and `tones_db`, the worst direction over the band and at each tone on the
        design model, the `height` used and the `weights`; with an `uncertainty` also `robust_stability`, max ||W T||,
        and the status is `not robust` where that is not below one. A law that is `repeated` is compared with what it
        promises for the one function it was designed for, `promised_db`: where 3 dB of it are lost in the worst
        direction of the whole plant, the status is `short`. So it is where the least height peaks above `peak_db`.

        Raises:
            InputError: the plant is not square.
        """
        if not self.square_plants:
            return from_plant(plant, self, self._attempt, self.band_hz, sketch=self._sketch)
        require_square("BandAttenuation", plant)
        n = plant.D.shape[0]
        bound = None if self.uncertainty is None else weight(WHO, "uncertainty", self.uncertainty, n, plant.rate_hz)
        part = plant if self.structure == FULL else designed_for(plant)
        settled = self.settled(plant)  # for the whole plant, also where a part of it is designed for
        if self.peak_db is not None:
            height = _height_for_peak(settled, part, plant, self.peak_db)
            return _peaked(
                stands(plant, replace(settled, height=height)._designed(plant, part, self), bound), self.peak_db
            )
        if bound is None:
            return settled._designed(plant, part, self)

        def of(height: float) -> BandAttenuation:
            return replace(settled, height=height)

        return tallest(
            plant,
            bound,
            self.height or HEIGHT,
            lambda h: of(h)._law(plant, part),
            lambda h: of(h)._designed(plant, part, self),
        )

    def _measured_by_the_plant(self) -> bool:
        given = (self.peak_db, self.uncertainty, *(getattr(self, name) for name in NUMBERS))
        return self.structure == FULL and all(setting is None for setting in given)

    def _attempt(self, even: EvenPlant, g: float) -> DesignResult:
        found = normalised_four_block(even, g, self._shape(even), self.margin)
        if found.controller is None:
            return found
        tones = {f: worst_attenuation_db(even.plant, found.controller, (f, f)) for f in self.tones_hz}
        quiet = worst_attenuation_db(even.plant, found.controller, even.band_hz)
        return replace(found, details={**found.details, "tones_db": tones, "attenuation_db": quiet})

    def _sketch(self, even: EvenPlant, g: float) -> StateSpace | None:
        return normalised_sketch(even, g, self._shape(even), self.margin)

    def _shape(self, even: EvenPlant) -> StateSpace:
        rate = even.plant.rate_hz
        return band_shape(even.band_hz, self.tones_hz, self.tone_height, self.tone_zeta, rate, self.order)

    def settled(self, plant: StateSpace) -> "BandAttenuation":
        """Return the same with the numbers left out as they are usual for a plant, itself where that is the measure."""
        missing = {name for name in ("control_limit", "control_hz", "roll_off_hz") if getattr(self, name) is None}
        if not missing or self._measured_by_the_plant():
            return self
        usual = UsualNumbers.of(plant, self.band_hz)
        return replace(self, **{name: getattr(usual, name) for name in missing})

    def _law(self, plant: StateSpace, part: StateSpace) -> StateSpace | None:
        return _spread(self.synthesis(part).controller, plant, part)

    def _designed(self, plant: StateSpace, part: StateSpace, asked: "BandAttenuation") -> DesignResult:
        """Return the design at this height for the part, judged on the plant; `asked` are the caller's settings."""
        synthesised = self.synthesis(part)
        law = _spread(synthesised.controller, plant, part)
        weights = self.weights(plant)
        on_loop = {"S": weights["performance"], "KS": weights["control"], "T": weights["complementary"]}
        details: dict[str, Any] = {"height": self.height or HEIGHT, "weights": weights, "loop_weights": on_loop}
        if law is not None:
            details["tones_db"] = {f: worst_attenuation_db(plant, law, (f, f)) for f in self.tones_hz}
            details["attenuation_db"] = worst_attenuation_db(plant, law, self._quiet_band(plant))
        result = from_synthesis(plant, synthesised, asked, details, law)
        alone = synthesised.controller
        if law is None or alone is None or part is plant:
            return result
        return _compared(result, worst_attenuation_db(part, alone, self._quiet_band(plant)))

    def synthesis(self, plant: StateSpace) -> DesignResult:
        """Return the first stable controller over rising margins, or the first one when none is stable."""
        calmer = tuple(m for m in CALMER if m > self.margin)
        return synthesize_calm(self.generalised(plant), *plant.D.shape, margin=self.margin, calmer=calmer)

    def generalised(self, plant: StateSpace) -> StateSpace:
        """Return the generalised plant, inputs (w, u), outputs (W1 S w, W2 K S w, W3 T w, y)."""
        n = plant.D.shape[0]
        return output_shaping(
            plant, *(w if w.D.shape[1] == n else append(*[w] * n) for w in self.weights(plant).values())
        )

    def weights(self, plant: StateSpace) -> dict[str, StateSpace]:
        """Return the weights of one channel: `performance` W1, `control` W2, `complementary` W3.

        An uncertainty stands beside W3, one more output a channel; given in full size, it stays so.

        Raises:
            InputError: without an absolute number the plant is the measure, and a search weighs.
        """
        if self._measured_by_the_plant():
            raise without_weights("BandAttenuation")
        rate, settled = plant.rate_hz, self.settled(plant)
        limit, control_hz, roll_off_hz = settled.control_limit, settled.control_hz, settled.roll_off_hz
        assert limit is not None
        assert control_hz is not None
        assert roll_off_hz is not None
        performance = absolute_shape(
            plant, self.band_hz, self.height or HEIGHT, self.floor or FLOOR, self.order or ORDER
        )
        end = high_pass(below_nyquist(roll_off_hz, rate), T_WEIGHT, RISE * T_WEIGHT, 1, rate)
        return {
            "performance": with_tones(performance, self.tones_hz, self.tone_height, self.tone_zeta),
            "control": high_pass(below_nyquist(control_hz, rate), 1 / limit, RISE / limit, 1, rate),
            "complementary": end if self.uncertainty is None else _both(end, self._bound(plant)),
        }

    def _bound(self, plant: StateSpace) -> StateSpace:
        """Return the uncertainty's weight: of one channel where that is how it was given."""
        bound = self.uncertainty
        assert bound is not None
        full = isinstance(bound, StateSpace) and bound.D.shape != (1, 1)
        return weight(WHO, "uncertainty", bound, plant.D.shape[0] if full else 1, plant.rate_hz)

    def _band(self, plant: StateSpace) -> tuple[float, float]:
        return self.band_hz or even_plant(plant).band_hz

    def _quiet_band(self, plant: StateSpace) -> tuple[float, float]:
        low, high = self._band(plant)
        one, other = low * WHOLE, high / WHOLE
        return min(one, other), max(one, other)  # those of a narrow band pass each other


def _compared(result: DesignResult, promised: float) -> DesignResult:
    """Return a law repeated on every channel judged by its scalar promise: what is left of it on the whole plant."""
    left = float(result.details["attenuation_db"])
    details = {**result.details, "promised_db": promised}
    if result.status.word not in STABLE_WORDS or left >= promised - LOST_DB:
        return replace(result, details=details)
    sentence = (
        f"One scalar law for all channels promises {rounded(promised)} dB over the band on what the channels share; in "
        f"the worst direction of the whole plant {rounded(left)} dB are left of it, for its directions differ: take "
        f"the structure 'full'. {result.status.sentence}"
    )
    word = StatusWord.SHORT if result.status.ok else result.status.word
    return replace(result, status=Status(word, sentence), details=details)


def _peaked(result: DesignResult, peak_db: float) -> DesignResult:
    """Return a design judged by the peak asked for, which the least height may exceed already."""
    peak = result.peak_sensitivity_db
    if result.status.word not in STABLE_WORDS or not peak > peak_db + PEAK_OFF_DB:
        return result
    sentence = (
        f"A peak of {rounded(peak_db)} dB is out of reach: the least height tried, {HEIGHTS[0]:g}, has "
        f"{rounded(peak)} dB; allow a higher peak, or ask for a narrower band or less steep edges. "
        f"{result.status.sentence}"
    )
    word = StatusWord.SHORT if result.status.ok else result.status.word
    return replace(result, status=Status(word, sentence))


def common_mode(plant: StateSpace) -> StateSpace:
    """Return v' G v with v = (1, ..., 1) / sqrt(n), the scalar function of all channels moving together, reduced.

    Its unobservable half is removed by balanced truncation at Hankel values of no account; an unstable plant keeps all
    its states.

    Raises:
        InputError: the plant has not as many outputs as inputs.
    """
    if plant.D.shape[0] != plant.D.shape[1]:
        raise InputError(f"common_mode: a square plant is needed, got {plant.D.shape[0]} x {plant.D.shape[1]}.")
    v = np.ones((plant.D.shape[0], 1)) / np.sqrt(plant.D.shape[0])
    M = (plant.A, plant.B @ v, v.T @ plant.C, v.T @ plant.D @ v)
    if plant.is_stable():
        M = balance.without_faint(M, NEGLIGIBLE, discrete=plant.rate_hz is not None)
    return StateSpace(*M, rate_hz=plant.rate_hz)


def _spread(law: StateSpace | None, plant: StateSpace, part: StateSpace) -> StateSpace | None:
    """Return the law of a part as one for the plant: a copy for every channel where the part is what they share."""
    if law is None or part.D.shape == plant.D.shape:
        return law
    return append(*[law] * plant.D.shape[0])


def _both(end: StateSpace, bound: StateSpace) -> StateSpace:
    """Return [end; bound], the first copied for as many channels as the second has."""
    n = bound.D.shape[1]
    side = append(*[end] * n, bound)
    wires = np.vstack([np.eye(n), np.eye(n)])
    return StateSpace(side.A, side.B @ wires, side.C, side.D @ wires, side.rate_hz)


def worst_attenuation_db(plant: StateSpace, controller: StateSpace, band_hz: tuple[float, float]) -> float:
    """Return -20 log10 of the largest singular value of S = (I - G K)^-1 over a band or at a tone: its worst direction.

    A tone is a band of equal ends.
    """
    low, high = band_hz
    if low != high:
        rising_band("worst_attenuation_db", band_hz, plant.rate_hz)
    positive("worst_attenuation_db", "band_hz", low, "Hz")
    if low == high:
        size = float(np.linalg.norm(loop_response(plant, controller, np.array([low]))[0][0], 2))
    else:
        S = sensitivity(*even_inputs(plant, controller))
        size = largest_in_band(S, plant, (low, high), lambda S, _: S)[0]
    return -20 * float(np.log10(max(size, np.finfo(float).tiny)))


def _height_for_peak(settings: BandAttenuation, part: StateSpace, plant: StateSpace, peak_db: float) -> float:
    """Return the height at which the peak of the whole plant's S is `peak_db`, by bisection of its logarithm.

    Controllers are designed for `part`: the plant itself, or the function that its channels share. The least height is
    asked first: where its peak is higher, all others are designed in vain.
    """
    copies = plant.D.shape[0] // part.D.shape[0]

    def over(logarithm: float) -> bool:
        trial = replace(settings, height=float(np.exp(logarithm)), peak_db=None)
        law = trial.synthesis(part).controller
        return law is None or peak_sensitivity(plant, append(*[law] * copies))[0] > peak_db

    low, high = np.log(HEIGHTS)
    if over(low):
        return HEIGHTS[0]
    for _ in range(HEIGHT_STEPS):
        middle = (low + high) / 2
        low, high = (low, middle) if over(middle) else (middle, high)
    return float(np.exp(low))
