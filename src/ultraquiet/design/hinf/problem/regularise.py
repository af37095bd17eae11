"""Singular H-infinity problems: small weights that complete them, chosen by the norm of the problem itself."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ultraquiet._base.errors import NumericalError
from ultraquiet.design.hinf.gamma_search import Bracket, search
from ultraquiet.design.hinf.problem.units import EvenProblem
from ultraquiet.design.hinf.problem.verified import Reached, Verifier
from ultraquiet.values.state_space import StateSpace

# Weights tried in turn, in even units: half a decade apart from where they are felt to where equations lose their
# digits.
WEIGHTS = tuple(float(w) for w in 10.0 ** np.arange(-1.0, -8.1, -0.5))
SHARE = 1e-3  # of the best norm found, which the weight chosen may cost
PATIENCE = 4  # weights in turn that bring nothing before the search ends
FINE = 1e-4  # relative width of each search
# The same where a problem is only nearly singular.
SOFT = tuple(float(w) for w in 10.0 ** np.arange(-2.0, -6.1, -0.5))
AT = 1.00003  # times the level, where the law is formed that tells what a weight costs


class Regularised(NamedTuple):
    """The controller of the weight chosen, what made it, and the norm of the problem itself that every weight gave."""

    found: Reached
    verifier: Verifier
    bracket: Bracket
    weight: float
    norms: dict[float, float]

    @property
    def cost(self) -> float:
        """What the weight costs: the norm over the smallest that any of them gave, less one."""
        least = min(self.norms.values())
        if least == 0:  # of a problem that nothing need be felt of
            return 0.0 if self.found.achieved == 0 else float("inf")
        return self.found.achieved / least - 1


def completed(P: StateSpace, ny: int, nu: int, weight: float, states: bool = True) -> StateSpace:
    """Return the problem with weight times u and x seen in z besides, and as much noise on y and x in w.

    z = (z0, weight u, weight x), w = (w0, n, d), y = y0 + weight n, x' = ... + weight d. No assumption of the theory
    fails there but those on unstable modes that controls do not reach or measurements do not see, and no controller
    gives it a smaller norm than the problem itself. Without `states`, x and d are left out: what is nearly singular
    because control or noise cost nearly nothing needs no more, and is changed less.
    """
    p, m, n = P.D.shape[0] - ny, P.D.shape[1] - nu, P.states
    on_x = weight * np.eye(n if states else 0, n)
    k = len(on_x)
    B = np.hstack([P.B[:, :m], np.zeros((n, ny)), on_x.T, P.B[:, m:]])
    C = np.vstack([P.C[:p], np.zeros((nu, n)), on_x, P.C[p:]])
    D = np.zeros((p + nu + k + ny, m + ny + k + nu))
    z, w, y, u = slice(p), slice(m), slice(p + nu + k, None), slice(m + ny + k, None)
    D[z, w], D[z, u], D[y, w], D[y, u] = P.D[:p, :m], P.D[:p, m:], P.D[p:, :m], P.D[p:, m:]
    D[p : p + nu, u] = weight * np.eye(nu)
    D[y, m : m + ny] = weight * np.eye(ny)
    return StateSpace(P.A, B, C, D, P.rate_hz)


def regularised(
    P: StateSpace, problem: EvenProblem, even: StateSpace, ny: int, nu: int, margin: float
) -> Regularised | None:
    """Return the controller of the largest weight whose norm of the problem itself is within a share of the best.

    A large weight makes an equation that is easily solved and a controller of modest gain; a small one comes near what
    is possible. None where no weight gave a controller that holds the loop.
    """
    tried: list[Regularised] = []
    norms: dict[float, float] = {}
    for weight in WEIGHTS:
        attempt = _with(weight, P, problem, even, ny, nu, margin, norms)
        if attempt is not None:
            tried.append(attempt)
            norms[weight] = attempt.found.achieved
        best = min(norms.values(), default=np.inf)
        recent = [norms.get(w, np.inf) for w in WEIGHTS[: WEIGHTS.index(weight) + 1]][-PATIENCE:]
        if norms and len(recent) == PATIENCE and min(recent) > best * (1 - SHARE / 10) and norms.get(weight) != best:
            break
    return next((t for t in tried if t.found.achieved <= min(norms.values()) * (1 + SHARE)), None)


def _with(
    weight: float,
    P: StateSpace,
    problem: EvenProblem,
    even: StateSpace,
    ny: int,
    nu: int,
    margin: float,
    norms: dict[float, float],
) -> Regularised | None:
    try:
        v = Verifier(P, problem, completed(even, ny, nu, weight), ny, nu)
        bracket = search(v.plant, FINE)
    except (NumericalError, LinAlgError):
        return None
    if not bracket.best.reason:
        for factor in (1.0, 1.01, 1.1):
            found = v.at(bracket.best.gamma * margin * factor, bracket.best)
            if found is not None and found.keeps:
                return Regularised(found, v, bracket, weight, norms)
    return None


def softened(v: Verifier, best: Reached, margin: float) -> Reached | None:
    """Return what a problem with small weights on controls and measurements gives of the problem itself.

    For a search that ended open: where control costs next to nothing beside the rest, the equations lose their digits,
    and a law of another problem whose norm is verified is worth more than none. A law better than the best one known
    takes its place in `v.best`. Returned is the law at `margin` times the level of the largest weight that costs next
    to nothing, which rounding does not choose; None where no weight gives a law.
    """
    expected, tried = best.achieved * v.problem.level, list[tuple[float, Verifier, float]]()
    for weight in SOFT:
        try:
            other = Verifier(v.P, v.problem, completed(v.even, v.ny, v.nu, weight, states=False), v.ny, v.nu)
            level = search(other.plant, FINE, expected).best
        except (NumericalError, LinAlgError):
            continue
        found = None if level.reason else other.at(level.gamma * AT, level)
        tried.append((np.inf if found is None else found.achieved, other, level.gamma))
        norms = [norm for norm, _, _ in tried]
        if found is not None and found.achieved < best.achieved:
            v.best = best = found._replace(level=None)
        elif min(norms[-2:]) > min(norms) and min(norms) < np.inf:
            break  # two in turn that were worse: digits are lost again
    least = min((norm for norm, _, _ in tried), default=np.inf)
    if margin <= AT or least == np.inf:
        return None
    enough = least * (1 + SHARE)
    _, other, gamma = next(each for each in tried if each[0] <= enough)
    calm = other.at(gamma * margin)
    return None if calm is None else calm._replace(level=None)
