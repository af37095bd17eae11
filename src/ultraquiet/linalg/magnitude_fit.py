"""A stable minimum-phase rational function whose gain lies near given numbers, or above them by as little as can be."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Zeros and poles keep this relative damping at least: a weight that rings is a weight nobody can design with.
LEAST_DAMPING, MOST_DAMPING = 0.01, 5.0
REACH = 30.0  # corners lie within the lines, or so far beyond them
# An error below the bound weighs this much more than one above it, until the last shift lifts the whole above.
BELOW = 4.0
EVALUATIONS = 60


class Factors(NamedTuple):
    """Gain prod(s - zeros) / prod(s - poles), equally many of both, all in the left half-plane."""

    gain: float
    zeros: ComplexArray
    poles: ComplexArray


def fit_above(w: FloatArray, bound: FloatArray, order: int) -> Factors:
    """Return W of an order with |W(j w)| >= bound at every line and halfway between (in logarithms).

    Least squares of ln |W| - ln bound over corner frequencies and dampings of second-order factors, all as logarithms,
    so that stability and minimum phase need no constraint; then the gain is raised to the largest shortfall.

    Args:
        w: `(nf,)` rising angular frequencies, any unit, zero allowed.
        bound: `(nf,)` positive.
        order: of W.

    >>> W = fit_above(np.array([1.0, 2.0, 4.0]), np.array([2.0, 2.0, 2.0]), 0)
    >>> round(W.gain, 6), W.poles.size
    (2.0, 0)
    """
    from scipy.optimize import least_squares

    x, wanted = _between(w, np.log(bound))
    positive = x[x > 0]
    unit = float(np.exp(np.mean(np.log(positive[[0, -1]])))) if positive.size else 1.0
    x = x / unit
    if order == 0:
        return Factors(float(np.exp(wanted.max())), np.zeros(0, complex), np.zeros(0, complex))
    low, high = _limits(x, order)
    best, least = np.zeros(0), np.inf
    for start in _starts(x, wanted, order):
        kept = np.clip(start, low + 1e-6, high - 1e-6)
        minimum = least_squares(
            lambda p: _miss(p, x, wanted, order),
            kept,
            jac=lambda p: _miss_slopes(p, x, wanted, order),  # pyright: ignore[reportArgumentType]
            bounds=(low, high),
            max_nfev=EVALUATIONS,
        )
        over = _log_gain(minimum.x, x, order) - wanted
        excess = float(np.mean(over - over.min()))
        if excess < least:
            best, least = minimum.x, excess
    over = _log_gain(best, x, order) - wanted
    zeros, poles = _roots(best[1::2], order), _roots(best[2::2], order)
    return Factors(float(np.exp(best[0] - over.min())), zeros * unit, poles * unit)


def fit_near(w: FloatArray, level: FloatArray, order: int, weight: FloatArray) -> Factors:
    """Return W of an order with |W(j w)| near a level, by weighted least squares of the logarithms of its factors.

    Args:
        w: `(nf,)` rising angular frequencies, any unit, zero allowed.
        level: `(nf,)` positive.
        order: of W.
        weight: `(nf,)` what an error at each line counts.

    >>> W = fit_near(np.array([1.0, 2.0, 4.0]), np.array([1.0, 2.0, 4.0]), 0, np.ones(3))
    >>> round(W.gain, 6)
    2.0
    """
    from scipy.optimize import least_squares

    wanted = np.log(level)
    if order == 0:
        mean = float(np.average(wanted, weights=weight**2))
        return Factors(float(np.exp(mean)), np.zeros(0, complex), np.zeros(0, complex))
    unit = float(np.exp(np.mean(np.log(w[w > 0][[0, -1]]))))
    x = w / unit
    low, high = _limits(x, order)
    minima = [
        least_squares(
            lambda p: weight * (_log_gain(p, x, order) - wanted),
            np.clip(start, low + 1e-6, high - 1e-6),
            jac=lambda p: weight[:, None] * _slopes(p, x, order),  # pyright: ignore[reportArgumentType]
            bounds=(low, high),
            max_nfev=EVALUATIONS,
        )
        for start in _starts(x, wanted, order)
    ]
    best = min(minima, key=lambda f: f.cost).x
    return Factors(float(np.exp(best[0])), _roots(best[1::2], order) * unit, _roots(best[2::2], order) * unit)


def _between(w: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lines and levels with the geometric midpoints added, the level there being the larger neighbour's."""
    middle = np.where(w[:-1] > 0, np.sqrt(w[:-1] * w[1:]), 0.5 * w[1:])
    x = np.concatenate([w, middle])
    y = np.concatenate([level, np.maximum(level[:-1], level[1:])])
    order = np.argsort(x)
    return x[order], y[order]


# Parameters: ln gain, then (zero, pole) of every corner and every damping: ln w_z, ln w_p, ln zeta_z, ln zeta_p a pair,
# ln z, ln p for a single one at the end.


def _log_gain(p: FloatArray, x: FloatArray, order: int) -> FloatArray:
    return p[0] + _log_product(p[1::2], x, order) - _log_product(p[2::2], x, order)


def _log_product(q: FloatArray, x: FloatArray, order: int) -> FloatArray:
    out = np.zeros(x.size)
    for k in range(order // 2):
        corner, zeta = np.exp(q[2 * k]), np.exp(q[2 * k + 1])
        out += 0.5 * np.log((corner**2 - x**2) ** 2 + (2 * zeta * corner * x) ** 2)
    if order % 2:
        out += 0.5 * np.log(np.exp(2 * q[-1]) + x**2)
    return out


def _slopes(p: FloatArray, x: FloatArray, order: int) -> FloatArray:
    """Return the derivatives `(nf, parameters)` of the logarithm of the gain."""
    out = np.ones((x.size, p.size))
    out[:, 1::2], out[:, 2::2] = _product_slopes(p[1::2], x, order), -_product_slopes(p[2::2], x, order)
    return out


def _product_slopes(q: FloatArray, x: FloatArray, order: int) -> FloatArray:
    out = np.empty((x.size, q.size))
    for k in range(order // 2):
        corner, zeta = np.exp(q[2 * k]), np.exp(q[2 * k + 1])
        real, imaginary = corner**2 - x**2, (2 * zeta * corner * x) ** 2
        size = real**2 + imaginary
        out[:, 2 * k] = (2 * corner**2 * real + imaginary) / size
        out[:, 2 * k + 1] = imaginary / size
    if order % 2:
        out[:, -1] = np.exp(2 * q[-1]) / (np.exp(2 * q[-1]) + x**2)
    return out


def _miss(p: FloatArray, x: FloatArray, wanted: FloatArray, order: int) -> FloatArray:
    over = _log_gain(p, x, order) - wanted
    return np.where(over < 0, BELOW * over, over)


def _miss_slopes(p: FloatArray, x: FloatArray, wanted: FloatArray, order: int) -> FloatArray:
    return np.where(_miss(p, x, wanted, order) < 0, BELOW, 1.0)[:, None] * _slopes(p, x, order)


def _limits(x: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    corners = np.log([x[x > 0][0] / REACH, x[-1] * REACH])
    dampings = np.log([LEAST_DAMPING, MOST_DAMPING])
    low, high = [-np.inf], [np.inf]
    for _ in range(order // 2):
        low += [corners[0]] * 2 + [dampings[0]] * 2
        high += [corners[1]] * 2 + [dampings[1]] * 2
    return np.array(low + [corners[0]] * (2 * (order % 2))), np.array(high + [corners[1]] * (2 * (order % 2)))


def _starts(x: FloatArray, wanted: FloatArray, order: int) -> list[FloatArray]:
    """Return two starts whose factors cancel: corners spread over the lines, and on the highest peaks."""
    lines = x[x > 0]
    pairs = order // 2
    spread = np.log(np.geomspace(lines[0], lines[-1], pairs + 2)[1:-1])
    inner = np.flatnonzero((wanted[1:-1] >= wanted[:-2]) & (wanted[1:-1] > wanted[2:])) + 1
    inner = inner[np.argsort(-wanted[inner], kind="stable")][:pairs]
    peaks = spread.copy()
    peaks[: inner.size] = np.log(np.maximum(x[inner], lines[0]))
    out = []
    for corners, zeta in ((spread, 0.7), (peaks, 0.2)):
        p = [float(np.mean(wanted))]
        for corner in corners:
            p += [corner - 0.05, corner + 0.05, np.log(zeta), np.log(zeta)]
        middle = float(np.mean(np.log(lines[[0, -1]])))
        out.append(np.array(p + [middle - 0.05, middle + 0.05] * (order % 2)))
    return out


def _roots(q: FloatArray, order: int) -> ComplexArray:
    out: list[complex] = []
    for k in range(order // 2):
        corner, zeta = np.exp(q[2 * k]), np.exp(q[2 * k + 1])
        turn = np.sqrt(complex(zeta**2 - 1))
        out += [corner * (-zeta + turn), corner * (-zeta - turn)]
    if order % 2:
        out.append(-np.exp(q[-1]))
    return np.array(out, dtype=np.complex128)
