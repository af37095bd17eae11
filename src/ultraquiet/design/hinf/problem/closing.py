"""The smallest level that a verified controller keeps, and the highest that is shown to be out of reach."""

from typing import NamedTuple

import numpy as np

from ultraquiet.design.hinf import riccati
from ultraquiet.design.hinf.gamma_search import Bracket
from ultraquiet.design.hinf.problem.regularise import softened
from ultraquiet.design.hinf.problem.verified import Reached, Verifier

CONTRADICTED = 1e-5  # share by which a verified norm must lie under a level for that level's failure to be false
OPEN = 1e-3  # share by which the verified level may exceed the one out of reach without a further search
CLOSE = 1e-4  # share to which that search closes
STEPS = 16
ROUNDS = 3  # of that search where it ends open, each from what levels above it gave
ABOVE = (1.005, 1.02, 1.05, 1.1)
CLIMBS = 12
SPREAD = 1e6  # width of the search, where nothing is known to be out of reach
# Factors over the asked level that are tried in turn until the verified loop is stable and keeps its level.
BACK_OFF = (1.0, 1.00008, 1.0005, 1.002, 1.005, 1.02, 1.05, 1.1)


class Closed(NamedTuple):
    """What was reached, and the levels (of the even problem) between which the smallest lies.

    `out_of_reach` is shown for certain where `shown`; else it is a level at which nothing was found.
    """

    found: Reached
    out_of_reach: float
    reached: float
    shown: bool


def closed(v: Verifier, bracket: Bracket, margin: float) -> Closed | None:
    """Return a verified controller at margin times the smallest level; None where none was found at any level.

    What the equations say of levels is a hint. It is believed where the controller formed there keeps its level and
    nothing verified lies under a level that failed; otherwise levels are judged by what their controllers give, by
    this route and by direct discrete synthesis.
    """
    found = None
    if not bracket.best.reason:
        for factor in BACK_OFF:
            found = v.at(bracket.best.gamma * margin * factor, bracket.best)
            if found is not None and found.keeps:
                break
    scale, low = v.problem.level, bracket.below
    near = bracket.best.gamma * margin * (1 + CLOSE) / scale
    # what a law gives beyond its level is what rounding took: by that much others may be better
    hinted = found is not None and found.keeps and found.bound <= near and found.achieved <= near * (1 + CLOSE)
    contradicted = v.best is not None and v.best.achieved * scale < low * (1 - CONTRADICTED)
    if hinted and found is not None and not contradicted and _shown(v, bracket):
        return Closed(found, low, min(bracket.best.gamma, found.achieved * scale), True)
    return judged(v, bracket, margin, contradicted)


def _shown(v: Verifier, bracket: Bracket) -> bool:
    """Return whether a level just below the bracket is shown to be out of reach."""
    low = bracket.below
    if low <= max(bracket.proven, bracket.nought) * (1 + OPEN):
        return True
    # so near the optimum the errors of X and Y may leave it open; a little below they do not
    levels = (riccati.attempt(v.plant, low * (1 - share * OPEN)) for share in (0.3, 0.9))
    return any(level.reason and riccati.is_proof(v.plant, level) for level in levels)


def judged(v: Verifier, bracket: Bracket, margin: float, contradicted: bool) -> Closed | None:
    """Search by verified controllers alone; what equations say of levels counts unless they are contradicted."""
    scale = v.problem.level
    proven = max(bracket.certain if contradicted else bracket.proven, bracket.nought)
    if v.best is None:
        _climb(v, max(proven, bracket.nought))
    if v.best is None:
        return None
    high = v.best.achieved * scale
    if high < proven * (1 - CONTRADICTED):
        proven = bracket.nought  # a controller that keeps a level is stronger than any proof that none does
    # a search at another margin goes on where the one before ended
    nothing, none = (0.0, 0.0) if contradicted else (level if level < high else 0.0 for level in v.searched)
    shown = max(proven, none)
    low = max(proven, high / SPREAD, nothing)
    calm = None
    for _ in range(ROUNDS):
        low, high, shown = _bisected(v, low, high, shown)
        v.searched, before = (low, shown), high
        if high <= shown * (1 + OPEN):
            break
        # equations that cannot be solved at a level may be solved above it, for a law that gives less than that level
        calm = softened(v, v.best, margin) or calm
        _tried(v, [high * factor for factor in ABOVE])
        high = v.best.achieved * scale
        if high > before * (1 - CLOSE):
            break
        low = max(proven, shown)
    chosen = (_calmer(v, v.best, calm, margin) if margin > 1 + CLOSE else None) or v.best
    return Closed(chosen, shown, high, high <= shown * (1 + OPEN))


def _calmer(v: Verifier, best: Reached, calm: Reached | None, margin: float) -> Reached | None:
    """Return a verified law formed at a margin over the optimum, None where there is none.

    One a little off the optimum is the better one to build; one far off it is not what was asked for. Where equations
    cannot be solved there, that of the softened problem is nearest to theirs; the other route forms another law.
    """
    limit = best.achieved * margin
    level = limit * v.problem.level
    routes = (lambda: v.at(level), lambda: calm or softened(v, best, margin), lambda: v.beside(level))
    return next((c for route in routes if (c := route()) is not None and c.keeps and c.achieved <= limit), None)


def _bisected(v: Verifier, low: float, high: float, shown: float) -> tuple[float, float, float]:
    """Return the levels between which verified controllers leave the smallest, and the highest shown out of reach."""
    for _ in range(STEPS):
        if high <= low * (1 + CLOSE):
            break
        middle = float(np.sqrt(low * high))
        _tried(v, [middle])
        assert v.best is not None
        reached = v.best.achieved * v.problem.level
        if v.shown and reached > middle:
            shown = max(shown, middle)
        low = low if reached < high else middle
        high = min(high, reached)
    return low, high, shown


def _tried(v: Verifier, levels: list[float]) -> None:
    """Form controllers at some levels: by the other route where this one fails without showing that there is none."""
    for level in levels:
        if v.at(level) is None and not v.shown:
            v.beside(level)


def _climb(v: Verifier, start: float) -> None:
    """Try ever higher levels until one is reached."""
    level = start
    for k in range(CLIMBS):
        level *= 1.02 if k == 0 else 2.0 if k < 4 else 10.0
        if v.at(level) is not None or v.beside(level) is not None:
            return
