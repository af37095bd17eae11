"""The search: steps on all levels near the greatest at once, in dB, each loop's poles checked on every step taken."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.progress import Task
from ultraquiet.design.peak_bounded.loops.levels import LoopLevels, Standing
from ultraquiet.design.peak_bounded.step import DB, LEAST, Held, Linearised, merit, step

PRICE = 10.0  # dB of attenuation that a dB of excess may cost: more than any bound's exchange rate met so far
WIDTH_DB, MOST = 3.0, 200  # levels within so much of the greatest enter a step; lines between maxima, a plant and kind
FIRST, SMALLEST, LARGEST = 30.0, 1e-4, 1e8  # damping, in dB per squared relative change
TAKEN, GOOD = 0.05, 0.5  # shares of the promised decrease
CALMER, BOLDER = 4.0, 0.3
ENOUGH_DB, PATIENCE = 0.03, 6  # a search that gains less over so many steps ends
SMALL_SHARE = 0.02  # of the largest numerator: a smaller one moves by as much
LEAST_DB = 1e-3  # promised: a step is not worth more tries
FAR_DB = 10.0
QUIETER, TURNS = 0.7, 30  # a law that is unstable somewhere is turned down by this factor, again and again
MARGIN = 1e-6  # poles count as stable this far inside, relative to their size


@dataclass(frozen=True, eq=False)
class SearchEnd:
    """Where a search ended: parameters, how they stand, steps taken, whether the loops are stable."""

    theta: FloatArray
    standing: Standing
    steps: int
    stable: bool


def stable(levels: LoopLevels, theta: FloatArray) -> bool:
    """Return whether law and all loops are stable; lines are taken in at which their modes would show."""
    law = levels.structure.system(theta)
    if levels.structure.abscissa(theta) >= 0:
        return False
    every = []
    for scenario in levels.scenarios:
        try:
            poles = scenario.poles(law)
        except np.linalg.LinAlgError:
            return False
        if np.any(poles.real > -MARGIN * np.abs(poles)):
            return False
        every.append(poles)
    for scenario, poles in zip(levels.scenarios, every, strict=True):
        scenario.look(poles)
    return True


def search(levels: LoopLevels, theta: FloatArray, steps: int, progress: Task, price: float = PRICE) -> SearchEnd:
    """Lower the greatest sensitivity in the band with everything else below its bound, from parameters that are stable.

    min over theta of max S in dB + price * max(0, greatest excess in dB).

    Each step solves the linearised problem with a damping that grows where a step disappoints or leaves a loop
    unstable (Levenberg and Marquardt's rule with a maximum in place of squares).
    """
    if not stable(levels, theta):
        return SearchEnd(theta, Standing(np.inf, np.inf), 0, False)
    now = levels.standing(theta)
    value, damping, history = merit(now.level_db, now.excess_db, price), FIRST, []
    taken = 0
    for _ in range(steps):
        progress.advance(note=f"{-now.level_db:.1f} dB, {now.excess_db:+.2f} dB beside the bounds")
        history.append(value)
        if len(history) > PATIENCE and history[-1 - PATIENCE] - value < ENOUGH_DB:
            break
        moved = failed = False
        model, picks = levels.linearised(theta, WIDTH_DB, MOST)
        sizes = _sizes(levels, theta, model)
        model = model.scaled(sizes)
        held = Held(model)
        while damping < LARGEST:
            d, promised = step(model, price, damping, held)
            gain = value - promised
            if gain < LEAST_DB:
                # too short a step, unless a longer one has just failed
                if failed or damping <= SMALLEST:
                    break
                damping /= 10
                continue
            gained, trial = _try(levels, theta, sizes * d, value, price)
            if gained < GOOD * gain:
                bent = model.corrected(d, *levels.again(trial, picks))
                again, other = _try(levels, theta, sizes * step(bent, price, damping, held)[0], value, price)
                if again > gained:
                    gained, trial = again, other
            if gained > TAKEN * gain and stable(levels, trial):
                damping = max(damping * (BOLDER if gained > GOOD * gain else 1.0), SMALLEST)
                theta, moved = trial, True
                break
            failed, damping = True, CALMER * damping
        if not moved:
            break
        taken += 1
        now = levels.standing(theta)  # the loops' own modes have brought lines
        value = merit(now.level_db, now.excess_db, price)
    return SearchEnd(theta, now, taken, True)


def calmed(levels: LoopLevels, theta: FloatArray) -> FloatArray | None:
    """Return the parameters turned down until all loops are stable and no bound is exceeded by far; None where none is.

    From farther off the shortest way within the bounds is to do nothing.
    """
    structure, trial, found = levels.structure, theta, None
    for _ in range(TURNS):
        if stable(levels, trial):
            found = trial
            if levels.standing(trial).excess_db <= FAR_DB:
                break
        parts = zip(structure.elements, structure.parts(trial), strict=True)
        trial = np.concatenate([element.turned_down(part, QUIETER) for element, part in parts])
    return found


def _try(
    levels: LoopLevels, theta: FloatArray, change: FloatArray, value: float, price: float
) -> tuple[float, FloatArray]:
    """Return by how much a change lowers the merit, and where it leads."""
    trial = np.maximum(theta + change, levels.structure.lowest)
    there = levels.standing(trial)
    return value - merit(there.level_db, there.excess_db, price), trial


def _sizes(levels: LoopLevels, theta: FloatArray, model: Linearised) -> FloatArray:
    """Return what one unit of each parameter's step is: what moves some level by a neper, its own size at most.

    Marquardt's scaling: a sharp pole that moves by its width does as much as a dull one that moves by its frequency.
    """
    parts = zip(levels.structure.elements, levels.structure.parts(theta), strict=True)
    own = np.concatenate([element.sizes(part) for element, part in parts])
    steepest = np.abs(model.slopes).max(axis=0, initial=0.0) / DB
    steepest = np.maximum(steepest, np.abs(model.turns).max(axis=0, initial=0.0))
    return np.minimum(own, 1 / np.maximum(steepest, LEAST))
