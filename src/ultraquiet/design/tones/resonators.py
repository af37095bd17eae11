"""Resonator banks: steady tones cancelled by the plant's own inverse at each of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.tones.bank import Amplification, BankShape, facts, quiet_bank, still_loud, timed, too_loud
from ultraquiet.design.tones.inner_loop import Around, Inverse, checked_tones, inner_loop, inverse, settlings
from ultraquiet.design.verification import judged
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

USUAL_S = 0.5  # of a tone, to settle


@register("design", "resonators")
@dataclass(frozen=True)
class Resonators(StatedRobustness):
    """A bank of resonators that cancels steady tones in every direction of a plant, round another law or alone.

    u = K0 y + sum over tones of Re(zeta), zeta+ = e^jw (rho zeta - 2 a G(e^jw)^-1 y): each direction of each tone
    closes its own integrator in the tone's rotating frame, with a pole at e^jw (1 - a), a = 4 / (settling_s rate).
    G is the plant that the bank meets: (I - G K0)^-1 G round a controller.

    Args:
        tones_hz: the tones, Hz; a law against tones must be told at least one.
        settling_s: time to within two per cent, one number or one a tone; a law that is slower is `short`. When absent
            half a second is tried, and what came of it is said.
        depth_db: how deep the notch in S is, which keeps the resonators stable by themselves: rho = 1 - a / depth.
        peak_db: how far the bank may amplify elsewhere what the loop without it leaves, dB; it is made slower until it
            does not.
        loop_peak_db: how far the whole loop may amplify, K0 included, dB; kept in the same way, nothing when absent.
        weakest: directions of G at a tone weaker than this share of the strongest are left alone.
        roll_off: corner of a first-order low-pass F before each tone's resonator, in multiples of its tone; none when
            absent. G F takes the place of G, and where the plant answers a low tone faintly and others loudly the bank
            disturbs these less: far above the tone it falls with the square of frequency.
        around: K0: a `StateSpace`, or the name of a design method, used with its own settings.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=1000.0)
    >>> result = Resonators(tones_hz=(30.0,), settling_s=0.5).design(plant)
    >>> s = abs(1 / (1 - plant.frequency_response([30.0]) * result.controller.frequency_response([30.0])))
    >>> bool(s[0, 0, 0] < 2e-3), result.controller.states
    (True, 2)

    Adaptive cancellation at a known frequency is this linear law: Bodson, Sacks and Khosla 1994,
    doi:10.1109/9.317127. The condition of small gain: Davison 1976, doi:10.1109/TAC.1976.1101137.
    """

    tones_hz: tuple[float, ...] = ()
    settling_s: float | tuple[float, ...] | None = None
    depth_db: float = 60.0
    peak_db: float = 3.0
    weakest: float = 0.01
    around: Around = None
    loop_peak_db: float | None = None
    roll_off: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        settlings("Resonators", self.settling_s, USUAL_S, len(np.atleast_1d(self.tones_hz)))
        for name in ("depth_db", "peak_db"):
            positive("Resonators", name, getattr(self, name))
        for name in ("loop_peak_db", "roll_off"):
            if getattr(self, name) is not None:
                positive("Resonators", name, getattr(self, name))
        between("Resonators", "weakest", self.weakest, 0.0, 1.0)

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace, drawn: Sequence[StateSpace] = ()) -> DesignResult:
        """Return the linear law of a discrete plant.

        Args:
            plant: G, any number of inputs and outputs.
            drawn: further plants that the truth may be, drawn from an identified covariance for instance.

        `details`, one entry a tone: `depth_db`, the reduction in the worst direction that G has there, `settling_s`
        from the closed loop's poles, `phase_margin_deg`, by how much G may turn at the tone, `directions` used;
        `slowed`, how many times slower than asked, for `peak_db`'s sake; and with `drawn` the `least_real`
        eigenvalue of G Ghat^-1, which must be above zero for a slow bank to be stable.

        Raises:
            InputError: no tone, one outside (0, rate / 2) or at which the plant has no gain, an unstable plant, a
                controller that does not fit.
        """
        inner = inner_loop("Resonators", plant, self.around)
        rate = inner.seen.rate_hz
        assert rate is not None
        tones = checked_tones("Resonators", self.tones_hz, rate)
        inverses = [inverse("Resonators", inner.seen, f, self.weakest) for f in tones]
        least = _least_real(drawn, inner.first, tones, inverses)
        if drawn and min(least.values()) <= 0:
            tone = min(least, key=lambda f: least[f])
            return refused(
                f"Resonators: at {tone:g} Hz an eigenvalue of G Ghat^-1 has the real part {least[tone]:.2g} for one of "
                f"the {len(drawn)} plants drawn; no bank is stable there: identify better at this tone.",
                least_real=least,
            )
        most = Amplification(self.peak_db, self.loop_peak_db)
        refusal = too_loud("Resonators", inner, most)
        if refusal:
            return refused(refusal)
        times = settlings("Resonators", self.settling_s, USUAL_S, tones.size)
        shape = BankShape(self.depth_db, self.roll_off)
        bank, slowed, at_hz = quiet_bank(inner, tones, inverses, times, shape, most)
        if bank is None:
            return refused(still_loud("Resonators", inner, tones, slowed * times, most, at_hz))
        details = {
            **facts(inner, bank, tones, inverses, shape),
            "slowed": dict(zip(tones.tolist(), slowed.tolist(), strict=True)),
            "least_real": least,
        }
        result = judged(plant, inner.joined(bank), self, float("nan"), float("nan"), {}, details)
        return timed(result, times, self.settling_s is not None, most)


def _least_real(
    drawn: Sequence[StateSpace], first: StateSpace, tones_hz: FloatArray, inverses: list[Inverse]
) -> dict[float, float]:
    """Return the smallest real part of an eigenvalue of G Ghat^-1 over the plants drawn, per tone."""
    least = {float(f): np.inf for f in tones_hz}
    for plant in drawn:
        seen = inner_loop("Resonators", plant, first if np.any(first.D) or first.states else None).seen
        G = seen.frequency_response(tones_hz)
        for i, (f, g) in enumerate(zip(least, inverses, strict=True)):
            values = np.linalg.eigvals(g.U.conj().T @ G[:, :, i] @ (g.V / g.S))
            least[f] = min(least[f], float(values.real.min()))
    return least if drawn else {}
