"""The smallest level at which an H-infinity problem has a solution: a bound from below, then few well-aimed probes."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ultraquiet.design.hinf import riccati
from ultraquiet.design.hinf.lower_bound import lower_bound
from ultraquiet.linalg.ordered import Array

LARGEST = 1e12  # times the first level: above it the assumptions of the theory must be violated
SMALLEST = 1e-9  # of the sizes of the blocks: an optimum below it is zero
BLUR = 1e3  # times the smallest level that counts: where round-off of gamma^2 decides what is solved
PROBES = 60
GROWTH = (1.25, 1.6, 2.5, 10.0)  # factors from one level that fails to the next try, the last one repeated
NEAREST = 4  # levels around the optimum whose measures are looked at
REGULAR = 1e-7  # of the trace, added to the X that others are measured by
PATIENCE = 3  # probes in which the bracket must halve, or bisection takes over
BLURRED = 1e-4  # tolerance once an equation cannot be solved though its bound allows it: round-off is near
UNDECIDED = 2e-5  # the same once one is solved, but not to the sign of its solution
OVERSHOOT = 0.4  # of the tolerance, to either side of a level that is expected
ON_STEP = 1e-3  # of a step: a level this near to one of the ladder is on it
WITHIN = 1 - 1e-9  # of the tolerance is a step wide, so that no rounding makes a bracket of one step wider
OUT_OF_REACH = "what controls do not reach, or measurements do not see, exceeds it at one frequency"


class Ladder(NamedTuple):
    """The levels that a search may end at: origin (1 + ratio)^k for whole k.

    A bracket that closes anywhere depends on what was tried before, and so on the last digit of every measure: what a
    machine rounds otherwise would change the level by the whole width. Between two steps of one ladder it cannot.
    """

    origin: float
    ratio: float

    def level(self, k: int) -> float:
        """Return the level of a step."""
        return float(self.origin * np.exp(k * np.log1p(self.ratio)))

    def inside(self, low: float, high: float) -> range:
        """Return the steps strictly between two levels."""
        below, above = self._step(low), self._step(high)
        return range(int(np.floor(below + ON_STEP)) + 1, int(np.ceil(above - ON_STEP)))

    def beside(self, level: float, steps: range, upwards: bool) -> int:
        """Return the step next above or below a level, among those given."""
        k = int(np.ceil(self._step(level)) if upwards else np.floor(self._step(level)))
        return min(max(k, steps[0]), steps[-1])

    def _step(self, level: float) -> float:
        return float(np.log(level / self.origin) / np.log1p(self.ratio))


class Bracket(NamedTuple):
    """The best level solved, a level below it that fails, why that one does, and how many levels were tried.

    `certain` is the part of `below` that frequency responses alone prove: no controller gets under it; `proven` the
    highest level that an equation shows to be out of reach beyond its own error, at least `certain`. Levels up to
    `nought` count as zero.
    """

    best: riccati.Level
    below: float
    reason: str
    probes: int
    certain: float
    nought: float
    proven: float

    @property
    def is_zero(self) -> bool:
        """Whether the optimum is zero but for round-off."""
        return self.certain <= self.nought and self.best.gamma <= BLUR * self.nought


def search(plant: riccati.NormalisedPlant, tolerance: float, expected: float | None = None) -> Bracket:
    """Bracket the smallest level to a relative tolerance.

    Where another theory knows the smallest level, a level just above the expected one and one just below are tried
    first: where the one is solved and the other is not, they are the bracket. An expectation proves nothing; where it
    is wrong the search goes on with what the two have shown.

    The bound from frequency responses is tried first; where it is not reached, each way to fail (X or Y turns
    indefinite through infinity, rho(XY) passes gamma^2) has a measure that is smooth and zero at the failure, and the
    step of a ladder of levels that is next to the largest of the roots that secants promise is tried next.
    """
    certain = max(riccati.floor(plant), lower_bound(plant).level)
    nought = SMALLEST * _size(plant)
    low, reason = certain, OUT_OF_REACH
    ladder = Ladder(max(certain * (1 + WITHIN * tolerance), nought), WITHIN * tolerance)
    start = ladder.origin
    best, tried = _first(plant, start) if expected is None else _around(plant, expected, start, tolerance)
    failed = [t for t in tried if t.reason and t.gamma <= best.gamma]
    if failed:
        highest = max(failed, key=lambda t: t.gamma)
        low, reason = highest.gamma, highest.reason
    widths = [best.gamma / max(low, nought)]
    while not best.reason and best.gamma > max(low, nought) * (1 + tolerance) and len(tried) < PROBES:
        gamma = _next(tried, max(low, nought), best.gamma, ladder, widths)
        if np.isnan(gamma):
            break
        level = riccati.attempt(plant, gamma, reason.startswith("filter"))
        tried.append(level)
        if level.reason:
            low, reason = level.gamma, level.reason
            tolerance = max(tolerance, _blur(level))
        else:
            best = level
        widths.append(best.gamma / max(low, nought))
    failed = sorted((t for t in tried if t.reason and t.gamma > certain), key=lambda t: -t.gamma)
    proven = next((t.gamma for t in failed if riccati.is_proof(plant, t)), certain)
    return Bracket(best, low, reason, len(tried), certain, nought, proven)


def _blur(level: riccati.Level) -> float:
    """Return the tolerance below which a level that fails leaves nothing to be known."""
    if level.proof or np.isfinite(level.coupling):
        return 0.0
    return UNDECIDED if level.X.size or level.Y.size else BLURRED


def at_level(plant: riccati.NormalisedPlant, gamma: float) -> Bracket:
    """Try one level."""
    certain, nought = max(riccati.floor(plant), lower_bound(plant).level), SMALLEST * _size(plant)
    if gamma <= certain:
        none = np.zeros((0, 0))
        reason = f"at one frequency no controller gets below {certain:.6g}"
        level = riccati.Level(gamma, none, none, reason=reason, proof=True)
        return Bracket(level, gamma, "", 0, certain, nought, gamma)
    level = riccati.attempt(plant, gamma)
    proven = gamma if level.reason and riccati.is_proof(plant, level) else certain
    return Bracket(level, float("nan"), "", 1, certain, nought, proven)


def _first(plant: riccati.NormalisedPlant, start: float) -> tuple[riccati.Level, list[riccati.Level]]:
    """Climb from a level until one is solved."""
    tried = [riccati.attempt(plant, start)]
    while tried[-1].reason and tried[-1].gamma < LARGEST * start:
        last = tried[-1]
        factor = GROWTH[min(len(tried), len(GROWTH)) - 1]
        if np.isfinite(last.coupling):
            # rho(XY) falls with gamma: where X and Y exist, this level keeps it below gamma^2
            factor = min(factor, np.sqrt(last.coupling) * (1 + 1e-6)) if last.coupling > 1 else factor
        tried.append(riccati.attempt(plant, last.gamma * factor, last.reason.startswith("filter")))
    return tried[-1], tried


def _around(
    plant: riccati.NormalisedPlant, expected: float, start: float, tolerance: float
) -> tuple[riccati.Level, list[riccati.Level]]:
    """Try a level on either side of the one expected, and where both are solved the one that is tried without it."""
    edge = OVERSHOOT * tolerance
    best, tried = _first(plant, max(expected * (1 + edge), start))
    if len(tried) > 1:
        return best, tried  # it is higher than expected, and the climb has it between two levels
    for level in (expected * (1 - edge), start):
        if start <= level < best.gamma:
            tried.append(riccati.attempt(plant, level))
            if tried[-1].reason:
                break
            best = tried[-1]
    return best, tried


def _next(tried: list[riccati.Level], low: float, high: float, ladder: Ladder, widths: list[float]) -> float:
    """Return the next level to try, a step of the ladder inside (low, high); nan where none is left."""
    steps = ladder.inside(low, high)
    if not steps:
        return float("nan")
    middle = ladder.level(steps[len(steps) // 2])
    if len(widths) > PATIENCE and np.log(widths[-1]) > np.log(widths[-1 - PATIENCE]) / 2:
        return middle
    nearest = sorted(tried, key=lambda t: min(abs(np.log(t.gamma / low)), abs(np.log(t.gamma / high))))[:NEAREST]
    first = next(t for t in tried if not t.reason)
    measures = (_room(first.X, "X"), _room(first.Y, "Y"), _spare)
    roots = [r for m in measures if np.isfinite(r := _root(nearest, m, low, high))]
    if not roots:
        return middle
    # to the far side of the root, so that the bracket closes from both ends
    return ladder.level(ladder.beside(max(roots), steps, upwards=bool(tried[-1].reason)))


def _root(tried: list[riccati.Level], measure: Callable[[riccati.Level], float], low: float, high: float) -> float:
    """Return where a secant of a measure is zero inside (low, high); nan when none is.

    The secant through the two smallest values converges fast; the one through the smallest of either sign is safe.
    """
    known = sorted(((t.gamma, h) for t in tried if np.isfinite(h := measure(t))), key=lambda known: abs(known[1]))
    pairs = [known[:2], [k for k in known if k[1] > 0][:1] + [k for k in known if k[1] <= 0][:1]]
    for pair in pairs:
        if len(pair) == 2 and (pair[0][1] - pair[1][1]) * (pair[0][0] - pair[1][0]) > 0:
            (g1, h1), (g2, h2) = pair
            root = g1 - h1 * (g1 - g2) / (h1 - h2)
            if low < root < high:
                return root
    return float("nan")


def _spare(level: riccati.Level) -> float:
    """Return gamma^2 / rho(XY) - 1, nan where it is not known."""
    return 1 / level.coupling - 1 if 0 < level.coupling < np.inf else float("nan")


def _room(reference: Array, name: str) -> Callable[[riccati.Level], float]:
    """Return a measure of X (or Y): the inverse of its eigenvalue farthest from zero, relative to one at a good level.

    X grows without bound towards the level where it ceases to be of use and comes back from minus infinity below:
    its inverse falls through zero. Relative to a good X every direction begins at one, so that none hides another.
    """
    n = reference.shape[0]
    scale = float(np.trace(reference)) if n else 0.0
    if scale <= 0:
        return lambda _: float("nan")
    try:
        root = np.linalg.inv(np.linalg.cholesky(reference + REGULAR * scale * np.eye(n)))
    except np.linalg.LinAlgError:  # errors of a reference that is all but singular; bisection does without
        return lambda _: float("nan")

    def measure(level: riccati.Level) -> float:
        X = getattr(level, name)
        if not X.size:
            return float("nan")
        values = np.linalg.eigvalsh(root @ X @ root.T)
        return float(1 / (values[0] if name + " is indefinite" in level.reason else values[-1]))

    return measure


def _size(plant: riccati.NormalisedPlant) -> float:
    """Return a level of the right order from the sizes of the blocks."""
    size = np.linalg.norm(plant.B1) * np.linalg.norm(plant.C1)
    return float(max(size, np.linalg.norm(plant.D11), 1e-12))
