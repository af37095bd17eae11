"""A bank of resonators: how it is built, how slow it must be to stay quiet, and what it does at each tone."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.shown.line import counted
from ultraquiet.analyse.margins import peak_sensitivity
from ultraquiet.design.result import STABLE_WORDS, DesignResult
from ultraquiet.design.tones.inner_loop import Inner, Inverse
from ultraquiet.values.interconnect import feedback, gain, parallel, sensitivity
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

SETTLED = 4.0  # time constants until an exponential is within two per cent
SLOWER = 2**0.5  # steps in which a tone's resonator is made slower
MISSED = SLOWER**0.5  # of the time asked for: beyond half a step, where a tone is nearer to one slowed than to its time
SLOWEST = 1e6  # periods in which a tone settles before a design is given up: of 15 Hz most of a day


@dataclass(frozen=True)
class BankShape:
    """How deep the notches of a bank are, dB, and where its low-passes begin, in multiples of the tones."""

    depth_db: float
    roll_off: float | None = None

    def states(self, g: Inverse) -> int:
        """Return how many states a tone takes: two a direction, and one a reading for a low-pass."""
        return 2 * g.S.size + (0 if self.roll_off is None else g.U.shape[0])

    def owned(self, inverses: list[Inverse]) -> list[slice]:
        """Return which of a bank's states belong to each tone; those of its directions come first."""
        ends = np.cumsum([0] + [self.states(g) for g in inverses]).tolist()
        return [slice(*pair) for pair in pairwise(ends)]


class QuietBank(NamedTuple):
    """A bank that amplifies little enough, None where none does; how much slower than asked each tone is.

    `loudest_hz` is where the last one tried amplified most, or its most unstable pole.
    """

    bank: StateSpace | None
    slowed: FloatArray
    loudest_hz: float


@dataclass(frozen=True)
class Amplification:
    """How far a bank may amplify by itself, and with the law around it, in dB; None is not asked."""

    bank_db: float
    loop_db: float | None = None

    def __str__(self) -> str:
        own = f"{self.bank_db:g} dB"
        return own if self.loop_db is None else f"{own}, and the whole loop below {self.loop_db:g} dB,"


def too_loud(who: str, inner: Inner, most: Amplification) -> str:
    """Return why no bank can keep to what the whole loop may amplify: without it, it does already; else nothing."""
    if most.loop_db is None:
        return ""
    peak, at_hz = peak_sensitivity(inner.plant, inner.first)
    if peak < most.loop_db:
        return ""
    return (
        f"{who}: without a bank the loop amplifies by {peak:.3g} dB at {at_hz:.4g} Hz already; 'loop_peak_db' must be "
        f"above that, got {most.loop_db:g}."
    )


def quiet_bank(
    inner: Inner,
    tones_hz: FloatArray,
    inverses: list[Inverse],
    settling_s: FloatArray,
    shape: BankShape,
    most: Amplification,
    slowed: FloatArray | None = None,
) -> QuietBank:
    """Return a bank that is stable and amplifies by `most` at most, and how much slower than asked each tone is.

    Where a bank amplifies too much, the tone whose resonator is the loudest there is slowed, and so on: a tone where
    the plant is weak has a strong inverse, and pays alone for it. A slow enough bank always is quiet; how slow one may
    become is counted in periods of its tones, so that what is found does not hang on the time asked for.
    """
    rate = inner.seen.rate_hz
    assert rate is not None
    slowed = np.ones(tones_hz.size) if slowed is None else slowed.copy()
    while True:
        bank = resonators(tones_hz, inverses, rate, SETTLED / (settling_s * slowed * rate), shape)
        excess, at_hz = _worst_spot(inner, bank, most)
        if excess <= 0:
            return QuietBank(bank, slowed, at_hz)
        G = inner.seen.frequency_response([at_hz])[:, :, 0]
        parts = [_only(bank, np.arange(bank.states)[own]) for own in shape.owned(inverses)]
        loud = [float(np.linalg.norm(G @ K.frequency_response([at_hz])[:, :, 0], 2)) for K in parts]
        k = int(np.argmax(loud))
        if settling_s[k] * slowed[k] * tones_hz[k] >= SLOWEST:
            return QuietBank(None, slowed, at_hz)
        slowed[k] *= SLOWER


def still_loud(
    who: str, inner: Inner, tones_hz: FloatArray, settled_s: FloatArray, most: Amplification, at_hz: float
) -> str:
    """Return why no bank is quiet: two tones that it cannot tell apart in its time, or a plant that is loud elsewhere.

    Args:
        who: opens the sentence.
        inner: the plant that the bank meets.
        tones_hz: rising or not, all different.
        settled_s: what each tone settled in when the search ended.
        most: what was asked.
        at_hz: where the bank amplified most.
    """
    said = f"{who}: no bank for {_listed(tones_hz)} Hz keeps below {most} of amplification, when it settles in "
    said += f"{settled_s.max():.4g} s; "
    rising = np.sort(tones_hz)
    k = int(np.argmin(np.diff(rising))) if rising.size > 1 else 0
    if rising.size > 1 and (rising[k + 1] - rising[k]) * settled_s.max() < SETTLED:
        return f"{said}{rising[k]:.10g} and {rising[k + 1]:.10g} Hz lie too near to each other."
    sizes = np.linalg.norm(np.moveaxis(inner.seen.frequency_response([*tones_hz, at_hz]), 2, 0), 2, axis=(1, 2))
    weakest = int(np.argmin(sizes[:-1]))
    return (
        f"{said}it is loudest at {at_hz:.4g} Hz, where the plant answers {sizes[-1] / sizes[weakest]:.3g} times as "
        f"strongly as at {tones_hz[weakest]:.4g} Hz."
    )


def _listed(tones_hz: FloatArray) -> str:
    return ", ".join(f"{f:g}" for f in tones_hz)


def _worst_spot(inner: Inner, bank: StateSpace, most: Amplification) -> tuple[float, float]:
    """Return by how many dB a bank amplifies too much and where it does, Hz.

    For an unstable loop infinity and its most unstable pole's frequency.
    """
    poles = feedback(inner.seen, bank).poles()
    worst = poles[np.argmax(np.abs(poles))]
    assert bank.rate_hz is not None
    if np.abs(worst) >= 1:
        return np.inf, float(np.abs(np.angle(worst))) * bank.rate_hz / (2 * np.pi)
    peak, at_hz = peak_sensitivity(inner.seen, bank)
    found = [(peak - most.bank_db, at_hz)]
    if most.loop_db is not None:
        peak, at_hz = peak_sensitivity(inner.plant, inner.joined(bank))
        found.append((peak - most.loop_db, at_hz))
    return max(found)


def resonators(
    tones_hz: FloatArray, inverses: list[Inverse], rate_hz: float, speed: FloatArray, shape: BankShape
) -> StateSpace:
    """Return the bank: two states for each direction of each tone, poles at rho e^jw, and those of low-passes.

    Args:
        tones_hz: tones, `(nt,)`.
        inverses: of G at each.
        rate_hz: sampling rate.
        speed: a, the share of each tone that goes in each sample, `(nt,)`.
        shape: depth of the notch, a / (1 - rho), and roll-off.
    """
    rho = 1.0 - speed / 10 ** (shape.depth_db / 20)
    w = 2 * np.pi * tones_hz / rate_hz
    plain = [_resonator(w[i], g, rate_hz, speed[i], rho[i]) for i, g in enumerate(inverses)]
    if shape.roll_off is None:
        return stacked(plain)
    return stacked([_heard_through(each, tone, shape.roll_off) for each, tone in zip(plain, w, strict=True)])


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


def _heard_through(resonator: StateSpace, w: float, roll_off: float) -> StateSpace:
    """Return a resonator behind F = (1 - p) / (z - p), p = e^(-roll_off w), its drive turned such that F is one at w.

    By partial fractions, so that no state drives another, with L the resonator's pole:

        (e^jw - p) / ((z - L) (z - p)) = (e^jw - p) / (L - p) (1 / (z - L) - 1 / (z - p)).
    """
    n, ny = resonator.states, resonator.B.shape[1]
    p, pole = np.exp(-roll_off * w), resonator.A[0, 0] + 1j * resonator.A[n // 2, 0]
    turned = (resonator.B[: n // 2] + 1j * resonator.B[n // 2 :]) * (np.exp(1j * w) - p) / (pole - p)
    drive = np.vstack([turned.real, turned.imag])
    A = np.block([[resonator.A, np.zeros((n, ny))], [np.zeros((ny, n)), p * np.eye(ny)]])
    B, C = np.vstack([drive, np.eye(ny)]), np.hstack([resonator.C, -resonator.C @ drive])
    return StateSpace(A, B, C, resonator.D, resonator.rate_hz)


def facts(
    inner: Inner, bank: StateSpace, tones_hz: FloatArray, inverses: list[Inverse], shape: BankShape
) -> dict[str, Any]:
    """Return what the bank does at each tone: depth, settling, margin of phase, directions."""
    poles = feedback(inner.seen, bank).poles()
    S = sensitivity(inner.seen, bank).frequency_response(tones_hz)
    rows: dict[str, dict[float, Any]] = {"depth_db": {}, "settling_s": {}, "phase_margin_deg": {}, "directions": {}}
    rate = bank.rate_hz
    assert rate is not None
    for i, (tone, g, mine) in enumerate(zip(tones_hz.tolist(), inverses, shape.owned(inverses), strict=True)):
        rows["depth_db"][tone] = -20 * float(np.log10(np.linalg.norm(g.U.conj().T @ S[:, :, i] @ g.U, 2)))
        # the poles that this tone's directions own: those nearest to where a slow loop would have them
        own = slice(mine.start, mine.start + 2 * g.S.size)
        place = np.linalg.eigvals(bank.A[own, own])[0]
        place = place.real + 1j * abs(place.imag)
        nearest = poles[np.argsort(np.abs(poles - place))[: g.S.size]]
        rows["settling_s"][tone] = -SETTLED / (rate * float(np.log(np.abs(nearest).max())))
        G = feedback(inner.seen, _without(bank, mine)).frequency_response([tone])[:, :, 0]
        turned = np.angle(np.linalg.eigvals(g.U.conj().T @ G @ (g.V / g.S)))
        rows["phase_margin_deg"][tone] = 90.0 - float(np.degrees(np.abs(turned).max()))
        rows["directions"][tone] = g.S.size
    return rows


def timed(result: DesignResult, times: FloatArray, asked: bool, most: Amplification) -> DesignResult:
    """Return a result that says how long its slowest tone takes to settle, `short` where one misses the time asked for.

    Args:
        result: with `settling_s` and `slowed` among its `details`.
        times: what each tone was given to settle, s, `(nt,)`, in the order of the details.
        asked: whether somebody asked for them: the usual ones are a wish, and a wish cannot be missed.
        most: what tones are slowed for.
    """
    word, sentence = result.status.word, result.status.sentence
    if word not in STABLE_WORDS:
        return result
    settled: dict[float, float] = result.details["settling_s"]
    given = dict(zip(settled, times.tolist(), strict=True))
    missed = [tone for tone in settled if settled[tone] > MISSED * given[tone]]
    slowest = max(settled, key=lambda tone: settled[tone])
    which = "tone" if len(settled) == 1 else "slowest tone"
    takes = f"The {which}, {slowest:.10g} Hz, settles in {settled[slowest]:.3g} s"
    if not missed:
        return replace(result, status=Status(word, f"{sentence} {takes}."))
    worst = max(missed, key=lambda tone: settled[tone] / given[tone])
    why = f": it was slowed to keep below {most} of amplification" if result.details["slowed"][worst] > 1 else ""
    if not asked:  # all tones were given one time, so the slowest is the one that misses it most
        return replace(result, status=Status(word, f"{sentence} {takes}, {given[worst]:.3g} s is usual{why}."))
    said = f"The tone at {worst:.10g} Hz settles in {settled[worst]:.3g} s, {given[worst]:.3g} s was asked{why}."
    if len(missed) > 1:
        said += f" {counted(len(missed) - 1, 'more tone misses its time', 'more tones miss theirs')}."
    last = "" if worst == slowest else f" {takes}."
    short = StatusWord.SHORT if result.status.ok else word
    return replace(result, status=Status(short, f"{said} {sentence}{last}"))


def _without(bank: StateSpace, mine: slice) -> StateSpace:
    return _only(bank, np.delete(np.arange(bank.states), mine))


def _only(bank: StateSpace, kept: NDArray[np.intp]) -> StateSpace:
    if not kept.size:
        return gain(np.zeros(bank.D.shape), bank.rate_hz)
    return StateSpace(bank.A[np.ix_(kept, kept)], bank.B[kept], bank.C[:, kept], bank.D, bank.rate_hz)
