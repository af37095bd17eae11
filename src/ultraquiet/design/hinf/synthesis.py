"""H-infinity synthesis for a given generalised plant."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import positive, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.hinf import riccati
from ultraquiet.design.hinf.assumptions import WHO, out_of_reach, zeros_on_boundary
from ultraquiet.design.hinf.gamma_search import Bracket, at_level, search
from ultraquiet.design.hinf.problem.closing import Closed, closed, judged
from ultraquiet.design.hinf.problem.hidden import without_hidden
from ultraquiet.design.hinf.problem.regularise import WEIGHTS, regularised
from ultraquiet.design.hinf.problem.units import EvenProblem, even_problem
from ultraquiet.design.hinf.problem.verified import Reached, Verifier
from ultraquiet.design.hinf.verification import WIDTH, heard
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.values.door import HUGE, takes_systems
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

FINEST = 1e-5  # relative width of the bracket around the optimum
# Around an optimum that another theory tells the bracket is this share of the margin wide: it need not be found. What
# is searched for is found to the finest width whatever the margin: wider ones show in laws where rounding moves an end.
COARSENESS = 0.05
FASTEST = 1e12  # stands for infinite frequency, in units of the plant's own speed
SMALL = 40  # states up to which the second opinion comes without asking
LEAST = 0.5  # of the optimum: lowest level the second opinion is asked about
AGREEMENT = 1e-3  # reported and achieved norm must agree this well


class SoughtLevel(NamedTuple):
    """What level a synthesis is to find: one that is asked for, or `margin` times the smallest.

    `expected` is where another theory has the smallest; None where none has. `second_opinion` as in `synthesize_hinf`.
    `calmer` are further margins, tried in turn while the controller is unstable by itself.
    """

    gamma: float | None = None
    margin: float = 1.00003
    second_opinion: bool | None = None
    expected: float | None = None
    calmer: tuple[float, ...] = ()


@takes_systems
@single_threaded
def synthesize_hinf(
    P: StateSpace,
    measurements: int,
    controls: int,
    gamma: float | None = None,
    margin: float = 1.00003,
    second_opinion: bool | None = None,
    regularise: bool = False,
) -> DesignResult:
    """Return the controller that minimises the H-infinity norm of a closed loop.

    min over K of ||F(P, K)||, F(P, K) = P11 + P12 K (I - P22 K)^-1 P21, u = K y.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y), continuous or discrete. Discrete plants go through the
            bilinear map, which changes neither the norm nor the number of states.
        measurements: number of last outputs y.
        controls: number of last inputs u.
        gamma: level to reach; None searches for the smallest.
        margin: the controller is formed at margin times the optimum. Values just above one give the optimal level and
            controllers with very fast modes; 1.05 is the better choice for a controller to be built.
        second_opinion: whether the optimum is to be found again by `verify_level`; None asks for plants of up to 40
            states.
        regularise: whether a singular problem (D12 or D21 without full rank, zeros on the stability boundary) is to be
            completed with small weights on controls, measurements and states. The largest weight is taken whose norm
            of the problem itself is within a thousandth of the best that any of them gave; `details["regularised"]`
            holds it, `weight` in even units, its `cost` over that best, and the `norms` that all of them gave.

    Returns:
        A `DesignResult`: `gamma` is the norm that the returned controller gives in the coordinates of the synthesis,
        `achieved` the norm of F(P, K) computed again in the units of P; `details` holds `optimum`, the bracket of the
        smallest level, `decided`, whether nothing goes below it for certain, `below`, why levels under it fail,
        `certain`, the level that frequency responses alone prove out of reach, `bound`, the level of the equations
        solved, their `conditions`, and `second_opinion`. Without a solution the status is `refused`, its sentence names
        the block at fault, and there is no controller.

    Raises:
        InputError: sizes that do not fit the plant.

    gamma is the greatest energy gain from w to z that is left over all frequencies and directions.

    >>> P = StateSpace([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> result = synthesize_hinf(P, measurements=1, controls=1)
    >>> result.status.ok, abs(result.gamma / result.achieved - 1) < 1e-3
    (True, True)

    Glover and Doyle 1988, doi:10.1016/0167-6911(88)90055-2.
    """
    who = "synthesize_hinf"
    ny = whole(who, "measurements", measurements, 1, P.D.shape[0] - 1)
    nu = whole(who, "controls", controls, 1, P.D.shape[1] - 1)
    factor = _at_least_one(margin)
    level = None if gamma is None else positive(who, "gamma", gamma)
    return _synthesised(P, ny, nu, SoughtLevel(level, factor, second_opinion), regularise)


@single_threaded
def synthesize_expected(
    P: StateSpace, measurements: int, controls: int, expected: float | None, margin: float
) -> DesignResult:
    """Return what `synthesize_hinf` does for a problem whose smallest norm another theory has told.

    What is expected only says where to look first: the level above it has to be solved, the one below it to fail, and
    the controller to give its norm. Where it is wrong, the ordinary search goes on.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y), continuous or discrete.
        measurements: number of last outputs y.
        controls: number of last inputs u.
        expected: the smallest norm, in units of P; None where nothing is known of it.
        margin: over the smallest norm.

    Raises:
        InputError: a margin below one.
    """
    sought = SoughtLevel(margin=_at_least_one(margin), expected=expected)
    return _synthesised(P, measurements, controls, sought, False)


@single_threaded
def synthesize_calm(
    P: StateSpace, measurements: int, controls: int, margin: float, calmer: tuple[float, ...]
) -> DesignResult:
    """Return what `synthesize_hinf` does at the first margin whose controller is stable by itself, else at `margin`.

    The smallest norm is searched for once: what was tried at one margin counts at the next.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y), continuous or discrete.
        measurements: number of last outputs y.
        controls: number of last inputs u.
        margin: over the smallest norm, tried first.
        calmer: margins that follow.

    Raises:
        InputError: a margin below one.
    """
    sought = SoughtLevel(margin=_at_least_one(margin), calmer=calmer)
    return _synthesised(P, measurements, controls, sought, False)


def _at_least_one(margin: float) -> float:
    if not positive("synthesize_hinf", "margin", margin) >= 1:
        raise InputError(f"synthesize_hinf: 'margin' must be at least one, got {margin:g}.")
    return margin


def _synthesised(P: StateSpace, ny: int, nu: int, sought: SoughtLevel, regularise: bool) -> DesignResult:
    """Solve the problem in even units, without what it hides; whole, or completed with weights, where that fails."""
    problem = even_problem(P, ny, nu)
    even, hidden = without_hidden(problem.plant)
    sentence = out_of_reach(even, ny, nu)
    if sentence:
        return refused(sentence)
    # what is taken off moves a zero, and one on the boundary off it
    sentence = _whole_zeros(P, problem, ny, nu) if hidden else ""
    result = refused(sentence) if sentence else _solved(P, problem, even, ny, nu, sought)
    if hidden and not result.status.ok:
        hidden = 0
        if not sentence:
            result = _solved(P, problem, problem.plant, ny, nu, sought)
    if regularise and not result.status.ok:
        result = _completed(result, P, problem, even, ny, nu, sought)
    return _told(result, hidden) if hidden else result


def _whole_zeros(P: StateSpace, problem: EvenProblem, ny: int, nu: int) -> str:
    """Return what `zeros_on_boundary` says of a problem with all its states; empty where they cannot be normalised."""
    try:
        return zeros_on_boundary(Verifier(P, problem, problem.plant, ny, nu).plant, P.rate_hz)
    except NumericalError:
        return ""


def _solved(
    P: StateSpace, problem: EvenProblem, even: StateSpace, ny: int, nu: int, sought: SoughtLevel
) -> DesignResult:
    """Search, form, verify and compare, on the even problem or what is left of it without its hidden states."""
    try:
        v = Verifier(P, problem, even, ny, nu)
        sentence = zeros_on_boundary(v.plant, P.rate_hz)
        if sentence:
            return refused(sentence)
        if sought.gamma is not None:
            return _asked(v, sought.gamma)
        margin = sought.margin
        expected = None if sought.expected is None else sought.expected * problem.level
        width = FINEST if expected is None else max(FINEST, COARSENESS * (margin - 1))
        bracket = search(v.plant, width, expected)
        if bracket.best.reason and v.in_parts():
            bracket = search(v.plant, width, expected)
        result = first = _formed(v, bracket, margin, sought)
        for calmer in sought.calmer:
            if result.controller is None or result.controller.is_stable():
                break
            result = _formed(v, bracket, calmer, sought)
        return result if result.controller is not None and result.controller.is_stable() else first
    except NumericalError as error:
        return refused(str(error))


def _formed(v: Verifier, bracket: Bracket, margin: float, sought: SoughtLevel) -> DesignResult:
    """Form and verify a controller at a margin, with the second opinion on the optimum where it is wanted."""
    found = closed(v, bracket, margin)
    if found is None:
        return refused(_sentence(None, bracket.best.reason or v.said, True))
    result = _result(v, bracket, found)
    wanted = v.P.states <= SMALL if sought.second_opinion is None else sought.second_opinion
    compared = wanted and result.status.ok and not bracket.is_zero
    return _agreed(v, bracket, margin, _seconded(v, result)) if compared else result


def _completed(
    result: DesignResult,
    P: StateSpace,
    problem: EvenProblem,
    even: StateSpace,
    ny: int,
    nu: int,
    sought: SoughtLevel,
) -> DesignResult:
    """Solve the problem completed with small weights; what is reported is the norm of the problem itself."""
    gamma = sought.gamma
    ended = regularised(P, problem, even, ny, nu, sought.margin)
    if ended is None:
        return refused(f"{result.status.sentence} No weight from {WEIGHTS[0]:g} to {WEIGHTS[-1]:.0e} mends it.")
    found = ended.found
    if gamma is not None and found.achieved > gamma * (1 + AGREEMENT):
        return refused(
            f"{WHO}: no controller was found at level {gamma:g}; the best that small weights gave is "
            f"{found.achieved:.6g}, which is no proof that there is none. {result.status.sentence}"
        )
    formed = _result(ended.verifier, ended.bracket, Closed(found, 0.0, found.achieved * problem.level, True))
    cost = {"weight": ended.weight, "cost": ended.cost, "norms": ended.norms, "instead_of": result.status.sentence}
    best = min(ended.norms.values())
    said = (
        f"The loop is stable and the norm of the problem itself is {found.achieved:.5g}; it is singular, and was "
        f"solved with a weight of {ended.weight:.1e} on controls, measurements and states in even units, at "
        f"{ended.cost:.2%} over {best:.5g}, the best of {len(ended.norms)} weights."
    )
    status = Status(StatusWord.OK, said) if formed.status.ok else formed.status
    optimum = (0.0, best)
    return replace(
        formed, status=status, details={**formed.details, "optimum": optimum, "decided": False, "regularised": cost}
    )


def _asked(v: Verifier, gamma: float) -> DesignResult:
    """Keep a level that was asked for, by either route, or refuse it."""
    even = gamma * v.problem.level
    if even > HUGE:
        raise InputError(
            f"synthesize_hinf: 'gamma' is {gamma:g}, whose square overflows; ask for less, or leave it out."
        )
    bracket = at_level(v.plant, even)
    proven = bool(bracket.best.reason) and bracket.proven >= even
    found = None if proven else v.at(even, bracket.best)
    said = bracket.best.reason or v.said
    if not proven and (found is None or not found.keeps):
        found = v.beside(even)
    if found is None or not found.keeps:
        return refused(_sentence(gamma, said, proven))
    return _result(v, bracket, Closed(found, float("nan"), even, True))


def _result(v: Verifier, bracket: Bracket, ended: Closed) -> DesignResult:
    found, scale = v.finely(ended.found), v.problem.level
    settings = {"measurements": v.ny, "controls": v.nu, "bound": found.bound}
    provenance = Provenance("synthesize_hinf", settings, parents=(v.P.hash,), versions=versions())
    K = found.controller
    controller = StateSpace(K.A, K.B, K.C, K.D, rate_hz=K.rate_hz, provenance=provenance)
    gamma = _own_norm(v, found) / scale
    nought = bracket.nought / scale
    alike = abs(found.achieved - gamma) <= AGREEMENT * max(found.achieved, nought)
    if not alike and not max(found.achieved, gamma) <= nought:  # below it both are zero but for round-off
        return refused(f"{WHO}: reported {gamma:.6g}, achieved {found.achieved:.6g} at level {found.bound:.6g}")
    level = found.level
    details = {
        "bound": found.bound,
        # one may be the other but for rounding: a bound of responses alone that a controller reaches
        "optimum": (min(ended.out_of_reach, ended.reached) / scale, ended.reached / scale),
        "decided": ended.shown,
        "below": bracket.reason,
        "certain": bracket.certain / scale,
        "probes": bracket.probes,
        "achieved_hz": found.f_hz,
        "coupling": float("nan") if level is None else level.coupling,
        "conditions": {} if level is None else _conditions(v.plant, level),
    }
    residuals = {} if level is None else dict(zip("XY", level.residuals, strict=True))
    most = max(found.bound, found.achieved)
    said = f"The loop is stable and its norm is {found.achieved:.5g}, at most {most:.5g} as designed."
    if not ended.shown:
        said += (
            f" Whether a controller goes below {ended.reached / scale:.6g} is not decided: no equation could be solved "
            f"there, and nothing shows more than {ended.out_of_reach / scale:.6g} to be out of reach."
        )
    status = Status(StatusWord.OK, said)
    return DesignResult(
        status,
        controller,
        gamma,
        found.achieved,
        found.poles,
        residuals=residuals,
        details=details,
        provenance=provenance,
    )


def _told(result: DesignResult, hidden: int) -> DesignResult:
    """Add a word on states that were taken off first."""
    word = f"{hidden} state{'s' * (hidden > 1)} of the plant, hidden from every input or output, were left out of it"
    status = Status(result.status.word, f"{result.status.sentence} {word}.")
    return replace(result, status=status, details={**result.details, "hidden": hidden})


def _seconded(v: Verifier, result: DesignResult) -> DesignResult:
    """Add the second opinion on the optimum, and a word of it to the verdict when it differs."""
    below, optimum = result.details["optimum"]
    # as `verify_level` asks; plant and bound from responses are there already
    low = max(below, LEAST * optimum) * (1 - WIDTH)
    opinion = heard(v, optimum * (1 + WIDTH), low, certain=result.details["certain"])
    status = result.status
    if not opinion.agrees:
        word = "differs" if opinion.decided else "is undecided"
        status = Status(status.word, f"{status.sentence} The second opinion {word}: {opinion.sentence}")
    return replace(result, status=status, details={**result.details, "second_opinion": opinion})


def _agreed(v: Verifier, bracket: Bracket, margin: float, result: DesignResult) -> DesignResult:
    """Search once more by controllers alone where the second opinion has one below the level claimed."""
    if not result.details["second_opinion"].below:
        return result
    found = judged(v, bracket, margin, True)
    if found is None or found.found.achieved >= result.achieved:
        return result
    better = _result(v, bracket, found)
    return _seconded(v, better) if better.status.ok else result


def _conditions(plant: riccati.NormalisedPlant, level: riccati.Level) -> dict[str, float]:
    """Return the condition numbers of X, Y and I - Y X / gamma^2; X or Y may be singular, as where they vanish."""
    matrices = {"X": level.X, "Y": level.Y, "I - YX/g2": np.eye(plant.A.shape[0]) - level.Y @ level.X / level.gamma**2}
    return {name: float(np.linalg.cond(m)) if m.size else 1.0 for name, m in matrices.items()}


def _own_norm(v: Verifier, found: Reached) -> float:
    """Return the gain, at the peak's frequency, of the loop formed in the even units of the synthesis."""
    loop = lft(v.problem.plant, v.problem.even_law(found.controller))
    w = 2 * np.pi * found.f_hz
    if not np.isfinite(w):
        return float(np.linalg.norm(loop.D, 2))
    z = 1j * w if v.P.rate_hz is None else np.exp(1j * w / v.P.rate_hz)
    response = loop.C @ np.linalg.solve(z * np.eye(loop.states) - loop.A, loop.B) + loop.D
    return float(np.linalg.norm(response, 2))


def _sentence(gamma: float | None, reason: str, proven: bool) -> str:
    level = "any level" if gamma is None else f"level {gamma:g}"
    doubt = "" if proven else " as far as the equations tell, which is no proof"
    return f"{WHO}: no controller reaches {level}{doubt}: {reason.rstrip('.')}."
