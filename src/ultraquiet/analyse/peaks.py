"""Peaks over frequency and crossings of an axis, found between the points of a grid."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.provenance import ByContents, content_hash
from ultraquiet.linalg.modal_response import Residues, Splitting, splitting
from ultraquiet.linalg.response import points
from ultraquiet.values.state_space import StateSpace

Channels = NDArray[np.intp]  # numbers of channels
NEAR = 0.9  # share of the highest point that a neighbour needs to be looked at more closely
MOST = 8  # peaks looked at
INNER = 3  # points between a peak and each neighbour: a round narrows it to a quarter
HALVINGS = 48  # of an interval of the grid: down to rounding
AXIS = 1e-9  # relative: a response at an end of a grid is real but for rounding
REAL = 1e-3  # of the slowest pole: below it a response is that at 0 Hz but for 1e-6, and likewise at the other end
A_DECADE = 40  # lines towards the ends of the axis
CLOSEST = 1e-15  # of the sampling rate: a line is no nearer to an end of the axis, where it could not be told from it
ROUNDS = 9  # 4^-9 of the grid's step: a kink's place to 4e-6 of it


def response_at(system: StateSpace) -> Callable[[FloatArray], ComplexArray]:
    """Return what gives the response `(ny, nu, nf)` at frequencies in Hz, quickly and as often as wanted.

    A continuous system may be asked at infinity.
    """
    split = _split(system)

    def at(f: FloatArray) -> ComplexArray:
        finite = np.isfinite(f)
        values = split.at(points(np.where(finite, f, 0.0), system.rate_hz))
        values[:, :, ~finite] = system.D[:, :, None]
        return values

    return at


def _split(system: StateSpace) -> Residues:
    matrices, discrete = (system.A, system.B, system.C), system.rate_hz is not None
    return _splitting(ByContents(matrices, content_hash(*matrices)), discrete).beside(system.D)


# The margins of a loop are taken from one sensitivity, whose direct term alone differs from one to the other.
@lru_cache(maxsize=16)
def _splitting(system: ByContents[tuple[FloatArray, FloatArray, FloatArray]], discrete: bool) -> Splitting:
    return splitting(*system.value, discrete)


def ends(rate_hz: float | None) -> FloatArray:
    """Return the ends of the axis in Hz, which a logarithmic grid never reaches: zero, and infinity or Nyquist."""
    return np.array([0.0, np.inf if rate_hz is None else rate_hz / 2])


def with_ends(f: FloatArray, dense: float, poles: ComplexArray, rate_hz: float | None) -> FloatArray:
    """Return a grid, dense from a frequency in Hz on, with 0 Hz and lines towards both ends of the axis.

    What crosses an axis within the first or last interval of a grid shows between such lines; beyond them, in Hz below
    the slowest pole, above the fastest or nearer to Nyquist than any, it crosses as high as it stands at the end.
    """
    if not poles.size:
        return f
    if rate_hz is None:
        size = np.abs(poles) / (2 * np.pi)
        more = [_decades(REAL * size.min(), dense), _decades(f[-1], size.max() / REAL)]
        return np.unique(np.concatenate([[0.0], f, *more]))
    off = np.log(np.multiply.outer([1.0, -1.0], poles[np.abs(poles) > 0]))  # from z = 1, and from Nyquist's z = -1
    least = np.abs(off).min(axis=1, initial=np.inf) / (2 * np.pi)
    low, high = rate_hz * np.maximum(REAL * least, CLOSEST)
    last = rate_hz / 2 - _decades(high, rate_hz / 2 - f[f < rate_hz / 2].max(initial=0.0))
    return np.unique(np.concatenate([[0.0], f, _decades(low, dense), last]))


def _decades(low: float, high: float) -> FloatArray:
    """Return lines from low to high, evenly spaced in their logarithm; none where low is above high."""
    if not 0 < low < high:
        return np.zeros(0)
    return np.geomspace(low, high, 1 + int(np.ceil(A_DECADE * np.log10(high / low))))


def beside_poles(poles: ComplexArray, rate_hz: float | None, sharp: float, widths: FloatArray) -> FloatArray:
    """Return lines in Hz about each pole of less damping than `sharp`, so many of its widths off: peaks hide there."""
    s = poles if rate_hz is None else rate_hz * np.log(poles[np.abs(poles) > 0])
    hz, width = np.abs(s.imag) / (2 * np.pi), -s.real / (2 * np.pi)
    near = (s.imag > 0) & (width < sharp * hz)
    return np.asarray((hz[near] + np.outer(widths, width[near])).ravel(), dtype=np.float64)


def refined(
    values_at: Callable[[FloatArray], FloatArray],
    f: FloatArray,
    values: FloatArray,
    beside: FloatArray | None = None,
    rounds: int = ROUNDS,
) -> tuple[float, float]:
    """Return the largest value and its frequency, with the grid narrowed around every peak that may be the largest.

    Args:
        values_at: gives values `(n,)` at frequencies `(n,)`.
        f: grid, Hz, ascending.
        values: on the grid.
        beside: single frequencies that count too, the ends of the axis for instance.
        rounds: of narrowing, each to a quarter.
    """
    k = int(np.argmax(values))
    best, at = float(values[k]), float(f[k])
    if beside is not None:
        alone = values_at(beside)
        if alone.max() > best:
            best, at = float(alone.max()), float(beside[np.argmax(alone)])
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (values >= NEAR * best))
    if not tops.size:
        return best, at  # an end of the axis stands above every line of the grid
    tops = tops[np.argsort(-values[tops])][:MOST]
    middle, low, high = f[tops], f[np.maximum(tops - 1, 0)], f[np.minimum(tops + 1, f.size - 1)]
    share = np.linspace(0, 1, INNER + 1, endpoint=False)
    for _ in range(rounds):
        below = low[:, None] + share * (middle - low)[:, None]
        above = high[:, None] + share * (middle - high)[:, None]
        points = np.concatenate([below, middle[:, None], above[:, ::-1]], axis=1)
        levels = values_at(points.reshape(-1)).reshape(points.shape)
        k = np.argmax(levels, axis=1)
        rows = np.arange(k.size)
        middle, low = points[rows, k], points[rows, np.maximum(k - 1, 0)]
        high = points[rows, np.minimum(k + 1, points.shape[1] - 1)]
        if levels.max() > best:
            best, at = float(levels.max()), float(points.reshape(-1)[np.argmax(levels)])
    return best, at


class Crossings(NamedTuple):
    """Changes of one channel that bring the loop to the verge: gain factors with their Hz, phases with their Hz.

    `lag_rad` is the lag, between 0 and 2 pi, at which the loop passes through -1.
    """

    factors: FloatArray
    gain_hz: FloatArray
    phase_deg: FloatArray
    phase_hz: FloatArray
    lag_rad: FloatArray


def channel_crossings(
    S: StateSpace, f: FloatArray, diagonal: ComplexArray, beside: FloatArray | None
) -> list[Crossings]:
    """Return the crossings of every channel of a stable loop.

    With X = S_ii - 1/2 a factor k upsets the loop where X is real, k = (X + 1/2) / (X - 1/2), and a phase p where X is
    imaginary, |X| = 1 / (2 tan(p / 2)): S_ii = 1 / (1 + L) and k L = -1.

    Args:
        S: sensitivity at one end of the plant, stable.
        f: grid, Hz, rising.
        diagonal: `(channels, nf)` S_ii on it.
        beside: ends of the axis, Hz, beyond those of the grid; None without them.
    """
    at = diagonal_at(S)
    X = diagonal - 0.5
    positive = X.imag > 0
    if f.size > 1:  # a response that is real has no sign there but that of rounding
        positive[:, 0] = positive[:, int(_real_at(f[0], S.rate_hz))]
        positive[:, -1] = positive[:, -1 - int(_real_at(f[-1], S.rate_hz))]
    (channels, gain_hz), (turned, phase_hz) = _roots(at, f, positive, np.imag), _roots(at, f, X.real > 0, np.real)
    real = (at(channels, gain_hz) - 0.5).real
    edges = np.unique(f[[0, -1]] if beside is None else np.concatenate([f[[0, -1]], beside]))
    more, ends_hz = np.repeat(np.arange(len(X)), edges.size), np.tile(edges, len(X))
    end = at(more, ends_hz) - 0.5
    here = _real_at(ends_hz, S.rate_hz) | (np.abs(end.imag) <= AXIS * np.abs(end))
    channels, gain_hz = np.concatenate([channels, more[here]]), np.concatenate([gain_hz, ends_hz[here]])
    real = np.concatenate([real, end.real[here]])
    # |X| < 1/2 belongs to a factor below zero, a turned sign
    kept = np.abs(real) > 0.5
    channels, gain_hz, real = channels[kept], gain_hz[kept], real[kept]
    imaginary = (at(turned, phase_hz) - 0.5).imag
    rows: list[Crossings] = []
    for i in range(len(X)):
        g, p = channels == i, turned == i
        size = np.maximum(np.abs(imaginary[p]), np.finfo(float).tiny)
        phase = 2 * np.arctan(1 / (2 * size))
        # L = (1/2 - X) / (1/2 + X) comes to -1 by a lag of p where X = j |X|, by a lead of p where X = -j |X|
        lag = np.where(imaginary[p] > 0, phase, 2 * np.pi - phase)
        factors = (real[g] + 0.5) / (real[g] - 0.5)
        rows.append(Crossings(factors, gain_hz[g], np.degrees(phase), phase_hz[p], lag))
    return rows


def _real_at(f: FloatArray, rate_hz: float | None) -> NDArray[np.bool_]:
    """Return whether the response of a real system is real at frequencies in Hz, whatever rounding leaves beside it."""
    return (f == 0) | (f == (np.inf if rate_hz is None else rate_hz / 2))


def _roots(
    at: Callable[[Channels, FloatArray], ComplexArray],
    f: FloatArray,
    above: NDArray[np.bool_],
    part: Callable[[ComplexArray], FloatArray],
) -> tuple[Channels, FloatArray]:
    """Return channels and frequencies at which a part of X vanishes: intervals with a change of sign are halved.

    `above` tells where that part is above zero on the grid, `(channels, nf)`.
    """
    channels, k = np.nonzero(above[:, 1:] != above[:, :-1])
    low, high, sign = f[k], f[k + 1], above[channels, k]
    for _ in range(HALVINGS if k.size else 0):
        middle = (low + high) / 2
        before = (part(at(channels, middle) - 0.5) > 0) == sign
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return channels, (low + high) / 2


def diagonal(S: StateSpace, f: FloatArray) -> ComplexArray:
    """Return S_ii at frequencies in Hz, `(channels, nf)`."""
    split, n = _split(S), S.D.shape[0]
    z = points(f, S.rate_hz)
    if split.rest is not None:
        return np.einsum("iif->if", split.at(z))
    return split._replace(terms=split.terms[np.arange(n) * (n + 1)], D=np.diag(S.D)[:, None]).at(z)[:, 0]


def diagonal_at(S: StateSpace) -> Callable[[Channels, FloatArray], ComplexArray]:
    """Return what gives S_ii at frequencies in Hz, for a channel each; a continuous system may be asked at infinity."""
    split = _split(S)
    direct = np.diag(S.D)

    def at(channels: Channels, f: FloatArray) -> ComplexArray:
        finite = np.isfinite(f)
        z = points(np.where(finite, f, 0.0), S.rate_hz)
        if split.rest is not None:
            values = split.at(z)[channels, channels, np.arange(z.size)]
        else:
            values = split.entries(channels, channels, z)
        return np.where(finite, values, direct[channels])

    return at
