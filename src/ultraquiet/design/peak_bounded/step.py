"""One step of a search: the bounded changes that lower the greatest of many linearised levels, by a small programme."""

from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

DB = 20 / np.log(10)
LEAST = 1e-300
# LoopLevels of each kind that a step begins with, that a round adds at most, rounds, and what counts as broken.
BEGUN, ADDED, ROUNDS, BROKEN_DB = 40, 40, 12, 2e-3


class Linearised(NamedTuple):
    """What a law does near its parameters, to first order.

    Attributes:
        values, slopes: `(m,)`, `(m, n)` levels in dB.
        sought: `(m,)` whether a level is one to be lowered; the others are excesses, to be below zero.
        gains, turns: `(k,)`, `(k, n)` complex gains over their bounds, to be at most one in size. A gain that is a
            small difference of large parts is linear in them while its logarithm is anything but.
    """

    values: FloatArray
    slopes: FloatArray
    sought: np.ndarray
    gains: FloatArray | ComplexArray
    turns: ComplexArray

    def scaled(self, sizes: FloatArray) -> "Linearised":
        """Return the same with parameters in other units."""
        return self._replace(slopes=self.slopes * sizes, turns=self.turns * sizes)

    def corrected(self, d: FloatArray, values: FloatArray, gains: FloatArray) -> "Linearised":
        """Return the model bent such that it is right at d, where levels and gains turned out as given.

        The second-order correction of a step along curved bounds (Fletcher 1987, section 14.4).
        """
        foretold = self.gains + self.turns @ d
        size = np.maximum(np.abs(foretold), LEAST)
        shift = foretold / size * (gains - size)
        return self._replace(values=values - self.slopes @ d, gains=self.gains + shift)


def merit(level: float, excess: float, price: float) -> float:
    """Return what a search lowers: the level sought, plus a price for each dB by which a bound is exceeded."""
    return level + price * max(excess, 0.0)


def step(model: Linearised, price: float, damping: float) -> tuple[FloatArray, float]:
    """Return argmin over d of a + price t + damping |d|^2 / 2 and the merit that the model promises there.

    Subject to values + slopes d <= a where sought, <= t elsewhere, |gains + turns d| <= 1 + t in nepers, t >= 0: an
    exact penalty (Fletcher 1987, "Practical Methods of Optimization", sections 12.4 and 14.3). Of thousands of levels a
    few dozen hold the step: it is solved with the highest, and again with those that it breaks.
    """
    rows = np.zeros(model.values.size, dtype=bool)
    for kind in (model.sought, ~model.sought):
        at = np.flatnonzero(kind)
        rows[at[np.argsort(-model.values[at], kind="stable")[:BEGUN]]] = True
    cones = np.zeros(model.gains.size, dtype=bool)
    cones[np.argsort(-np.abs(model.gains), kind="stable")[:BEGUN]] = True
    d = np.zeros(model.slopes.shape[1])
    for _ in range(ROUNDS):
        d, a, t = _solved(model, rows, cones, price, damping)
        over = model.values + model.slopes @ d - np.where(model.sought, a, t)
        wide = DB * np.log(np.maximum(np.abs(model.gains + model.turns @ d), LEAST)) - t
        more = _worst(over, rows), _worst(wide, cones)
        if not more[0].size and not more[1].size:
            break
        rows[more[0]], cones[more[1]] = True, True
    return d, merit(*promised(model, d), price)


def _worst(over: FloatArray, known: np.ndarray) -> np.ndarray:
    """Return the levels that a solution breaks most and that it was not asked to keep."""
    at = np.flatnonzero((over > BROKEN_DB) & ~known)
    return at[np.argsort(-over[at], kind="stable")[:ADDED]]


def _solved(
    model: Linearised, rows: np.ndarray, cones: np.ndarray, price: float, damping: float
) -> tuple[FloatArray, float, float]:
    """Return d, a and t for some of the levels."""
    # it ships no types; as a plain module it is what it says
    clarabel: Any = import_module("clarabel")
    from scipy import sparse

    slopes, turns, gains = model.slopes[rows], model.turns[cones], model.gains[cones]
    (m, n), k = slopes.shape, gains.size
    sought, root = model.sought[rows].astype(float), np.sqrt(damping)
    A = np.zeros((m + 1 + 3 * k, n + 2))
    b = np.zeros(len(A))
    A[:m, :n], A[:m, n], A[:m, n + 1], b[:m] = slopes / root, -sought, sought - 1, -model.values[rows]
    A[m, n + 1] = -1.0
    A[m + 1 :: 3, n + 1], b[m + 1 :: 3] = -1 / DB, 1.0
    A[m + 2 :: 3, :n], b[m + 2 :: 3] = -turns.real / root, gains.real
    A[m + 3 :: 3, :n], b[m + 3 :: 3] = -turns.imag / root, gains.imag
    P = sparse.diags(np.append(np.ones(n), [0.0, 0.0]), format="csc")
    linear = np.append(np.zeros(n), [1.0, price])
    kinds = [clarabel.NonnegativeConeT(m + 1), *[clarabel.SecondOrderConeT(3)] * k]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    x = np.array(clarabel.DefaultSolver(P, linear, sparse.csc_matrix(A), b, kinds, settings).solve().x)
    return (x[:n] / root, float(x[n]), float(x[n + 1])) if np.all(np.isfinite(x)) else (np.zeros(n), 0.0, 0.0)


def promised(model: Linearised, d: FloatArray) -> tuple[float, float]:
    """Return the level and the excess that the model foretells."""
    levels, wanted = model.values + model.slopes @ d, model.sought.astype(bool)
    gains = DB * np.log(np.maximum(np.abs(model.gains + model.turns @ d), LEAST))
    level = float(levels[wanted].max()) if wanted.any() else 0.0
    return level, max(float(levels[~wanted].max(initial=-np.inf)), float(gains.max(initial=-np.inf)))
