"""Disk margins: how much gain and phase may change, in one loop or in all loops at the same time."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frozen, one_of
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.margins import Margins, default_grid, even_loop, even_sensitivity, grid_given, margins_of
from ultraquiet.analyse.mu import mu_bounds, mu_peak
from ultraquiet.analyse.peaks import Crossings, diagonal, diagonal_at, ends, refined
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import append, gain, sensitivity
from ultraquiet.values.state_space import StateSpace

ENDS = ("input", "output")
SIDES = ("output", "input", "both")
SKEW = 10.0  # beyond it a disk is nothing but a gain


@dataclass(frozen=True, eq=False)
class DiskMargins:
    """Disk margins of every loop by itself and of all together.

    A channel's factor is (2 + (1 - skew) d) / (2 - (1 + skew) d), |d| < alpha.

    Attributes:
        alpha: what all channels stand at the same time, each with a factor of its own; 0 for an unstable loop.
        f_hz: where it is reached, Hz.
        alpha_at_most: a margin that is surely not kept: `factors` upset the loop. Equals `alpha` up to three channels.
        factors: `(channels,)` complex factors, one a channel, that bring the loop to the verge at `f_hz`; NaN where
            nothing does.
        loop_alpha, loop_f_hz: `(channels,)` the same for each channel by itself, the others as they are.
        side, skew: as asked for; channels of `both` are the outputs, then the inputs.
        stable: whether the loop is.
    """

    alpha: float
    f_hz: float
    alpha_at_most: float
    factors: ComplexArray
    loop_alpha: FloatArray
    loop_f_hz: FloatArray
    side: str
    skew: float
    stable: bool

    @property
    def gain_range(self) -> tuple[float, float]:
        """Factors between which every channel's gain may lie at the same time."""
        low, high, _ = disk_ranges(self.alpha, self.skew)
        return float(low), float(high)

    @property
    def phase_deg(self) -> float:
        """Phase that every channel may lose or gain at the same time, degrees."""
        return float(disk_ranges(self.alpha, self.skew)[2])


def disk_ranges(alpha: ArrayLike, skew: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the real factors (lowest, highest) inside a disk and the phase in degrees that it allows.

    low = (2 - alpha (1 - skew)) / (2 + alpha (1 + skew)), high = (2 + alpha (1 - skew)) / (2 - alpha (1 + skew)),
    cos(phase) = (1 + low high) / (low + high).

    Args:
        alpha: size of the disk, any shape.
        skew: 0 balances gain up and down; 1 is the disk of T, -1 that of S.

    Returns:
        Lowest factor (negative: a sign may turn), highest factor (infinite when the disk has opened to a half plane or
        the outside of a circle), phase (180 when every phase is allowed).

    >>> low, high, phase = disk_ranges(0.46)
    >>> low.round(2), high.round(2), phase.round(1)
    (np.float64(0.63), np.float64(1.6), np.float64(25.9))

    Seiler, Packard and Gahinet 2020, doi:10.1109/MCS.2020.3005277, equations (9) and (10).
    """
    between("disk_ranges", "skew", skew, -SKEW, SKEW)
    try:
        a = np.asarray(alpha, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"disk_ranges: 'alpha' must be a number or an array of numbers, got {alpha!r}.") from None
    if not np.all(a >= 0):
        raise InputError(f"disk_ranges: 'alpha' must not be negative or NaN, got {alpha!r}.")
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.float64(skew - 1) / np.float64(1 + skew)
        low = np.where(np.isinf(a), limit, (2 - a * (1 - skew)) / (2 + a * (1 + skew)))
        other = np.where(np.isinf(a), low, (2 + a * (1 - skew)) / (2 - a * (1 + skew)))
        cosine = np.where(np.isinf(other), low, (1 + low * other) / (low + other))
    opened = a * (1 + skew) >= 2
    high = np.where(opened, np.inf, other)
    phase = np.degrees(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1.0, 1.0)))
    return low, high, np.where(a == 0, 0.0, phase)


@takes_systems
def disk_margin(
    plant: StateSpace,
    controller: StateSpace,
    side: str = "output",
    f_hz: ArrayLike | None = None,
    skew: float = 0.0,
) -> float:
    """Return alpha, the disk of gain and phase changes that all loops stand at the same time.

    alpha = 1 / max over f of mu(S + (skew - 1) / 2 I), each channel multiplied by its own factor
    (2 + (1 - skew) d) / (2 - (1 + skew) d), |d| < alpha.

    Args:
        plant: G.
        controller: K, u = K y.
        side: `output`, `input`, or `both` for perturbations at sensors and actuators together.
        f_hz: grid, Hz, between whose lines the peak is refined; log-spaced up to Nyquist when absent.
        skew: 0 balances gain up and down.

    Returns:
        alpha (0 for an unstable loop). With skew 0 every channel's gain may vary by the factor
        (1 + alpha / 2) / (1 - alpha / 2) either way, or its phase by 2 atan(alpha / 2), all of them independently.

    >>> G = StateSpace([[0.0, 10.0], [-10.0, 0.0]], np.eye(2), [[1.0, 10.0], [-10.0, 1.0]], np.zeros((2, 2)))
    >>> round(disk_margin(G, gain(-np.eye(2))), 4)
    0.0998

    Seiler, Packard and Gahinet 2020, doi:10.1109/MCS.2020.3005277.
    """
    seen = _seen("disk_margin", plant, controller, side, skew)
    return _inverse(mu_peak(seen, f_hz=f_hz)[0])


@takes_systems
def disk_margins(
    plant: StateSpace,
    controller: StateSpace,
    side: str = "output",
    f_hz: ArrayLike | None = None,
    skew: float = 0.0,
) -> DiskMargins:
    """Return the disk margins of each loop by itself and of all at the same time, and what upsets the loop.

    Args:
        plant: G.
        controller: K, u = K y.
        side: as in `disk_margin`.
        f_hz: grid, Hz.
        skew: of the disk.

    Returns:
        `DiskMargins`; all zero for an unstable loop.

    A loop at a time may look perfect while all together are on the verge: the spinning satellite.

    >>> G = StateSpace([[0.0, 10.0], [-10.0, 0.0]], np.eye(2), [[1.0, 10.0], [-10.0, 1.0]], np.zeros((2, 2)))
    >>> found = disk_margins(G, gain(-np.eye(2)))
    >>> found.loop_alpha.round(3).tolist(), round(found.alpha, 4), [round(g, 2) for g in found.gain_range]
    ([2.0, 2.0], 0.0998, [0.9, 1.1])

    Seiler, Packard and Gahinet 2020, doi:10.1109/MCS.2020.3005277.
    """
    seen = _seen("disk_margins", plant, controller, side, skew)
    count = seen.D.shape[0]
    if not seen.is_stable():
        nothing = frozen(np.zeros(count))
        return DiskMargins(0.0, np.nan, 0.0, frozen(np.ones(count, complex)), nothing, nothing, side, skew, False)
    f = default_grid(seen) if f_hz is None else grid_given("disk_margins", f_hz)
    loops = _each(seen, f, ends(seen.rate_hz) if f_hz is None else None)
    largest, at = mu_peak(seen, f_hz=f_hz)
    # by triangular solves: modes cost digits, and this is the proof
    here = mu_bounds(seen.frequency_response([at]) if np.isfinite(at) else seen.D.astype(np.complex128))
    d = np.diagonal(here.perturbation[:, :, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = (2 + (1 - skew) * d) / (2 - (1 + skew) * d)
    at_most = _inverse(float(here.lower[0]))
    return DiskMargins(_inverse(largest), at, at_most, frozen(factors), *loops, side=side, skew=skew, stable=True)


def _each(seen: StateSpace, f: FloatArray, beside: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return alpha and its frequency for each channel alone."""
    at, sizes = diagonal_at(seen), np.abs(diagonal(seen, f))

    def one(i: int) -> tuple[float, float]:
        return refined(lambda lines: np.abs(at(np.full(lines.size, i), lines)), f, sizes[i], beside)

    peaks = [one(i) for i in range(seen.D.shape[0])]
    return frozen(np.array([_inverse(v) for v, _ in peaks])), frozen(np.array([at for _, at in peaks]))


def _inverse(largest: float) -> float:
    return 1.0 / largest if largest > 0 else np.inf


def _seen(who: str, plant: StateSpace, controller: StateSpace, side: str, skew: float) -> StateSpace:
    """Return S + (skew - 1) / 2 I at the side asked for: what the disk's d meets."""
    one_of(who, "side", side, SIDES)
    between(who, "skew", skew, -SKEW, SKEW)
    if side == "both":
        S = _both_sides(plant, controller)
    else:
        S = even_sensitivity(plant, controller, side)
    return StateSpace(S.A, S.B, S.C, S.D + 0.5 * (skew - 1) * np.eye(S.D.shape[0]), S.rate_hz)


def _both_sides(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Return D S D^-1, S = (I - L)^-1, for L = [0 G; K 0], the loop seen from outputs and inputs together.

    D is diagonal and evens channels, as in `even_sensitivity`.
    """
    ny, nu = plant.D.shape
    plant, controller = even_loop(plant, controller)
    swap = np.block([[np.zeros((ny, nu)), np.eye(ny)], [np.eye(nu), np.zeros((nu, ny))]])
    loop = append(controller, plant)  # inputs (y, u), outputs (u, y)
    L = StateSpace(loop.A, loop.B, swap @ loop.C, swap @ loop.D, loop.rate_hz)
    return sensitivity(L, gain(np.eye(ny + nu), plant.rate_hz))


@dataclass(frozen=True)
class ChannelChange:
    """A change of one channel alone, all others as they are, that brings the loop to the verge.

    Attributes:
        channel: its number, from zero: an actuator at the plant's input, a sensor at its output.
        kind: `gain` or `phase`.
        amount: dB, positive for more gain, negative for less; degrees, either way.
        f_hz: what begins to grow there.
        disk: size of the smallest symmetric disk that holds the change, as gains and phases are compared:
            2 |k - 1| / (k + 1) for a factor k, 2 tan(p / 2) for a phase p.
    """

    channel: int
    kind: str
    amount: float
    f_hz: float
    disk: float


@dataclass(frozen=True, eq=False)
class EndMargins(Margins):
    """Margins at one end of the plant: those of each loop by itself, and of all at the same time.

    Attributes:
        disk_all: alpha that every channel may use up at the same time, each in its own way (0 for an unstable loop).
        disk_all_hz: where that is least, Hz.
        least_change: of one channel's gain or phase that upsets the loop; None where none does, or it is unstable.
    """

    disk_all: float
    disk_all_hz: float
    least_change: ChannelChange | None


def end_margins(plant: StateSpace, controller: StateSpace, side: str = "output") -> EndMargins:
    """Return all margins at one end of the plant.

    alpha = 1 / max over f of mu(S - I / 2), by the upper bound of mu: what is stated is surely stood, between the lines
    of the grid as far as its neighbours tell.

    Args:
        plant: G.
        controller: K, u = K y.
        side: `input` or `output`.

    Returns:
        `EndMargins`; zeros everywhere for an unstable loop.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0)
    >>> found = end_margins(G, K)
    >>> change = found.least_change
    >>> round(found.disk_all, 4), change.channel, change.kind, round(change.amount, 2), change.f_hz
    (1.0, 0, 'gain', 9.54, 50.0)

    Seiler, Packard and Gahinet 2020, doi:10.1109/MCS.2020.3005277.
    """
    one_of("end_margins", "side", side, ENDS)
    S = even_sensitivity(plant, controller, side)
    each, crossings = margins_of(S)
    arrays = {field.name: getattr(each, field.name) for field in fields(Margins)}
    if not crossings:
        return EndMargins(**arrays, disk_all=0.0, disk_all_hz=np.nan, least_change=None)
    off_half = StateSpace(S.A, S.B, S.C, S.D - np.eye(S.D.shape[0]) / 2, S.rate_hz)
    largest, at = mu_peak(off_half)
    # All at once stand no more than one alone; two searches for one peak agree to their tolerance only.
    together = min(_inverse(largest), float(each.disk.min()))
    return EndMargins(**arrays, disk_all=together, disk_all_hz=at, least_change=_least_change(crossings))


def _least_change(crossings: list[Crossings]) -> ChannelChange | None:
    """Return the change of the smallest disk; of equal ones the first."""
    changes: list[ChannelChange] = []
    for i, c in enumerate(crossings):
        size = 2 * np.abs(c.factors - 1) / (c.factors + 1)
        if size.size:
            k = int(np.argmin(size))
            db = 20 * float(np.log10(c.factors[k]))
            changes.append(ChannelChange(i, "gain", db, float(c.gain_hz[k]), float(size[k])))
        if c.phase_deg.size:
            k = int(np.argmin(c.phase_deg))
            degrees = float(c.phase_deg[k])
            size_of = float(2 * np.tan(np.radians(degrees) / 2))
            changes.append(ChannelChange(i, "phase", degrees, float(c.phase_hz[k]), size_of))
    return min(changes, key=lambda change: change.disk, default=None)
