"""Mixed-sensitivity design: the paper's cost as printed, the general S/KS/T, and the four-block form."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import one_of, positive
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.design._abstract import DesignResult
from ultraquiet.design._verify import from_synthesis
from ultraquiet.design.hinf import synthesize_hinf
from ultraquiet.design.weights import band_pass, below_nyquist, high_pass, rational
from ultraquiet.values.generalised import four_block, full, output_shaping
from ultraquiet.values.interconnect import gain
from ultraquiet.values.state_space import StateSpace

FORMS = ("four-block", "skst", "paper")
# Eqs. (16) and (17): W1 = 1e-4 (s + 10) / ((s + 1) (s + 100)), W2 = 1e-5.
PAPER_W1 = (1e-4, (-10.0,), (-1.0, -100.0))
PAPER_W2 = 1e-5
RISE_HZ = 30.0
ROLL_OFF = 4.0  # weight on u at high frequency, V/V


@register("design", "mixed-sensitivity")
@dataclass(frozen=True)
class MixedSensitivity:
    """The controller that minimises the H-infinity norm of weighted closed-loop functions.

    four-block: min || [W1; W2 K] (I - G K)^-1 [G Vd, Vn] ||, disturbance at the plant's input and at the sensors.
    skst: min || [W1 S; W2 K S; W3 T] ||, eq. (15) with a weight on T.
    paper: min || [W2 K S; T; W1 S] ||, eqs. (15)-(17) as printed.

    Args:
        form: `four-block`, `skst` or `paper`. S/KS/T inverts lightly damped modes of the plant, which leaves them
            ringing under disturbances at its input; the four-block form damps them.
        performance: W1 on every output, `(1, 1)` or `(ny, ny)`; absent, a band-pass from the numbers below.
        control: W2 on every input; absent, a gain that rises at high frequency.
        complementary: W3 on every output, for `skst`; absent, likewise.
        band_hz: corners of the band to be quiet, Hz.
        height: gain of W1 in the band.
        floor: gain of W1 outside it.
        order: states of W1 per channel, even.
        control_limit: allowed gain from sensor to actuator at low frequency, V/V; W2 is its inverse there and rises.
        roll_off_hz: where control is to end, Hz (`skst`; the four-block weight rises from 30 Hz with two slopes).
        disturbance: Vd, volts at every input. At a third of a volt and above, W2 also weights T at the plant's input.
        noise: Vn, disturbance and noise at every sensor, output units.
        margin: the controller is formed at margin times the smallest norm.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = MixedSensitivity(form="paper").design(plant)
    >>> result.achieved < 1.1e-5  # as printed, the optimum is to do nothing
    True

    Skogestad and Postlethwaite 2005, section 9.3; the paper, eqs. (15)-(17).
    """

    form: str = "four-block"
    performance: StateSpace | None = None
    control: StateSpace | None = None
    complementary: StateSpace | None = None
    band_hz: tuple[float, float] = (9.0, 108.0)
    height: float = 12.0
    floor: float = 0.6
    order: int = 8
    control_limit: float = 1000.0
    roll_off_hz: float = 500.0
    disturbance: float = 0.3
    noise: float = 1.0
    margin: float = 1.05

    def __post_init__(self) -> None:
        one_of("MixedSensitivity", "form", self.form, FORMS)
        for name in ("height", "floor", "control_limit", "roll_off_hz", "disturbance", "noise", "margin"):
            positive("MixedSensitivity", name, getattr(self, name))

    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of a plant, continuous or discrete.

        `gamma` and `achieved` are the norm of the weighted loop; `details["weights"]` are the weights used and
        `details["norm_without_control"]` is the norm that K = 0 gives, to be compared with.
        """
        weights = self.weights(plant)
        P = self.generalised(plant, weights)
        ny, nu = plant.D.shape
        found = synthesize_hinf(P, ny, nu, margin=self.margin)
        idle = StateSpace(P.A, P.B[:, :-nu], P.C[:-ny], P.D[:-ny, :-nu], P.rate_hz)
        details = {"weights": weights, "norm_without_control": hinf_norm(idle)[0]}
        return from_synthesis(plant, found, self, details)

    def weights(self, plant: StateSpace) -> dict[str, StateSpace]:
        """Return the weights `performance`, `control` and `complementary` in full size, at the plant's rate."""
        ny, nu = plant.D.shape
        rate = plant.rate_hz
        if self.form == "paper":
            return {
                "performance": self.performance or rational(*PAPER_W1, rate, ny),
                "control": self.control or gain(PAPER_W2 * np.eye(nu), rate),
                "complementary": gain(np.eye(ny), rate),
            }
        w1 = self.performance or band_pass(self.band_hz, self.height, self.floor, self.order, rate)
        w2 = self.control or self._control(rate)
        w3 = self.complementary or high_pass(below_nyquist(self.roll_off_hz, rate), 0.4, 4.0, 1, rate)
        return {
            "performance": full(w1, ny, "performance"),
            "control": full(w2, nu, "control"),
            "complementary": full(w3, ny, "complementary"),
        }

    def generalised(self, plant: StateSpace, weights: dict[str, StateSpace]) -> StateSpace:
        """Return the generalised plant of the form, its inputs (w, u) and outputs (z, y)."""
        ny, nu = plant.D.shape
        if self.form == "four-block":
            return four_block(
                plant,
                weights["performance"],
                weights["control"],
                disturbance=self.disturbance * np.eye(nu),
                noise=self.noise * np.eye(ny),
            )
        return output_shaping(plant, weights["performance"], weights["control"], weights["complementary"])

    def _control(self, rate_hz: float | None) -> StateSpace:
        if self.form == "skst":
            corner = below_nyquist(self.roll_off_hz, rate_hz)
            return high_pass(corner, 1 / self.control_limit, 10 / self.control_limit, 1, rate_hz)
        # without a block for T, the weight on u rises early and far enough to end the loop as well
        return high_pass(RISE_HZ, 1 / self.control_limit, ROLL_OFF, 2, rate_hz)
