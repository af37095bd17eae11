"""What noise makes of modes that are alike: their poles repel each other, and the largest growth is beyond its own."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from math import comb, gamma
from typing import Any

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from scipy.optimize import brentq
from scipy.special import ndtr

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.free_response import CERTAIN, Mode

MANY = 100  # of so many or more the sums below lose their digits, and a bound does
FAR = 20.0  # beyond a level nothing is left to count
ABOVE_DRIFT = 10.0  # times the noise: below it what is heard at 0 Hz may be what wanders in all readings


def widened(modes: Sequence[Mode], rates: ComplexArray, channels: int, real: bool) -> list[Mode]:
    """Return modes of one band with the deviations of those that are alike made as rarely exceeded as one alone.

    Args:
        modes: of one matrix Z of steps, with the deviation that each would have by itself.
        rates: the logarithms of their poles, 1/s, `(modes,)`.
        channels: among whose directions those of the modes were the loudest.
        real: whether Z is, as it is at 0 Hz.

    n modes of one pole make Z = z I + E, E what noise leaves. Its eigenvalues are no mean of independent errors: the
    largest real part is at most that of (E + E*) / 2, whose entries have the deviation of one mode by itself. At 0 Hz
    every reading may wander, with a pole at one each: of a mode not far above the noise the direction is what became
    loudest by chance, so that all channels count.
    """
    deviations = np.array([mode.growth_std for mode in modes])
    apart = np.abs(rates[:, None] - rates[None, :])
    alike = np.sum(apart <= CERTAIN * np.hypot(deviations[:, None], deviations[None, :]), axis=1)
    faint = np.array([real and mode.seen < ABOVE_DRIFT for mode in modes])
    alike = np.maximum(alike, np.where(faint, channels, 1))
    shares = [farthest_of(int(count), real) / CERTAIN for count in alike]
    return [replace(mode, growth_std=share * mode.growth_std) for mode, share in zip(modes, shares, strict=True)]


@lru_cache
def farthest_of(count: int, real: bool) -> float:
    """Return what the largest eigenvalue of random symmetric matrices passes as rarely as a Gaussian `CERTAIN`.

    Args:
        count: order of the matrices, whose diagonal has unit variance and the rest half of it.
        real: whether the matrices are real or complex Hermitian.

    The mean is below the edge of the spectrum, and by so many deviations more nothing is passed more often (Borell's
    inequality, Adler and Taylor 2007, section 2.1).
    """
    if count == 1:
        return CERTAIN
    edge = float(np.sqrt((2 if real else 4) * count))
    if count >= MANY:
        return edge + CERTAIN
    passed = _real_passed if real else _complex_passed
    rare = float(ndtr(-CERTAIN))
    level: Any = brentq(lambda level: np.log(passed(count, level) / rare), edge, edge + CERTAIN)
    return float(level)


def _real_passed(count: int, level: float) -> float:
    """Return how often u'Eu passes a high level for some u: the mean Euler characteristic of where it does.

    Over directions u it is a Gaussian field of unit variance whose correlation (u'v)^2 falls as 1 - angle^2, so that
    the projective space counts with its lengths times the root of two. Adler and Taylor 2007,
    doi:10.1007/978-0-387-48116-6, section 12.4 with the curvatures of spheres in 6.3.
    """
    n, total = count, 0.0
    for j in range(n - 1, -1, -2):
        curvature = comb(n - 1, j) * _sphere(n) / _sphere(n - j) * np.sqrt(2.0) ** j
        total += curvature * _density(j, level)
    return total


def _sphere(n: int) -> float:
    """Return the area of the unit sphere in n dimensions."""
    return 2 * np.pi ** (n / 2) / gamma(n / 2)


def _density(j: int, level: float) -> float:
    if j == 0:
        return float(ndtr(-level))
    polynomial = float(hermeval(level, [0.0] * (j - 1) + [1.0]))
    return (2 * np.pi) ** (-(j + 1) / 2) * polynomial * np.exp(-(level**2) / 2)


def _complex_passed(count: int, level: float) -> float:
    """Return the mean number of eigenvalues above a level: the sum of squares of Hermite functions beyond it.

    Mehta 2004, Random Matrices, 3rd ed., section 6.2, in units of a diagonal of unit variance.
    """
    x = np.linspace(level, level + FAR, 20001) / np.sqrt(2.0)
    before, last = np.zeros_like(x), np.pi**-0.25 * np.exp(-(x**2) / 2)
    total: FloatArray = last**2
    for k in range(1, count):
        before, last = last, np.sqrt(2 / k) * x * last - np.sqrt((k - 1) / k) * before
        total = total + last**2
    return float(np.trapezoid(total, x))
