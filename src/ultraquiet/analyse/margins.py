"""How far a loop is from instability: peak sensitivity, loop-at-a-time margins, disk margins."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray, some_lines
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.peaks import (
    Channels,
    Crossings,
    channel_crossings,
    diagonal,
    diagonal_at,
    ends,
    refined,
    response_at,
    with_ends,
)
from ultraquiet.linalg.even import evened
from ultraquiet.linalg.modal_response import residues
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.joined.wires import unswapped
from ultraquiet.values.state_space import StateSpace

POINTS = 3000  # of the default grid; crossings are interpolated between its points
DECADES = 5.0  # the default grid's span below its upper end
STILL_HZ = 1e-9  # a pole slower than this, thirty years, is at rest
UNTIMED_HZ = 1e-3  # stands for the fastest pole where none moves
RINGING = 0.01  # relative damping below which a pole gets lines of its own: the grid's step is 0.4 %
BOUNDARY = 1e-9  # poles this near the stability boundary are on it, relative to their modulus
REST = 1e-7  # per sample: rounding sends the halves of a double integrator so far from one
ROUNDED = 1e-13  # of the fastest motion, or per sample: so far rounding may send a pole off the boundary
PULLED = 5e-3  # of the frequency of a pole on the boundary: as near to it a response is measured, a damping ratio
CLOSE = 150  # lines about a pole at rest, log-spaced, to beyond where what it does has fallen by 20 dB
_NEAR = np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0])
BESIDE = np.concatenate([-_NEAR, _NEAR])  # of those lines, in widths of the pole


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins of each loop opened by itself, the others closed; every array is `(loops,)`.

    Attributes:
        gain_up_db: extra gain that the loop stands; infinity when no gain upsets it.
        gain_down_db: loss of gain it stands (a positive number).
        phase_deg: phase lag it stands at its gain crossings.
        delay_s: extra delay it stands, seconds.
        disk: alpha, the radius of the symmetric disk of joint gain and phase changes it stands (0 none, 2 all).
    """

    gain_up_db: FloatArray
    gain_down_db: FloatArray
    phase_deg: FloatArray
    delay_s: FloatArray
    disk: FloatArray


@takes_systems
def peak_sensitivity(plant: StateSpace, controller: StateSpace) -> tuple[float, float]:
    """Return the largest amplification of the loop in dB and its frequency in Hz.

    20 log10 max over f of the largest singular value of S = (I - G K)^-1, u = K y.

    Args:
        plant: G.
        controller: K, its sign inside.

    Returns:
        `(peak_db, f_hz)`; infinity when the loop is unstable.

    Below 6 dB every loop keeps a gain margin of at least 2 and 29 degrees of phase, in every direction.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0)
    >>> [round(v, 3) for v in peak_sensitivity(G, K)]
    [3.522, 50.0]
    """
    gain, f_hz = hinf_norm(sensitivity(*even_inputs(plant, controller)))
    return (20 * float(np.log10(gain)) if np.isfinite(gain) else np.inf), f_hz


@takes_systems
def loop_margins(
    plant: StateSpace, controller: StateSpace, side: str = "output", f_hz: ArrayLike | None = None
) -> Margins:
    """Return the margins of every loop, opened one at a time at the plant's outputs or inputs.

    The open loop i, others closed, is L_i = 1 / S_ii - 1 (negative feedback), with S = (I - G K)^-1 at the outputs and
    (I - K G)^-1 at the inputs.

    Args:
        plant: G.
        controller: K, u = K y.
        side: `output` or `input`.
        f_hz: grid in Hz on which crossings are sought; log-spaced up to Nyquist when absent.

    Returns:
        `Margins`; zeros everywhere for an unstable loop.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> K = StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0)
    >>> round(float(loop_margins(G, K).gain_up_db[0]), 2)
    9.54
    """
    S = even_sensitivity(plant, controller, side)
    return margins_of(S, f_hz)[0]


def even_sensitivity(plant: StateSpace, controller: StateSpace, side: str) -> StateSpace:
    """Return D S D^-1, S = (I - L)^-1 at one end of the plant, with a diagonal D of powers of two that evens channels.

    S_ii and what a change of each channel does are those of S; channels in units decades apart cost no digits.
    """
    G, K = even_loop(plant, controller)
    return sensitivity(G, K) if side == "output" else sensitivity(K, G)


def even_loop(plant: StateSpace, controller: StateSpace) -> tuple[StateSpace, StateSpace]:
    """Return plant and controller with states and channels evened out by powers of two: the same loop, the same poles.

    S at either end is D S D^-1 with a diagonal D.
    """
    G, K = even_inputs(plant, controller)
    if K.D.shape != G.D.shape[::-1]:
        return G, K  # to be refused by who joins them
    y = _between(np.hstack([G.C, G.D]), np.vstack([K.B, K.D]).T)
    G = StateSpace(G.A, G.B, G.C / y[:, None], G.D / y[:, None], G.rate_hz)
    return G, StateSpace(K.A, K.B * y, K.C, K.D * y, K.rate_hz)


def even_inputs(plant: StateSpace, controller: StateSpace) -> tuple[StateSpace, StateSpace]:
    """Return plant and controller with their states and the plant's inputs evened out, of which S does not depend."""
    if controller.D.shape != plant.D.shape[::-1]:
        return plant, controller  # to be refused by who joins them
    unswapped("loop", controller, plant)
    (A, B, C), (a, b, c) = (evened(s.A, s.B, s.C) for s in (plant, controller))
    u = _between(np.hstack([c, controller.D]), np.vstack([B, plant.D]).T)
    G = StateSpace(A, B * u, C, plant.D * u, plant.rate_hz)
    return G, StateSpace(a, b, c / u[:, None], controller.D / u[:, None], controller.rate_hz)


def _between(leaving: FloatArray, entering: FloatArray) -> FloatArray:
    """Return a power of two for each channel that divides what leaves and multiplies what enters: both become alike."""
    sizes = [np.linalg.norm(rows, axis=1) for rows in (leaving, entering)]
    both = (sizes[0] > 0) & (sizes[1] > 0)
    power = np.zeros(both.shape)
    power[both] = np.round((np.log2(sizes[0][both]) - np.log2(sizes[1][both])) / 2)
    return np.exp2(power)


def margins_of(S: StateSpace, f_hz: ArrayLike | None = None) -> tuple[Margins, list[Crossings]]:
    """Return the margins of every loop from the sensitivity at its end, S = (I - L)^-1, and what they are taken from.

    An unstable loop has no crossings.
    """
    if not S.is_stable():
        return Margins(*(np.zeros(S.D.shape[0]) for _ in range(5))), []
    if f_hz is None:
        f = default_grid(S)
        f = with_ends(f, f[-1] * 10**-DECADES, S.poles(), S.rate_hz)
    else:
        f = np.unique(grid_given("loop_margins", f_hz))
    at, on_grid = diagonal_at(S), diagonal(S, f)
    beside = ends(S.rate_hz) if f_hz is None else None
    crossings = channel_crossings(S, f, on_grid, beside)
    # alpha = 1 / ||S_ii - 1/2|| (Seiler, Packard and Gahinet 2020, doi:10.1109/MCS.2020.3005277)
    sizes = [_peak_off_half(at, i, f, on_grid[i], beside) for i in range(S.D.shape[0])]
    disk = [1.0 / size if size > 0 else np.inf for size in sizes]  # S = 1/2 at all frequencies stands any change
    columns = (np.array(column) for column in zip(*map(_least, crossings), strict=True))
    return Margins(*columns, disk=np.array(disk)), crossings


def _peak_off_half(
    at: Callable[[Channels, FloatArray], ComplexArray],
    i: int,
    f: FloatArray,
    S: ComplexArray,
    beside: FloatArray | None,
) -> float:
    """Return the largest |S_ii - 1/2|, between the lines of the grid too."""
    return refined(lambda lines: np.abs(at(np.full(lines.size, i), lines) - 0.5), f, np.abs(S - 0.5), beside)[0]


def _least(crossings: Crossings) -> tuple[float, float, float, float]:
    """Return gain-up dB, gain-down dB, phase deg and delay s of one loop."""
    factors = crossings.factors
    up, down = factors[factors > 1], factors[factors < 1]
    with np.errstate(divide="ignore"):
        delay = crossings.lag_rad / (2 * np.pi * crossings.phase_hz)
    return (
        20 * float(np.log10(up.min())) if up.size else np.inf,
        -20 * float(np.log10(down.max())) if down.size else np.inf,
        float(crossings.phase_deg.min(initial=np.inf)),
        float(delay.min(initial=np.inf)),
    )


def grid_given(who: str, f_hz: ArrayLike) -> FloatArray:
    """Return a caller's frequencies in Hz, rising, one at least."""
    return np.sort(some_lines(who, f_hz))


def default_grid(S: StateSpace) -> FloatArray:
    """Return frequencies in Hz up to Nyquist, log-spaced, with those of the poles; denser where poles ring.

    A pole s = -d + j w makes features as narrow as d, wherever the grid's own lines are: lines stand at several
    multiples of d to both sides of w.
    """
    size, width = _places(S)
    return _grid(size, width, _top(S.rate_hz, size))


def _places(S: StateSpace) -> tuple[FloatArray, FloatArray]:
    """Return the frequency and the width of each pole, Hz."""
    poles = S.poles()
    if S.rate_hz is None:
        return np.abs(poles) / (2 * np.pi), np.abs(poles.real) / (2 * np.pi)
    rates = S.rate_hz * _rates(poles) / (2 * np.pi)
    return np.abs(rates.imag), np.abs(rates.real)


def _rates(poles: ComplexArray) -> ComplexArray:
    """Return what poles of a sampled system are in continuous time, per sample."""
    tiny = np.finfo(float).tiny
    return np.asarray(np.log(np.where(np.abs(poles) < tiny, tiny, poles).astype(np.complex128)), dtype=np.complex128)


def _top(rate_hz: float | None, size: FloatArray) -> float:
    if rate_hz is not None:
        return rate_hz / 2
    fastest = float(size.max(initial=0.0))
    return 10 * (fastest if fastest > STILL_HZ else UNTIMED_HZ)


def _grid(size: FloatArray, width: FloatArray, top: float) -> FloatArray:
    bottom = top * 10**-DECADES
    narrow = width < np.maximum(RINGING * size, bottom)
    beside = (size[narrow, None] + width[narrow, None] * BESIDE).reshape(-1)
    lines = np.concatenate([np.geomspace(bottom, top, POINTS), size[size < top], beside[(beside > 0) & (beside < top)]])
    return np.unique(lines)


class Verge(NamedTuple):
    """The poles of a plant on its stability boundary, in Hz.

    Attributes:
        on: `(states,)`, which of the poles.
        hz: their frequencies, zero at rest.
        radius_hz: how near to each the response is taken as it is.
    """

    on: NDArray[np.bool_]
    hz: FloatArray
    radius_hz: FloatArray


def verge(plant: StateSpace) -> Verge:
    """Return the poles on the stability boundary, and about each the circle on which the response is measured.

    A resonance has a circle of a share of its frequency, a damping ratio so to speak; a pole at rest, of no frequency
    of its own, of that share of the slowest motion beside it. The rate at which a plant is sampled does not count, but
    for one that does nothing else than integrate.
    """
    poles = plant.poles()
    rates = poles if plant.rate_hz is None else _rates(poles)
    size = np.abs(rates)
    unit = float(size.max(initial=0.0)) if plant.rate_hz is None else 1.0
    rest = size <= (BOUNDARY if plant.rate_hz is None else REST) * unit
    on = rest | (np.abs(rates.real) <= np.maximum(BOUNDARY * size, ROUNDED * unit))
    slowest = float(size[~rest].min(initial=np.inf if plant.rate_hz is None else 1.0))
    radius = PULLED * np.where(rest, slowest if np.isfinite(slowest) else 1.0, size)
    per_hz = (plant.rate_hz or 1.0) / (2 * np.pi)
    return Verge(on, np.where(rest, 0.0, np.abs(rates.imag))[on] * per_hz, radius[on] * per_hz)


def bounded_response(plant: StateSpace) -> Callable[[FloatArray], ComplexArray]:
    """Return what gives a plant's response `(ny, nu, nf)` at frequencies in Hz, bounded at poles on the boundary.

    It is the plant's own but in a small circle about each such pole, whose outer half it follows in place of the axis,
    as a Nyquist contour does.
    """
    edge = verge(plant)
    if not edge.on.any():
        return response_at(plant)
    split, rate = residues(plant.A, plant.B, plant.C, plant.D), plant.rate_hz

    def at(f: FloatArray) -> ComplexArray:
        off = np.sqrt(np.maximum(edge.radius_hz**2 - (f[:, None] - edge.hz) ** 2, 0.0)).max(axis=1)
        s = 2 * np.pi * (off + 1j * f)
        return np.asarray(split.at(s if rate is None else np.exp(s / rate)), dtype=np.complex128)

    return at


def bounded_grid(plant: StateSpace) -> FloatArray:
    """Return the `default_grid` for that response; with a pole at rest it begins inside its circle."""
    edge = verge(plant)
    size, width = _places(plant)
    size[edge.on], width[edge.on] = edge.hz, edge.radius_hz
    lines = _grid(size, width, _top(plant.rate_hz, size))
    at_rest = edge.radius_hz[edge.hz == 0]
    if not at_rest.size:
        return lines
    # what is nearer to rest is as loud, and another end of the grid would be another band
    first, last = at_rest.min() * _NEAR[[0, -1]]
    beyond = lines[lines > first]
    return np.unique(np.concatenate([np.geomspace(first, max(beyond[0], last), CLOSE), beyond]))
