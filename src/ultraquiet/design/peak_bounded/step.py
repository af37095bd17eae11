"""One step of a search: the bounded changes that lower the greatest of many linearised levels, by a small programme."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.design.peak_bounded.programme import shortest

DB = 20 / np.log(10)
LEAST = 1e-300
# LoopLevels of each kind that a step begins with, that a round adds at most, rounds, and what counts as broken.
BEGUN, ADDED, ROUNDS, BROKEN_DB = 16, 16, 40, 2e-3
BELOW = 1e-6  # a parameter counts as beneath its least, in units of its size


class Linearised(NamedTuple):
    """What a law does near its parameters, to first order.

    Attributes:
        values, slopes: `(m,)`, `(m, n)` levels in dB.
        sought: `(m,)` whether a level is one to be lowered; the others are excesses, to be below zero.
        gains, turns: `(k,)`, `(k, n)` complex gains over their bounds, to be at most one in size. A gain that is a
            small difference of large parts is linear in them while its logarithm is anything but.
        least: `(n,)` least changes of the parameters, minus infinity where there is none.
    """

    values: FloatArray
    slopes: FloatArray
    sought: np.ndarray
    gains: FloatArray | ComplexArray
    turns: ComplexArray
    least: FloatArray | None = None

    def scaled(self, sizes: FloatArray) -> "Linearised":
        """Return the same with parameters in other units."""
        least = None if self.least is None else self.least / sizes
        return self._replace(slopes=self.slopes * sizes, turns=self.turns * sizes, least=least)

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


class Held:
    """Which levels a step is asked to keep; steps of one model hand it on, for what held one holds the next.

    A gain |z| <= 1 + t is kept by tangents of the circle, Re(z exp(-j angle)) <= 1 + t, at the angles at which it was
    broken: a programme of straight bounds alone takes a sixth of the time. Of the parameters' least changes those are
    kept that a step has broken.
    """

    def __init__(self, model: Linearised) -> None:
        self.rows = np.zeros(model.values.size, dtype=bool)
        for kind in (model.sought, ~model.sought):
            at = np.flatnonzero(kind)
            self.rows[at[np.argsort(-model.values[at], kind="stable")[:BEGUN]]] = True
        self.ends = np.zeros(model.slopes.shape[1], dtype=bool)
        self.gains, self.turned = np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.complex128)
        most = np.argsort(-np.abs(model.gains), kind="stable")[:BEGUN]
        self.touch(most, model.gains[most].astype(np.complex128))

    def touch(self, which: np.ndarray, z: ComplexArray) -> None:
        """Take the tangents of some gains at the angles of z."""
        self.gains = np.concatenate([self.gains, which])
        self.turned = np.concatenate([self.turned, np.exp(-1j * np.angle(z))])


def step(model: Linearised, price: float, damping: float, held: Held | None = None) -> tuple[FloatArray, float]:
    """Return argmin over d of a + price t + damping |d|^2 / 2 and the merit that the model promises there.

    Subject to values + slopes d <= a where sought, <= t elsewhere, |gains + turns d| <= 1 + t in nepers, t >= 0: an
    exact penalty (Fletcher 1987, "Practical Methods of Optimization", sections 12.4 and 14.3). Of thousands of levels a
    few dozen hold the step: it is solved with the highest, and again with those that it breaks.
    """
    held = Held(model) if held is None else held
    d = np.zeros(model.slopes.shape[1])
    for _ in range(ROUNDS):
        d, a, t = _solved(model, held, price, damping)
        over = model.values + model.slopes @ d - np.where(model.sought, a, t)
        z = model.gains + model.turns @ d
        more = _worst(np.where(held.rows, -np.inf, over))
        wide = _worst(DB * (np.abs(z) - 1) - t)
        beneath = np.zeros(0, dtype=np.intp) if model.least is None else np.flatnonzero(d < model.least - BELOW)
        if not more.size and not wide.size and not beneath.size:
            break
        held.rows[more] = held.ends[beneath] = True
        held.touch(wide, z[wide])
    return d, merit(*promised(model, d), price)


def _worst(over: FloatArray) -> np.ndarray:
    """Return the levels that a solution breaks most."""
    at = np.flatnonzero(over > BROKEN_DB)
    return at[np.argsort(-over[at], kind="stable")[:ADDED]]


def _solved(model: Linearised, held: Held, price: float, damping: float) -> tuple[FloatArray, float, float]:
    """Return d, a and t for the levels that are held."""
    rows, turned, which = held.rows, held.turned, held.gains
    slopes = model.slopes[rows]
    (m, n), k = slopes.shape, which.size
    sought, root = model.sought[rows].astype(float), np.sqrt(damping)
    A = np.zeros((m + 1 + k, n + 2))
    b = np.zeros(len(A))
    A[:m, :n], A[:m, n], A[:m, n + 1], b[:m] = slopes / root, -sought, sought - 1, -model.values[rows]
    A[m, n + 1] = -1.0
    A[m + 1 :, :n] = DB / root * (turned[:, None] * model.turns[which]).real
    A[m + 1 :, n + 1], b[m + 1 :] = -1.0, DB * (1 - (turned * model.gains[which]).real)
    if model.least is not None and held.ends.any():
        ends = np.flatnonzero(held.ends)
        A = np.vstack([A, -np.eye(n + 2)[ends]])
        b = np.concatenate([b, -root * model.least[ends]])
    x = shortest(A, b, np.array([1.0, price]))
    return (x[:n] / root, float(x[n]), float(x[n + 1])) if np.all(np.isfinite(x)) else (np.zeros(n), 0.0, 0.0)


def promised(model: Linearised, d: FloatArray) -> tuple[float, float]:
    """Return the level and the excess that the model foretells."""
    levels, wanted = model.values + model.slopes @ d, model.sought.astype(bool)
    gains = DB * np.log(np.maximum(np.abs(model.gains + model.turns @ d), LEAST))
    level = float(levels[wanted].max()) if wanted.any() else 0.0
    return level, max(float(levels[~wanted].max(initial=-np.inf)), float(gains.max(initial=-np.inf)))
