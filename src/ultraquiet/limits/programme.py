"""The convex programme: the smallest level of |S| in the band over all Q of a basis, by cones on a growing grid."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

FIRST_POINTS = 150  # of the first grid
TIGHTENED = 0.998
VIOLATED = 1.0005  # beyond this share of the tightened demand a point joins the grid
GROSSLY, THINNED = 1.01, 4  # beyond this share every fourth point does, peak or not
ROUNDS = 10
SLACK = 0.9  # of its limit: a demand that stays below is left out until it is broken
RISEN = 1e-4  # of a level: what it has to rise by for slack points to be left out
SOLVED = ("Solved", "AlmostSolved")
# The solver's words for how it ended, in ours.
FOUND = {
    "Solved": "the optimum",
    "AlmostSolved": "nearly the optimum",
    "MaxIterations": "the search gave up at its most iterations",
    "MaxTime": "the search gave up at its longest time",
    "NumericalError": "the search gave up on numbers too far apart",
    "InsufficientProgress": "the search gave up, for it came no nearer",
}


@dataclass(frozen=True, eq=False)
class Demand:
    """|a + b Q| <= limit at some frequencies; a limit of infinity asks nothing there.

    It is put `tight` times tighter than meant, so that it holds between the points of a grid too. `sought` marks the
    demand whose limit is the unknown level t: there `limit` is a factor of t. With an `error` e the line is S, and the
    limit that of every plant off by e at most: |S| + e limit |1 - S| <= limit, see `largest_sensitivity`; where the
    limit is sought, the second one is a guess of it.
    """

    name: str
    a: ComplexArray
    b: ComplexArray
    limit: FloatArray
    sought: bool = False
    tight: float | FloatArray = TIGHTENED
    error: FloatArray | None = None
    guess: float | None = None

    @property
    def cones(self) -> int:
        """How many cones a point takes."""
        return 1 if self.error is None else 2

    def reached(self, q: ComplexArray, level: float) -> FloatArray:
        """Return |a + b q|, of the worst plant, over its limit; zero where nothing is asked, whatever it is there."""
        return self._over_limit(largest_sensitivity(self.a + self.b * q, self.error), level)

    def used(self, q: ComplexArray, level: float) -> FloatArray:
        """Return the share of the limit that the programme sees, by the guess of a level where there is one.

        It is one where the demand binds; `reached`, which is true at the level itself, may be far less there.
        """
        if self.guess is None or self.error is None:
            return self.reached(q, level)
        S = self.a + self.b * q
        return self._over_limit(np.abs(S) + self.error * self.guess * np.abs(1 - S), level)

    def _over_limit(self, size: FloatArray, level: float) -> FloatArray:
        limit = np.broadcast_to(self.limit * (level if self.sought else 1.0), size.shape)
        return np.divide(size, limit, out=np.zeros(size.shape), where=np.isfinite(limit))


def largest_sensitivity(S: ComplexArray, error: FloatArray | None) -> FloatArray:
    """Return |S| of the worst of all plants (1 + E) G with |E| <= error; infinite where one of them may be unstable.

    S of such a plant is S / (1 + E T) with T = 1 - S (up to the sign of K), so that the largest is
    |S| / (1 - error |1 - S|): robust performance of a scalar loop (Doyle, Francis and Tannenbaum 1992, "Feedback
    Control Theory", section 4.3).

    >>> largest_sensitivity(np.array([0.1, 1.0, -1.0]), np.array([0.1, 0.1, 0.5])).round(4).tolist()
    [0.1099, 1.0, inf]
    """
    if error is None:
        return np.abs(S)
    left = np.broadcast_to(1 - error * np.abs(1 - S), S.shape)
    return np.divide(np.abs(S), left, out=np.full(S.shape, np.inf), where=left > 0)


@dataclass(frozen=True, eq=False)
class ConeSolution:
    """A solution: weights of the basis, the level t, one multiplier for each demand and point (zero where not put)."""

    weights: FloatArray
    level: float
    multipliers: Sequence[FloatArray]
    active: Sequence[np.ndarray]
    status: str
    rounds: int

    @property
    def ok(self) -> bool:
        """Whether the solver found an optimum."""
        return self.status in SOLVED

    @property
    def found(self) -> str:
        """What the solver found, in words."""
        return FOUND.get(self.status, f"the search gave up ({self.status})")


def solve(
    functions: ComplexArray,
    demands: Sequence[Demand],
    noise: FloatArray | None = None,
    start: ConeSolution | None = None,
) -> ConeSolution:
    """Solve on a first grid, add the points at which a demand is broken, and again until none is.

    A point at which no demand comes near its limit is left out of the next round, until it is broken; whoever
    interpolates multipliers sees its zero, for `active` of the solution holds all points that were ever put. None is
    left out where the level no longer rises: many laws reach it then, and what keeps one of them may not keep another.

    Args:
        functions: `(size, nf)` the basis at all candidate frequencies.
        demands: on the same frequencies.
        noise: `(rows, size + 1)` matrix whose product with the weights and a last one must not exceed one in norm.
        start: a solution of the same demands, brought to these frequencies; the first grid is where it binds or breaks
            a demand.
    """
    put = _first(demands, functions.shape[1]) if start is None else start.active
    active = put if start is None else _next(put, functions, demands, start, start.level > 0)[0]
    rounds, level = 0, 0.0
    while True:
        rounds += 1
        put = [p | a for p, a in zip(put, active, strict=True)]
        solution = solve_on(functions, demands, active, noise, rounds)
        if not solution.ok and rounds > 1:  # the thinned programme may be harder than the whole
            solution = solve_on(functions, demands, put, noise, rounds)
        rises, level = solution.level > (1 + RISEN) * level, max(solution.level, 0.0)
        active, broken = _next(active, functions, demands, solution, rises) if solution.ok else (active, False)
        if not broken or rounds == ROUNDS:
            return replace(solution, active=put)


def _first(demands: Sequence[Demand], nf: int) -> list[np.ndarray]:
    """Return a coarse grid that holds both sides of every edge of a demand."""
    first = np.zeros(nf, dtype=bool)
    first[:: max(1, nf // FIRST_POINTS)] = True
    for demand in demands:
        edges = np.flatnonzero(np.diff(np.isfinite(demand.limit).astype(int)))
        first[edges] = first[edges + 1] = True
    return [first & np.isfinite(d.limit) for d in demands]


def _next(
    active: Sequence[np.ndarray],
    functions: ComplexArray,
    demands: Sequence[Demand],
    solution: ConeSolution,
    thin: bool,
) -> tuple[list[np.ndarray], bool]:
    """Return the points to put after a solution, without slack ones to `thin`, and whether it breaks a demand."""
    q, chosen, any_broken = solution.weights @ functions, [], False
    for demand, on in zip(demands, active, strict=True):
        r = demand.used(q, solution.level) / (1.0 if demand.sought else demand.tight)
        new = _broken(r) & ~on
        any_broken |= bool(new.any())
        chosen.append(new | (on & (r > SLACK) if thin else on))
    return chosen, any_broken


def solve_on(
    functions: ComplexArray,
    demands: Sequence[Demand],
    active: Sequence[np.ndarray],
    noise: FloatArray | None = None,
    rounds: int = 1,
) -> ConeSolution:
    """Solve with each demand put at its active points only."""
    clarabel = import_module("clarabel")  # it ships no types; as a plain module it is what it says
    sparse = import_module("scipy.sparse")
    size = functions.shape[0]
    put = [(d, np.flatnonzero(a)) for d, a in zip(demands, active, strict=True)]
    blocks = [_cones(functions, d, at) for d, at in put]
    cones = [clarabel.SecondOrderConeT(3)] * sum(len(b[1]) // 3 for b in blocks)
    if noise is not None:
        rows = np.vstack([np.zeros(size + 1), np.pad(-noise[:, :-1], ((0, 0), (0, 1)))])
        blocks.append((rows, np.concatenate([[TIGHTENED], noise[:, -1]])))
        cones.append(clarabel.SecondOrderConeT(len(noise) + 1))
    A, b = (np.concatenate([block[k] for block in blocks]) for k in (0, 1))
    A = sparse.csc_matrix(sparse.hstack([A, _divided(put, len(b))]))
    cost = np.zeros(A.shape[1])
    cost[size] = 1.0
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    none = sparse.csc_matrix((cost.size, cost.size))
    solution = clarabel.DefaultSolver(none, cost, A, b, cones, settings).solve()
    x, z, at, multipliers = np.array(solution.x)[: size + 1], np.array(solution.z), 0, []
    for demand, on in zip(demands, active, strict=True):
        multiplier = np.zeros(on.size)
        count = int(on.sum())
        multiplier[on] = z[at : at + 3 * count : 3] * (x[-1] if demand.sought else 1.0)
        multipliers.append(multiplier)
        at += 3 * count * demand.cones
    return ConeSolution(x[:-1], float(x[-1]), multipliers, active, str(solution.status), rounds)


def _cones(functions: ComplexArray, demand: Demand, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Return rows and right sides of (limit, Re, Im) at each point, scaled such that the limit is one (or t).

    With an error two cones share the limit, |S| over it the first and e |1 - S| the second; see `_divided`.
    """
    scale = 1 / demand.limit[at]
    tight = np.broadcast_to(demand.tight, demand.limit.shape)[at]
    line, offset = (functions[:, at] * (demand.b[at] * scale)).T, demand.a[at] * scale
    if demand.error is None:
        return _cone(line, offset, None if demand.sought else tight)
    share = np.full(at.size, demand.guess) if demand.sought else tight
    by_error = share * demand.error[at] / scale
    first = _cone(line, offset, 0 * tight)
    second = (line * by_error[:, None], (demand.a[at] - 1) * by_error * scale)
    second = _cone(*second, None if demand.sought else tight)
    return np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1]])


def _cone(line: ComplexArray, offset: ComplexArray, limit: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return rows and right sides of |offset + line x| <= limit, or <= t, the last unknown."""
    points, size = line.shape
    A, b = np.zeros((points, 3, size + 1)), np.zeros((points, 3))
    if limit is None:
        A[:, 0, size] = -1.0
    else:
        b[:, 0] = limit
    A[:, 1, :size], A[:, 2, :size] = -line.real, -line.imag
    b[:, 1], b[:, 2] = offset.real, offset.imag
    return A.reshape(-1, size + 1), b.ravel()


def _divided(put: Sequence[tuple[Demand, np.ndarray]], rows: int) -> Any:
    """Return the columns `(rows, shares)` of the share of its limit that each first cone of a pair takes."""
    sparse = import_module("scipy.sparse")
    first, second, row = [np.zeros(0, int)], [np.zeros(0, int)], 0
    for demand, at in put:
        if demand.error is not None:
            heads = row + 3 * np.arange(at.size)
            first.append(heads)
            second.append(heads + 3 * at.size)
        row += 3 * at.size * demand.cones
    heads, others = np.concatenate(first), np.concatenate(second)
    shares, ones = np.arange(heads.size), np.ones(heads.size)
    values = np.concatenate([-ones, ones]), (np.concatenate([heads, others]), np.concatenate([shares, shares]))
    return sparse.csc_matrix(values, shape=(rows, heads.size))


def _broken(r: FloatArray) -> np.ndarray:
    """Return the points at which a demand is most broken, and some where it is so grossly; r is its share used."""
    peak = np.ones(r.size, dtype=bool)
    peak[1:-1] = (r[1:-1] >= r[:-2]) & (r[1:-1] >= r[2:])
    return (r > VIOLATED) & (peak | ((r > GROSSLY) & (np.arange(r.size) % THINNED == 0)))
