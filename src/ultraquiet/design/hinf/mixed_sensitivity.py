"""Mixed-sensitivity design: the paper's cost as printed, the general S/KS/T, and the four-block form."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import one_of, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.plant_scale import EvenPlant, below_nyquist
from ultraquiet.design.gain_search import from_plant, without_weights
from ultraquiet.design.hinf.normalised import absolute_shape, band_shape, normalised_four_block, normalised_sketch
from ultraquiet.design.hinf.synthesis import synthesize_hinf
from ultraquiet.design.hinf.usual_numbers import FLOOR, HEIGHT, UsualNumbers
from ultraquiet.design.result import DesignResult
from ultraquiet.design.robust_stability import stands, tallest
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.verification import from_synthesis
from ultraquiet.design.weights.filters import high_pass, rational, with_tones
from ultraquiet.design.weights.weight import Weight, weight
from ultraquiet.values.door import takes_systems
from ultraquiet.values.generalised import four_block, output_shaping
from ultraquiet.values.state_space import StateSpace

WHO = "MixedSensitivity"
FORMS = ("four-block", "skst", "sks", "paper")
# Eqs. (16) and (17): W1 = 1e-4 (s + 10) / ((s + 1) (s + 100)), W2 = 1e-5.
PAPER_W1 = (1e-4, (-10.0,), (-1.0, -100.0))
PAPER_W2 = 1e-5
ORDER = 8  # of W1 in absolute weights
ENDS = 4000.0  # what the four-block weight on u rises by: up there control is next to none
# Where one of these is given, or a weight, the others are what is usual for the plant; with none, it is the measure.
NUMBERS = ("height", "floor", "control_limit", "roll_off_hz", "disturbance", "noise")


@register("design", "mixed-sensitivity")
@dataclass(frozen=True)
class MixedSensitivity(StatedRobustness):
    """The controller that minimises the H-infinity norm of weighted closed-loop functions.

    four-block: min || [W1; W2 K] (I - G K)^-1 [G Vd, Vn] ||, disturbance at the plant's input and at the sensors.
    skst: min || [W1 S; W2 K S; W3 T] ||, eq. (15) with a weight on T.
    sks: min || [W1 S; W2 K S] ||.
    paper: min || [W2 K S; T; W1 S] ||, eqs. (15)-(17) as printed.

    A weight is a `StateSpace`, `(1, 1)` or in full size, at the plant's rate; or a gain; or `(low, corner_hz, high)`
    with an order behind if it is not one: a gain that leaves `low` for `high` from the corner on.

    By default the four-block form with all weights one, on the plant in units of its own (`even_plant`), its gain
    halved from 32 until the loop keeps `disk_margin` at both ends; with a `band_hz` or `tones_hz` the loop is shaped to
    be high there. Who asks for another form, or gives a weight, a height, a floor, a limit, `disturbance` or `noise`,
    gets exactly that, in the plant's own units; the others are what is usual for this plant (`UsualNumbers`).

    Args:
        form: `four-block`, `skst`, `sks` or `paper`. S/KS/T inverts lightly damped modes of the plant, which leaves
            them ringing under disturbances at its input; the four-block form damps them.
        performance: W1 on every output; absent, a band-pass from the numbers below.
        control: W2 on every input; absent, a gain that rises at high frequency.
        complementary: W3 on every output, for `skst`; absent, likewise.
        uncertainty: a bound on the plant's relative error at its outputs, G_true = (I + E) G with ||E|| <= |W| at each
            frequency, as `validate.from_covariance(...).weight(rate_hz).system` gives it. It is W3 in `skst`. Where W1
            comes from numbers, its height is lowered until the loop stands every such error, ||W T|| < 1.
        band_hz: corners of the band to be quiet, Hz; the plant's own band where W1 needs one and none is given.
        height: gain of W1 in the band, 12 where only others are given.
        floor: gain of W1 outside it, 0.6 likewise.
        order: states per channel of W1, 8 when absent, or of the default's shape, 2 when absent; even.
        tones_hz: frequencies at which W1 has peaks besides, Hz, also a W1 that is given.
        tone_height: extra gain of W1 at each tone.
        tone_zeta: half the relative width of the peaks.
        control_limit: allowed gain from sensor to actuator at low frequency, in their units, 500 times the inverse of
            the plant's typical gain over the band where only others are given; W2 is its inverse there and rises.
        roll_off_hz: where control is to end, Hz, five times the band's end likewise (`skst`; the four-block weight
            rises from 0.28 times that end with two slopes).
        disturbance: Vd at every input, in its unit; likewise, the plant makes a tenth of the noise of it. The more, the
            more W2 also weights T at the plant's input.
        noise: Vn, disturbance and noise at every sensor, output units; 1 where neither is given.
        margin: the controller is formed at margin times the smallest norm.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = MixedSensitivity(form="paper").design(plant)
    >>> result.achieved < 1.1e-5  # as printed, the optimum is to do nothing
    True
    >>> robust = MixedSensitivity("skst", band_hz=(9.0, 108.0), uncertainty=(0.2, 300.0, 5.0)).design(plant)
    >>> robust.details["robust_stability"] < 1
    True

    Skogestad and Postlethwaite 2005, sections 7.5 and 9.3; the paper, eqs. (15)-(17).
    """

    form: str = "four-block"
    performance: Weight | None = None
    control: Weight | None = None
    complementary: Weight | None = None
    uncertainty: Weight | None = None
    band_hz: tuple[float, float] | None = None
    height: float | None = None
    floor: float | None = None
    order: int | None = None
    tones_hz: tuple[float, ...] = ()
    tone_height: float = 100.0
    tone_zeta: float = 0.002
    control_limit: float | None = None
    roll_off_hz: float | None = None
    disturbance: float | None = None
    noise: float | None = None
    margin: float = 1.05

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of(WHO, "form", self.form, FORMS)
        for name in ("tone_height", "tone_zeta", "margin"):
            positive(WHO, name, getattr(self, name))
        for name in NUMBERS:
            if getattr(self, name) is not None:
                positive(WHO, name, getattr(self, name))
        if self.uncertainty is not None and self.form == "skst" and self.complementary is not None:
            raise InputError(f"{WHO}: give 'uncertainty' or 'complementary', both are the weight on T.")

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of a plant, continuous or discrete.

        `gamma` and `achieved` are the norm of the weighted loop; `details["weights"]` are the weights used,
        `details["loop_weights"]` those that stand on S, T and KS, with what the form multiplies them by, and
        `details["norm_without_control"]` is the norm that K = 0 gives, to be compared with. With an `uncertainty`,
        `details["robust_stability"]` is max ||W T||, below one where the loop stands it, and `details["height"]` the
        height that was left; a loop that does not stand it has the status `not robust`.
        """
        if self._measured_by_the_plant():
            return from_plant(plant, self, self._attempt, self.band_hz, sketch=self._sketch)
        bound = self._bound(plant)
        if bound is None or self.performance is not None or self.form == "paper":
            return stands(plant, self._designed(plant), bound)

        def of(height: float) -> MixedSensitivity:
            return replace(self, height=height)

        height = self.height or HEIGHT
        return tallest(plant, bound, height, lambda h: of(h)._law(plant), lambda h: of(h)._designed(plant))

    def _measured_by_the_plant(self) -> bool:
        given = (self.performance, self.control, self.complementary, self.uncertainty)
        numbers = (getattr(self, name) for name in NUMBERS)
        return self.form == FORMS[0] and all(setting is None for setting in (*given, *numbers))

    def _attempt(self, even: EvenPlant, g: float) -> DesignResult:
        return normalised_four_block(even, g, self._shape(even), self.margin)

    def _sketch(self, even: EvenPlant, g: float) -> StateSpace | None:
        return normalised_sketch(even, g, self._shape(even), self.margin)

    def _shape(self, even: EvenPlant) -> StateSpace:
        rate = even.plant.rate_hz
        return band_shape(self.band_hz, self.tones_hz, self.tone_height, self.tone_zeta, rate, self.order)

    def weights(self, plant: StateSpace) -> dict[str, StateSpace]:
        """Return the weights `performance`, `control` and `complementary` in full size, at the plant's rate.

        Raises:
            InputError: without an absolute number the plant is the measure, and a search weighs.
        """
        if self._measured_by_the_plant():
            raise without_weights(WHO)
        ny, nu = plant.D.shape
        settled = self.settled(plant)
        settings: Mapping[str, tuple[Weight, int]] = {
            "performance": (self._performance(plant), ny),
            "control": (settled._control(plant), nu),
            "complementary": (settled._complementary(plant), ny),
        }
        weights = {k: weight(WHO, k, w, n, plant.rate_hz) for k, (w, n) in settings.items()}
        weights["performance"] = with_tones(weights["performance"], self.tones_hz, self.tone_height, self.tone_zeta)
        return weights

    def generalised(self, plant: StateSpace, weights: dict[str, StateSpace]) -> StateSpace:
        """Return the generalised plant of the form, its inputs (w, u) and outputs (z, y)."""
        ny, nu = plant.D.shape
        if self.form == "four-block":
            settled = self.settled(plant)
            assert settled.disturbance is not None
            assert settled.noise is not None
            outside = {"disturbance": settled.disturbance * np.eye(nu), "noise": settled.noise * np.eye(ny)}
            return four_block(plant, weights["performance"], weights["control"], **outside)
        on_t = None if self.form == "sks" else weights["complementary"]
        return output_shaping(plant, weights["performance"], weights["control"], on_t)

    def _law(self, plant: StateSpace) -> StateSpace | None:
        ny, nu = plant.D.shape
        return synthesize_hinf(self.generalised(plant, self.weights(plant)), ny, nu, margin=self.margin).controller

    def _designed(self, plant: StateSpace) -> DesignResult:
        weights = self.weights(plant)
        P = self.generalised(plant, weights)
        ny, nu = plant.D.shape
        synthesised = synthesize_hinf(P, ny, nu, margin=self.margin)
        idle = StateSpace(P.A, P.B[:, :-nu], P.C[:-ny], P.D[:-ny, :-nu], P.rate_hz)
        details: dict[str, Any] = {"weights": weights, "norm_without_control": hinf_norm(idle)[0]}
        details["loop_weights"] = self._on_loop(plant, weights)
        if self.performance is None and self.form != "paper":
            details["height"] = self.height or HEIGHT
        return from_synthesis(plant, synthesised, self, details)

    def _on_loop(self, plant: StateSpace, weights: Mapping[str, StateSpace]) -> dict[str, StateSpace]:
        """Return what the form puts on S, T and KS; of the four blocks those from noise, [W1; W2 K] S Vn."""
        noise = (self.settled(plant).noise if self.form == "four-block" else None) or 1.0
        on_loop = {"S": noise * weights["performance"], "KS": noise * weights["control"]}
        return on_loop | ({"T": weights["complementary"]} if self.form in ("skst", "paper") else {})

    def _bound(self, plant: StateSpace) -> StateSpace | None:
        if self.uncertainty is None:
            return None
        return weight(WHO, "uncertainty", self.uncertainty, plant.D.shape[0], plant.rate_hz)

    def _performance(self, plant: StateSpace) -> Weight:
        if self.performance is not None:
            return self.performance
        if self.form == "paper":
            return rational(*PAPER_W1, plant.rate_hz, 1)
        height, floor = self.height or HEIGHT, self.floor or FLOOR
        return absolute_shape(plant, self.band_hz, height, floor, self.order or ORDER)

    def _control(self, plant: StateSpace) -> Weight:
        if self.control is not None or self.form == "paper":
            return PAPER_W2 if self.control is None else self.control
        rate, limit, corner = plant.rate_hz, self.control_limit, self.roll_off_hz
        assert limit is not None
        assert corner is not None
        if self.form in ("skst", "sks"):
            return high_pass(below_nyquist(corner, rate), 1 / limit, 10 / limit, 1, rate)
        # without a block for T, the weight on u rises early and far enough to end the loop as well
        rises = UsualNumbers.of(plant, self.band_hz).rise_hz
        return high_pass(below_nyquist(rises, rate), 1 / limit, ENDS / limit, 2, rate)

    def _complementary(self, plant: StateSpace) -> Weight:
        if self.form == "paper":
            return 1.0
        setting = self.uncertainty if self.complementary is None else self.complementary
        assert self.roll_off_hz is not None
        corner = below_nyquist(self.roll_off_hz, plant.rate_hz)
        return high_pass(corner, 0.4, 4.0, 1, plant.rate_hz) if setting is None else setting

    def settled(self, plant: StateSpace) -> "MixedSensitivity":
        """Return the same with what is left out as it is usual for a plant, itself where that has nothing to say."""
        numbers = (self.control_limit, self.roll_off_hz, self.disturbance, self.noise)
        if self.form == "paper" or self._measured_by_the_plant() or all(number is not None for number in numbers):
            return self
        usual = UsualNumbers.of(plant, self.band_hz)
        noise = self.noise or usual.noise(self.disturbance)
        return replace(
            self,
            control_limit=self.control_limit or usual.control_limit,
            roll_off_hz=self.roll_off_hz or usual.roll_off_hz,
            disturbance=self.disturbance or usual.disturbance(noise),
            noise=noise,
        )
