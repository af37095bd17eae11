"""A level that no stable Q can reach, by Nehari's theorem: what makes a limit a limit and not the best of a basis.

At every frequency, weights that add up to one merge the demands |a_i + b_i Q| <= h_i into one disc
sum w_i |a_i + b_i Q|^2 / h_i^2 <= 1, that is |Q - centre| <= radius. A stable Q inside all discs exists if and only if
the Hankel norm of the unstable part of centre / o is at most one, where o is the outer function with |o| = radius
(Nehari 1957; Helton and Merino 1998, "Classical Control Using H-infinity Methods"). Any weights give a true statement;
those of the convex programme's multipliers give the sharpest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from scipy.fft import next_fast_len

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import NumericalError

LARGEST_TAIL = 2e-3  # of the last Fourier coefficients kept, relative to the largest: the circle is fine enough
LANCZOS = 40
# How far above what a basis reaches a bound is sought, the furthest for which the circle is fine enough; how closely.
DEEPEST_DB, WITHIN_DB = (20.0, 10.0, 5.0, 2.5, 1.25, 0.6, 0.3), 0.04
FURTHEST = 100.0  # from one, beyond which it does not matter how far a norm is from it
LEAST_DISC = 1e-12
LEAST_LOG = -30.0  # of a weight beside the largest
NOT_BINDING = 1e-7  # share of the largest multiplier up to which a point does not bind
APART = 3  # points of the grid from which on two that bind are of two groups


def ramp(angles: FloatArray, first: float, last: float, smoothed: int) -> FloatArray:
    """Return one between two angles, falling to zero at both over so many points inside: larger discs."""
    width = smoothed * (angles[1] - angles[0])
    x = np.clip(np.minimum(angles - first, last - angles) / width, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x * x)


def weights_at(
    angles: FloatArray,
    smoothed: int,
    grid_angles: FloatArray,
    multipliers: Sequence[FloatArray],
    active: Sequence[np.ndarray],
) -> FloatArray:
    """Return the weights `(demands, angles)` of the multipliers found on another grid, smoothed, adding up to one."""
    from scipy.ndimage import gaussian_filter1d

    logs = []
    for multiplier, on in zip(multipliers, active, strict=True):
        at = grid_angles[on]
        density = np.maximum(multiplier[on], 1e-300) / np.maximum(np.gradient(at), 1e-12)
        logs.append(gaussian_filter1d(np.interp(angles, at, np.log(density)), smoothed / 2, mode="reflect"))
    return _shares(np.array(logs))


def weights_between(
    angles: FloatArray,
    smoothed: int,
    grid_angles: FloatArray,
    multipliers: Sequence[FloatArray],
    active: Sequence[np.ndarray],
) -> FloatArray:
    """Return the weights of `weights_at`, their logarithms straight from one group of points that bind to the next.

    A solution of few functions touches its demands at single points. Between two that touch the same demand no other
    one has a say; the points between, at which nothing binds, are not told from those of another demand.
    """
    from scipy.ndimage import gaussian_filter1d

    sizes = np.array([np.where(on, m, 0.0) for m, on in zip(multipliers, active, strict=True)])
    total = sizes.sum(axis=0)
    binding = np.flatnonzero(total > NOT_BINDING * total.max(initial=0.0))
    if not binding.size:
        return weights_at(angles, smoothed, grid_angles, multipliers, active)
    groups = np.split(binding, np.flatnonzero(np.diff(binding) > APART) + 1)
    places = np.array([np.average(grid_angles[g], weights=total[g]) for g in groups])
    share = np.array([sizes[:, g].sum(axis=1) / total[g].sum() for g in groups]).T
    logs = np.log(np.maximum(share, np.exp(LEAST_LOG)))
    level = np.array([np.interp(angles, places, log) for log in logs])
    return _shares(gaussian_filter1d(level, smoothed / 2, axis=1, mode="reflect"))


def _shares(level: FloatArray) -> FloatArray:
    """Return weights that add up to one from their logarithms."""
    share = np.exp(np.clip(level - level.max(axis=0), LEAST_LOG, 0))
    return share / share.sum(axis=0)


@dataclass(frozen=True, eq=False)
class Merged:
    """One demand on equal angles from 0 to pi: |a + b Q| <= limit * level^share, of all plants off by `error`."""

    a: ComplexArray
    b: ComplexArray
    limit: FloatArray
    share: FloatArray | float = 0.0
    error: FloatArray | None = None

    def disc(self, level: float) -> tuple[ComplexArray, FloatArray]:
        """Return a - centre and the radius of the disc that a + b Q lies in at this level."""
        radius = self.limit * level**self.share
        if self.error is None:
            return self.a, radius
        centre, radius = disc_of_every_plant(radius, self.error)
        return self.a - centre, radius


def disc_of_every_plant(peak: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return centre and radius of the least disc, its centre real, that holds every S with |S| + e p |1 - S| <= p.

    That oval is widest where it is real: |S - c|^2 = (1 - c) |S|^2 + c |1 - S|^2 - c (1 - c) (Stewart's theorem) is
    convex in (|S|, |1 - S|) for c from 0 to 1, hence largest at a corner of what the triangle S, 0, 1 and the demand
    leave of them, and at its corners the triangle is flat. The disc on the real stretch as its diameter has such a
    centre. The radius is below zero where there is no such S: no plant off by all of itself is surely quiet.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        above = np.where(peak >= 1, peak * (1 + error) / (1 + peak * error), peak * (1 - error) / (1 - peak * error))
        tight = np.divide(peak * (error - 1), peak * error - 1, where=error > 1, out=np.zeros(np.shape(peak)))
        below = np.where(error > 1, tight, -peak * (1 - error) / (1 + peak * error))
    empty = (peak < 1) & (error >= 1)
    return np.where(empty, 0.0, (above + below) / 2), np.where(empty, -1.0, (above - below) / 2)


def lowest_level(demands: Sequence[Merged], weights: FloatArray, reached: float) -> float:
    """Return the highest level found that no stable Q can meet; nan when the circle is too coarse to tell.

    Args:
        demands: on equal angles from 0 to pi.
        weights: `(demands, angles)`, adding up to one.
        reached: a level that some Q meets. Of the few lines of a narrow band a solver may meet it to rounding, by
            nothing or less: then there is no level below, and nan.

    Raises:
        NumericalError: as `hankel_measure`.
    """
    from scipy.optimize import brentq

    if not reached > 0:
        return float("nan")
    norm, tail = hankel_measure(demands, weights, reached)
    if not (norm <= 1 and tail <= LARGEST_TAIL):
        return float("nan")
    norms = {0.0: norm}  # by the level in dB above what is reached

    def excess(level_db: float) -> float:
        if level_db not in norms:
            size, left_out = hankel_measure(demands, weights, reached * 10 ** (level_db / 20))
            # discs shrink with the level, and the circle becomes too coarse for them: that tells nothing
            norms[level_db] = size if left_out <= LARGEST_TAIL else 1.0
        # one is no proof yet, nor is what overflowed
        known = np.nan_to_num(norms[level_db], nan=1.0, posinf=FURTHEST)
        return float(np.log(np.clip(known, 1 / FURTHEST, FURTHEST))) or -np.finfo(float).eps

    for depth in DEEPEST_DB:
        if excess(-depth) > 0:
            break
        if norms[-depth] < 1:  # told, and the discs of higher levels are larger
            return 0.0
    else:
        return 0.0
    brentq(excess, -depth, 0.0, xtol=WITHIN_DB)
    return float(reached * 10 ** (max(level for level, n in norms.items() if n > 1) / 20))


def hankel_measure(demands: Sequence[Merged], weights: FloatArray, level: float) -> tuple[float, float]:
    """Return the Hankel norm, above one when no stable Q meets all demands at this level, and the tail left out.

    Both are nan where squares of the demands leave the range of numbers.

    Raises:
        NumericalError: the norm was not found.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        discs = [(*d.disc(level), d.b, w) for d, w in zip(demands, weights, strict=True)]
        if any(radius.min() < 0 for _, radius, _, _ in discs):
            return np.inf, 0.0
        lines = [(w / radius**2, a, b) for a, radius, b, w in discs]
        P = np.maximum(sum(s * np.abs(b) ** 2 for s, _, b in lines), np.finfo(float).tiny)
        R = sum(s * b.conj() * a for s, a, b in lines) / P
        radius2 = (1 - sum(s * np.abs(a) ** 2 for s, a, _ in lines)) / P + np.abs(R) ** 2
        if np.isfinite(radius2).all() and radius2.min() <= 0:
            return np.inf, 0.0
        F = _around(-R) / outer(np.sqrt(radius2))
    return _hankel_norm(F) if np.isfinite(F).all() else (np.nan, np.nan)


def outer(size: FloatArray) -> ComplexArray:
    """Return the outer function of w^-1 round the whole circle with this modulus on equal angles from 0 to pi."""
    cepstrum = np.fft.ifft(_around(np.log(size))).real
    half = cepstrum.size // 2
    cepstrum[1:half] *= 2
    cepstrum[half + 1 :] = 0
    return np.exp(np.fft.fft(cepstrum))


def _around(half: np.ndarray) -> np.ndarray:
    return np.concatenate([half, half[-2:0:-1].conj()])


def _hankel_norm(F: ComplexArray) -> tuple[float, float]:
    """Return the norm of the Hankel matrix of the coefficients of w, w^2, ... and the size of the last ones kept."""
    sparse = import_module("scipy.sparse.linalg")
    h = (np.fft.fft(F).real / F.size)[1 : F.size // 2]
    size = float(np.abs(h).max())
    if size < LEAST_DISC:
        return size, 0.0
    tail = float(np.abs(h[-h.size // 4 :]).max()) / size
    n = h.size // 2
    length = next_fast_len(2 * n - 1, real=True)  # what wraps round misses the n products that are taken
    spectrum = np.fft.rfft(h[: 2 * n - 1], length)

    def product(x: FloatArray) -> FloatArray:
        return np.fft.irfft(spectrum * np.fft.rfft(x.ravel()[::-1], length), length)[n - 1 : 2 * n - 1]

    # a symmetric start, so that the same question has the same answer
    start = np.cos(np.arange(n) * 0.7) + 1.0 / (1 + np.arange(n))
    operator = sparse.LinearOperator((n, n), matvec=product, dtype=np.float64)
    try:
        values = sparse.eigsh(operator, k=1, which="LM", tol=1e-5, ncv=LANCZOS, v0=start, return_eigenvectors=False)
    except sparse.ArpackError as error:
        raise NumericalError(
            f"limits: the norm that proves a bound was not found ({error}); take another band or basis."
        ) from error
    return float(abs(values[0])), tail
