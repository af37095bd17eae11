"""Resonator banks: steady tones cancelled by the plant's own inverse at each of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, positive
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.margins import peak_sensitivity
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.tones.inner_loop import Around, Inner, Inverse, checked_tones, inner_loop, inverse
from ultraquiet.design.verification import judged
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import feedback, gain, parallel, sensitivity
from ultraquiet.values.state_space import StateSpace

SETTLED = 4.0  # time constants until an exponential is within two per cent
SLOWER = 2**0.5  # steps in which a tone's resonator is made slower
SLOWINGS = 20  # such steps per tone, a factor of a thousand, before a design is given up


@register("design", "resonators")
@dataclass(frozen=True)
class Resonators(StatedRobustness):
    """A bank of resonators that cancels steady tones in every direction of a plant, round another law or alone.

    u = K0 y + sum over tones of Re(zeta), zeta+ = e^jw (rho zeta - 2 a G(e^jw)^-1 y): each direction of each tone
    closes its own integrator in the tone's rotating frame, with a pole at e^jw (1 - a), a = 4 / (settling_s rate).
    G is the plant that the bank meets: (I - G K0)^-1 G round a controller.

    Args:
        tones_hz: the tones, Hz; a law against tones must be told at least one.
        settling_s: time to within two per cent, per tone.
        depth_db: how deep the notch in S is, which keeps the resonators stable by themselves: rho = 1 - a / depth.
        peak_db: how far the bank may amplify elsewhere, dB; it is made slower until it does not.
        weakest: directions of G at a tone weaker than this share of the strongest are left alone.
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
    settling_s: float = 0.5
    depth_db: float = 60.0
    peak_db: float = 3.0
    weakest: float = 0.01
    around: Around = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("settling_s", "depth_db", "peak_db"):
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
        bank, slowed = quiet_bank(inner, tones, inverses, self.settling_s, self.depth_db, self.peak_db)
        if bank is None:
            return refused(
                f"Resonators: no bank for {_listed(tones)} Hz keeps below {self.peak_db:g} dB of amplification, when "
                f"it is {slowed.max():.0f} times slower than {self.settling_s:g} s; tones lie too near to each other."
            )
        details = {
            **facts(inner, bank, tones, inverses),
            "slowed": dict(zip(tones.tolist(), slowed.tolist(), strict=True)),
            "least_real": least,
        }
        return judged(plant, inner.joined(bank), self, float("nan"), float("nan"), {}, details)


def quiet_bank(
    inner: Inner,
    tones_hz: FloatArray,
    inverses: list[Inverse],
    settling_s: float,
    depth_db: float,
    peak_db: float,
    slowed: FloatArray | None = None,
) -> tuple[StateSpace | None, FloatArray]:
    """Return a bank that is stable and amplifies by `peak_db` at most, and how much slower than asked each tone is.

    Where a bank amplifies too much, the tone whose resonator is the loudest there is slowed, and so on: a tone where
    the plant is weak has a strong inverse, and pays alone for it.
    """
    rate = inner.seen.rate_hz
    assert rate is not None
    slowed = np.ones(tones_hz.size) if slowed is None else slowed.copy()
    for _ in range(SLOWINGS * tones_hz.size):
        bank = resonators(tones_hz, inverses, rate, SETTLED / (settling_s * slowed * rate), depth_db)
        peak, at_hz = _worst_spot(inner.seen, bank)
        if peak <= peak_db:
            return bank, slowed
        G = inner.seen.frequency_response([at_hz])[:, :, 0]
        parts = [_only(bank, np.arange(bank.states)[own]) for own in _owned(inverses)]
        loud = [float(np.linalg.norm(G @ K.frequency_response([at_hz])[:, :, 0], 2)) for K in parts]
        slowed[int(np.argmax(loud))] *= SLOWER
    return None, slowed


def _worst_spot(plant: StateSpace, bank: StateSpace) -> tuple[float, float]:
    """Return the peak of S in dB and where it is, Hz; for an unstable loop infinity and its most unstable pole's."""
    poles = feedback(plant, bank).poles()
    worst = poles[np.argmax(np.abs(poles))]
    assert plant.rate_hz is not None
    if np.abs(worst) >= 1:
        return np.inf, float(np.abs(np.angle(worst))) * plant.rate_hz / (2 * np.pi)
    return peak_sensitivity(plant, bank)


def resonators(
    tones_hz: FloatArray, inverses: list[Inverse], rate_hz: float, speed: FloatArray, depth_db: float
) -> StateSpace:
    """Return the bank: two states for each direction of each tone, poles at rho e^jw.

    Args:
        tones_hz: tones, `(nt,)`.
        inverses: of G at each.
        rate_hz: sampling rate.
        speed: a, the share of each tone that goes in each sample, `(nt,)`.
        depth_db: depth of the notch, a / (1 - rho).
    """
    rho = 1.0 - speed / 10 ** (depth_db / 20)
    w = 2 * np.pi * tones_hz / rate_hz
    return stacked([_resonator(w[i], g, rate_hz, speed[i], rho[i]) for i, g in enumerate(inverses)])


def stacked(parts: list[StateSpace]) -> StateSpace:
    """Return the sum of systems, their states one after the other."""
    total = parts[0]
    for part in parts[1:]:
        total = parallel(total, part)
    return total


def _resonator(w: float, g: Inverse, rate_hz: float, speed: float, rho: float) -> StateSpace:
    one = np.eye(g.S.size)
    turn: ComplexArray = np.exp(1j * w) * one
    drive = -2 * speed * np.exp(1j * w) * (g.U / g.S).conj().T
    A = rho * np.block([[turn.real, -turn.imag], [turn.imag, turn.real]])
    B, C = np.vstack([drive.real, drive.imag]), np.hstack([g.V.real, -g.V.imag])
    return StateSpace(A, B, C, np.zeros((C.shape[0], B.shape[1])), rate_hz)


def facts(inner: Inner, bank: StateSpace, tones_hz: FloatArray, inverses: list[Inverse]) -> dict[str, Any]:
    """Return what the bank does at each tone: depth, settling, margin of phase, directions."""
    poles = feedback(inner.seen, bank).poles()
    S = sensitivity(inner.seen, bank).frequency_response(tones_hz)
    rows: dict[str, dict[float, Any]] = {"depth_db": {}, "settling_s": {}, "phase_margin_deg": {}, "directions": {}}
    rate = bank.rate_hz
    assert rate is not None
    for i, (tone, g, mine) in enumerate(zip(tones_hz.tolist(), inverses, _owned(inverses), strict=True)):
        rows["depth_db"][tone] = -20 * float(np.log10(np.linalg.norm(g.U.conj().T @ S[:, :, i] @ g.U, 2)))
        # the poles that this tone's directions own: those nearest to where a slow loop would have them
        place = np.linalg.eigvals(bank.A[mine, mine])[0]
        place = place.real + 1j * abs(place.imag)
        nearest = poles[np.argsort(np.abs(poles - place))[: g.S.size]]
        rows["settling_s"][tone] = -SETTLED / (rate * float(np.log(np.abs(nearest).max())))
        G = feedback(inner.seen, _without(bank, mine)).frequency_response([tone])[:, :, 0]
        turned = np.angle(np.linalg.eigvals(g.U.conj().T @ G @ (g.V / g.S)))
        rows["phase_margin_deg"][tone] = 90.0 - float(np.degrees(np.abs(turned).max()))
        rows["directions"][tone] = g.S.size
    return rows


def _owned(inverses: list[Inverse]) -> list[slice]:
    """Return which of a bank's states belong to each tone."""
    ends = np.cumsum([0] + [2 * g.S.size for g in inverses]).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


def _without(bank: StateSpace, mine: slice) -> StateSpace:
    return _only(bank, np.delete(np.arange(bank.states), mine))


def _only(bank: StateSpace, kept: NDArray[np.intp]) -> StateSpace:
    if not kept.size:
        return gain(np.zeros(bank.D.shape), bank.rate_hz)
    return StateSpace(bank.A[np.ix_(kept, kept)], bank.B[kept], bank.C[:, kept], bank.D, bank.rate_hz)


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


def _listed(tones_hz: FloatArray) -> str:
    return ", ".join(f"{f:g}" for f in tones_hz)
