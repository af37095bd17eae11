"""A second opinion on an H-infinity optimum: another theory, other equations, no bilinear map for discrete plants."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import positive, whole
from ultraquiet._base.errors import NumericalError
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.hinf.lower_bound import lower_bound
from ultraquiet.design.hinf.problem.hidden import without_hidden
from ultraquiet.design.hinf.problem.units import even_problem
from ultraquiet.design.hinf.problem.verified import Reached, Verifier
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

WIDTH = 1e-3  # relative distance from the optimum at which the two sides are asked for
ASIDE = (0.0, 0.25, 0.5)  # of it: where a level is asked for once more when an equation could not be solved at it


class Opinion(NamedTuple):
    """What the second route says of a level.

    `reaches` whether its own controller keeps the loop stable and the norm at `level` (a little above the optimum
    claimed), `norm` the smallest norm of a controller that it found, `below` whether that is a little below as well.
    `decided` is whether what it failed at is shown to be out of reach: an equation that could not be solved says
    nothing, so that it neither agrees nor differs.
    """

    agrees: bool
    level: float
    reaches: bool
    norm: float
    below: bool
    sentence: str
    decided: bool = True


@takes_systems
@single_threaded
def verify_level(
    P: StateSpace, measurements: int, controls: int, gamma: float, tolerance: float = WIDTH, below: float | None = None
) -> Opinion:
    """Return whether direct discrete synthesis finds the same smallest H-infinity level.

    It agrees when it reaches gamma (1 + tolerance), its own loop closed and measured, and not gamma (1 - tolerance).

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y). A discrete one is taken as it is, a continuous one through
            the bilinear map: in both cases the other way than `synthesize_hinf` goes.
        measurements: number of last outputs y.
        controls: number of last inputs u.
        gamma: the level in question.
        tolerance: relative.
        below: lower end of the bracket, when gamma is the upper.

    Returns:
        An `Opinion`; its sentence says what was found.

    Raises:
        InputError: sizes that do not fit the plant, a level or tolerance that is not positive.

    >>> P = StateSpace([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> verify_level(P, 1, 1, gamma=3**0.5 - 1).agrees, verify_level(P, 1, 1, gamma=0.8).agrees
    (True, False)

    Green and Limebeer 1995, appendix B; Iglesias and Glover 1991, doi:10.1080/00207179108934194.
    """
    who = "verify_level"
    ny = whole(who, "measurements", measurements, 1, P.D.shape[0] - 1)
    nu = whole(who, "controls", controls, 1, P.D.shape[1] - 1)
    high = positive(who, "gamma", gamma) * (1 + positive(who, "tolerance", tolerance))
    low = (gamma if below is None else positive(who, "below", below)) * (1 - tolerance)
    try:
        problem = even_problem(P, ny, nu)
        route = Verifier(P, problem, without_hidden(problem.plant)[0], ny, nu)
    except NumericalError as error:
        return Opinion(False, high, False, float("nan"), False, f"The second route has no say: {error}", False)
    return heard(route, high, low, tolerance)


def heard(route: Verifier, high: float, low: float, tolerance: float = WIDTH, certain: float | None = None) -> Opinion:
    """Ask for a controller at the upper level and for one at the lower.

    `certain` is the level that frequency responses prove out of reach, where it is known.
    """
    certain = lower_bound(route.plant).level / route.problem.level if certain is None else certain
    over, _, why_not = _made(route, [high * (1 - share * tolerance) for share in ASIDE])
    lower_levels = [low * (1 - share * tolerance) for share in ASIDE]
    if 0 < certain < low:
        lower_levels.append(float(np.sqrt(certain * low)))
    met = over is not None and over.achieved <= low
    under, shown, why = (None, False, "") if met else _made(route, lower_levels)
    norm = min((found.achieved for found in (over, under) if found is not None), default=np.inf)
    reaches, lower = norm <= high * (1 + tolerance), norm <= low * (1 + tolerance / 2)
    shown = shown or low <= certain
    if lower:
        said, decided = f"reaches {norm:.6g}: the optimum is lower than claimed", True
    elif not reaches:
        # an equation may fail where another does not: only frequency responses prove that nothing reaches a level
        decided = high <= certain
        said = f"does not reach {high:.6g}: {why_not or f'its loop has the norm {norm:.6g}'}"
    else:
        decided = under is not None or shown
        said = f"reaches {high:.6g} with the norm {norm:.6g} and not {low:.6g}: {why or f'its loop gives {norm:.6g}'}"
    agrees = reaches and not lower and decided
    return Opinion(agrees, high, reaches, norm, lower, f"Direct discrete synthesis {said.rstrip('.')}.", decided)


def _made(route: Verifier, levels: list[float]) -> tuple[Reached | None, bool, str]:
    """Return the first controller at levels that fall, and what the first of them failed at: shown to be, and said.

    On a plant whose equations lie at the edge of what can be solved, rounding decides at which levels they are.
    """
    shown, said = False, ""
    for level in levels:
        found = route.beside(level * route.problem.level)
        if level == levels[0]:
            shown, said = route.shown, route.said
        if found is not None or route.shown:
            return found, shown, said
    return None, shown, said
