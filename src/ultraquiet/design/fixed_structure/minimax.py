"""Minimising a maximum of peaks: BFGS with a weak Wolfe search, then steps on all peaks at once."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.design.fixed_structure.problem import TuningProblem, abscissa

# weak Wolfe: sufficient decrease, sufficient increase of the slope (Lewis and Overton 2013)
DECREASE, CURVATURE = 1e-4, 0.5
BISECTIONS = 30
FARTHEST = 1e6  # size of parameters beyond which a search has run away
STAGNANT = 1e-5  # relative decrease over PATIENCE steps below which BFGS hands over
SLOW = 1e-4  # the same for steps on all peaks
PATIENCE = 8
ACTIVE = 0.15  # peaks within this share of the greatest enter the model
MOST = 50
ACCEPTED = 0.05  # of the promised decrease
FIRST = 1e-2
SMALLEST, LARGEST = 1e-10, 1e8  # of the damping
ENOUGH = 1e-6  # relative decrease of a model step below which a point counts as stationary
RELAXED = 1.3  # the balance moves on by more than the level asks: one without the other barely moves
MISSED = 400.0  # weight of a missed hard requirement where laws are compared; missing by its inverse is forgiven
BRIEF = 3  # share of the steps after which starts are compared that are polished otherwise
CONTINUED = 3  # of the ends: the best one after a few steps need not be the best after many
LOOKS, HIDES = 4, 1e-3  # between the points of the grid after each start, until no peak is higher there by this share
LEVEL = 3e-3  # of the greatest requirement around one, where the balance of hard and soft is found

Value = Callable[[FloatArray, float], float]


def bfgs(
    value: Value,
    gradient: Callable[[FloatArray], FloatArray],
    x: FloatArray,
    steps: int,
    patience: int = PATIENCE,
    stagnant: float = STAGNANT,
) -> tuple[FloatArray, float]:
    """Minimise a function smooth almost everywhere.

    Lewis and Overton 2013, doi:10.1007/s10107-012-0514-2: with a search that bisects for the weak Wolfe conditions,
    BFGS converges on non-smooth functions too, its matrix learning the kink.
    """
    f, g = value(x, np.inf), gradient(x)
    H = np.eye(x.size) / max(float(np.linalg.norm(g)), 1e-12) * max(0.1 * float(np.linalg.norm(x)), 0.1)
    history = [f]
    for step in range(steps):
        d = -H @ g
        slope = float(g @ d)
        if slope >= 0:
            break
        accepted = _wolfe(value, gradient, x, f, d, slope)
        if accepted is None:
            break
        t, x, f, new = accepted
        s, y = t * d, new - g
        g, sy = new, float(s @ y)
        if sy > 1e-12 * float(np.linalg.norm(s) * np.linalg.norm(y)) > 0:
            if step == 0:
                H = np.eye(x.size) * sy / float(y @ y)
            V = np.eye(x.size) - np.outer(s, y) / sy
            H = V @ H @ V.T + np.outer(s, s) / sy
        history.append(f)
        if len(history) > patience and history[-1 - patience] - f < stagnant * abs(f):
            break
    return x, f


def _wolfe(
    value: Value, gradient: Callable[[FloatArray], FloatArray], x: FloatArray, f: float, d: FloatArray, slope: float
) -> tuple[float, FloatArray, float, FloatArray] | None:
    low, high, t, kept = 0.0, np.inf, 1.0, None
    for _ in range(BISECTIONS):
        ceiling = f + DECREASE * t * slope
        trial = value(x + t * d, ceiling)
        if not trial < ceiling:
            high = t
        else:
            g = gradient(x + t * d)
            kept = (t, x + t * d, trial, g)
            if float(g @ d) >= CURVATURE * slope:
                return kept
            low = t
        t = (low + high) / 2 if np.isfinite(high) else 2 * t
        if np.linalg.norm(x + t * d) > FARTHEST:
            return kept
        if kept is not None and high - low < 1e-3 * high:
            return kept
    return kept


def minimax(problem: TuningProblem, x: FloatArray, steps: int) -> tuple[FloatArray, float]:
    """Descend on the model max_i (f_i + g_i d) + mu |d|^2 / 2 of all peaks near the greatest.

    The step of Levenberg with a maximum in place of squares; peaks that would rise are held down before they do, and
    where as many peaks are level as there are parameters it converges as fast as Newton's method.
    """
    f, mu, history = problem.value(x), FIRST, []
    for _ in range(steps):
        f = problem.value(x)  # the grid may have grown
        history.append(f)
        if len(history) > PATIENCE and history[-1 - PATIENCE] - f < SLOW * f:
            break
        values, slopes = problem.peaks(x, ACTIVE, MOST)
        refused = False
        while True:
            d = _model_step(values, slopes, mu)
            promised = f - float(np.max(values + slopes @ d))
            if promised < ENOUGH * f:
                # too short a step, unless steps twice as long have just failed
                if refused or mu <= SMALLEST:
                    return x, f
                mu /= 10
                continue
            trial = problem.value(x + d, f)
            if f - trial > ACCEPTED * promised:
                mu = max(mu * (0.2 if f - trial > 0.5 * promised else 1.0), SMALLEST)
                x, f = x + d, trial
                break
            refused, mu = True, 4 * mu
            if mu > LARGEST:
                return x, f
    return x, f


def _model_step(values: FloatArray, slopes: FloatArray, mu: float) -> FloatArray:
    """Return argmin over d of max(values + slopes d) + mu max(values) |d|^2 / 2."""
    # It ships no types; as a plain module it is what it says.
    clarabel: Any = import_module("clarabel")
    from scipy import sparse

    m, n, top = values.size, slopes.shape[1], float(values.max())
    # in (sqrt(mu) d, t): min t + |d|^2 / 2 with slopes d - t <= -values, all over the greatest value
    root = np.sqrt(mu)
    Q = sparse.diags(np.append(np.ones(n), 0.0), format="csc")
    A = sparse.csc_matrix(np.column_stack([slopes / (top * root), -np.ones(m)]))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    linear = np.append(np.zeros(n), 1.0)
    solved = clarabel.DefaultSolver(Q, linear, A, -values / top, [clarabel.NonnegativeConeT(m)], settings).solve()
    d = np.array(solved.x)[:n] / root
    return d if np.all(np.isfinite(d)) else -slopes[int(np.argmax(values))] / (top * mu)


def stabilised(problem: TuningProblem, x: FloatArray, steps: int = 200) -> FloatArray | None:
    """Return parameters near x with which the loop is stable (phase one), or None."""
    if problem.stability(x) < 0:
        return x

    def value(point: FloatArray, ceiling: float) -> float:
        del ceiling
        try:
            return float(np.linalg.eigvals(problem.closed(point)).real.max(initial=-np.inf))
        except np.linalg.LinAlgError:
            return np.inf

    def gradient(point: FloatArray) -> FloatArray:
        return abscissa(problem, point)[1]

    # in bursts: as soon as the loop is stable, the norm is what counts
    for _ in range(max(1, steps // 20)):
        x, worst = bfgs(value, gradient, x, 20)
        if worst < 0 and problem.stability(x) < 0:
            return x
    return x if problem.stability(x) < 0 else None


def lowest(
    problem: TuningProblem,
    starts: list[FloatArray],
    steps: int,
    rounds: int,
    judge: Callable[[FloatArray], float] | None = None,
    polish: Callable[[FloatArray], FloatArray] | None = None,
) -> tuple[FloatArray, float] | None:
    """Return the best of several starts, its grid refined until no peak hides between the points.

    The last few are compared by `judge`, an exact norm, where there is one, and go on by `polish` in place of the grid.
    """
    ends: list[FloatArray] = []
    for start in starts:
        x = stabilised(problem, start)
        if x is None or not np.isfinite(problem.value(x)):
            continue
        x, _ = bfgs(problem.value, problem.gradient, x, steps if polish is None else steps // BRIEF)
        if polish is not None:  # the grid need not be followed to the bottom
            ends.append(x)
            continue
        x, _ = minimax(problem, x, steps // 4)
        # a search finds the gaps of a grid: ends are only compared when none hides a peak there
        for _ in range(LOOKS):
            if problem.refine(x) < HIDES:
                break
            x, _ = minimax(problem, x, steps // 4)
        ends.append(x)
    if not ends:
        return None
    ends = sorted(ends, key=judge if judge is not None and polish is not None else problem.value)
    # one that has run away can go no further, however good it is, and is no start for another search
    free = [x for x in ends if np.linalg.norm(x) < FARTHEST]
    polished = [polish(x) if polish else _polished(problem, x, steps, rounds) for x in free[:CONTINUED]]
    x = min([*polished, ends[0]], key=judge or problem.value)
    return x, problem.value(x)


def _polished(problem: TuningProblem, x: FloatArray, steps: int, rounds: int) -> FloatArray:
    for _ in range(rounds):
        hidden = problem.refine(x)
        old = problem.value(x)
        if not np.isfinite(old):
            break
        x, f = minimax(problem, x, steps)
        x, f = bfgs(problem.value, problem.gradient, x, steps)
        x, f = minimax(problem, x, steps)
        if hidden < 1e-4 and old - f < 1e-4 * old:
            break
    return x


def balanced(problem: TuningProblem, x: FloatArray, steps: int, rounds: int) -> tuple[FloatArray, float]:
    """Return parameters at which what is hard is met and what is soft is as small as that allows.

    max(soft weight * soft, hard) is minimised, and the weight moved until the greatest of all is one.
    """
    f, best, least = problem.value(x), x, np.inf
    for _ in range(rounds):
        problem.soft /= f**RELAXED
        x, _ = minimax(problem, x, steps)
        x, _ = bfgs(problem.value, problem.gradient, x, steps)
        x, _ = minimax(problem, x, steps)
        problem.refine(x)
        f = problem.value(x)
        merit = standing(problem, x)
        if merit < least:
            best, least = x, merit
        if abs(f - 1) < LEVEL:
            break
    return best, least


def standing(problem: TuningProblem, x: FloatArray) -> float:
    """Return the greatest soft requirement, and far more where a hard one is missed."""
    levels = problem.measured(x)
    hard = np.array([r.hard for r in problem.requirements])
    missed = float(levels[hard].max(initial=0.0)) - 1
    soft = float(levels[~hard].max(initial=0.0))
    return soft if missed <= 1 / MISSED else soft + MISSED * missed
