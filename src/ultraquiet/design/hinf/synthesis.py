"""H-infinity synthesis for a given generalised plant."""

from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from ultraquiet._base.constraints import positive, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.design.hinf import riccati
from ultraquiet.design.hinf.assumptions import WHO, out_of_reach, zeros_on_boundary
from ultraquiet.design.hinf.gamma_search import Bracket, at_level, search
from ultraquiet.design.hinf.verification import verify_level
from ultraquiet.design.result import DesignResult, is_stable, refused
from ultraquiet.linalg.discretize import bilinear_to_continuous, bilinear_to_discrete
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

FINEST = 1e-5  # relative width of the bracket around the optimum
COARSENESS = 0.05  # the bracket is this share of the margin wide: a controller at 1.05 needs no optimum to six digits
# Factors over the asked level that are tried in turn until the verified loop is stable and keeps its level.
BACK_OFF = (1.0, 1.0005, 1.002, 1.005, 1.02, 1.05, 1.1, 1.2, 2.0)
FASTEST = 1e12  # stands for infinite frequency, in units of the plant's own speed
SMALL = 40  # states up to which the second opinion comes without asking
LEAST = 0.5  # of the optimum: lowest level the second opinion is asked about
AGREEMENT = 1e-3  # reported and achieved norm must agree this well


@single_threaded
def synthesize_hinf(
    P: StateSpace,
    measurements: int,
    controls: int,
    gamma: float | None = None,
    margin: float = 1.00003,
    second_opinion: bool | None = None,
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

    Returns:
        A `DesignResult`: `gamma` is the norm that the returned controller gives in the coordinates of the synthesis,
        `achieved` the norm of F(P, K) computed again in the units of P; `details` holds `optimum`, the bracket of the
        smallest level, `below`, why levels under it fail, `certain`, the level that frequency responses alone prove
        out of reach, `bound`, the level of the equations solved, their `conditions`, and `second_opinion`. Without a
        solution the status is `refused`, its sentence names the block at fault, and there is no controller.

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
    if not positive(who, "margin", margin) >= 1:
        raise InputError(f"{who}: 'margin' must be at least one, got {margin:g}.")
    sentence = out_of_reach(P, ny, nu)
    if sentence:
        return refused(sentence)
    try:
        plant = riccati.normalise(_continuous(P), ny, nu)
        sentence = zeros_on_boundary(plant, P.rate_hz)
        if sentence:
            return refused(sentence)
        bracket = (
            search(plant, max(FINEST, COARSENESS * (margin - 1)))
            if gamma is None
            else at_level(plant, positive(who, "gamma", gamma))
        )
        if bracket.best.reason:
            return refused(_sentence(gamma, bracket.best.reason))
        # a level that was asked for is kept or refused, the search's own may be left for a safer one
        factors = [margin * f for f in BACK_OFF] if gamma is None else [1.0]
        result = _form(P, plant, bracket, ny, nu, factors)
        wanted = P.states <= SMALL if second_opinion is None else second_opinion
        compared = wanted and gamma is None and result.status.ok and not bracket.is_zero
        return _seconded(P, result, bracket) if compared else result
    except NumericalError as error:
        return refused(str(error))


def _continuous(P: StateSpace) -> riccati.Matrices:
    M = (P.A, P.B, P.C, P.D)
    return M if P.rate_hz is None else bilinear_to_continuous(*M)


def _seconded(P: StateSpace, result: DesignResult, bracket: Bracket) -> DesignResult:
    """Add the second opinion on the optimum, and a word of it to the verdict when it differs."""
    settings = result.provenance.settings
    ny, nu = int(settings["measurements"]), int(settings["controls"])
    low = max(bracket.below, LEAST * bracket.best.gamma)
    opinion = verify_level(P, ny, nu, bracket.best.gamma, below=low)
    status = result.status
    if not opinion.agrees:
        status = Status(status.word, f"{status.sentence} The second opinion differs: {opinion.sentence}")
    return replace(result, status=status, details={**result.details, "second_opinion": opinion})


def _form(
    P: StateSpace, plant: riccati.NormalisedPlant, bracket: Bracket, ny: int, nu: int, factors: list[float]
) -> DesignResult:
    """Form, restore and verify controllers, first at the asked margin, then further from the optimum."""
    sentence = ""
    for factor in factors:
        level = riccati.attempt(plant, bracket.best.gamma * factor) if factor > 1 else bracket.best
        if level.reason:
            sentence = level.reason
            continue
        try:
            result = _verified(P, plant, level, bracket, ny, nu)
        except (NumericalError, InputError, LinAlgError) as error:
            sentence = str(error)
            continue
        if result.status.ok:
            return result
        sentence = result.status.sentence
    return refused(f"{WHO}: no controller passed its verification; the last try: {sentence}")


def _verified(
    P: StateSpace, plant: riccati.NormalisedPlant, level: riccati.Level, bracket: Bracket, ny: int, nu: int
) -> DesignResult:
    M = riccati.central(plant, level)
    K = M if P.rate_hz is None else bilinear_to_discrete(*M)
    settings = {"measurements": ny, "controls": nu, "bound": level.gamma}
    provenance = Provenance("synthesize_hinf", settings, parents=(P.hash,), versions=versions())
    controller = StateSpace(*K, rate_hz=P.rate_hz, provenance=provenance)
    loop = lft(P, controller)
    poles = loop.poles()
    if not is_stable(poles, P.rate_hz):
        return refused(f"the loop at level {level.gamma:.6g} is unstable")
    achieved, f_hz = hinf_norm(loop)
    gamma = _own_norm(plant, M, _normalised_frequency(plant, f_hz, P.rate_hz))
    difference = abs(achieved - gamma)
    if not (difference <= AGREEMENT * max(achieved, bracket.nought) and achieved <= level.gamma * (1 + AGREEMENT)):
        return refused(f"reported {gamma:.6g}, achieved {achieved:.6g} at level {level.gamma:.6g}")
    details = {
        "bound": level.gamma,
        "optimum": (bracket.below, bracket.best.gamma),
        "below": bracket.reason,
        "certain": bracket.certain,
        "probes": bracket.probes,
        "achieved_hz": f_hz,
        "coupling": level.coupling,
        "conditions": _conditions(plant, level),
    }
    status = Status(
        StatusWord.OK, f"The loop is stable and its norm is {achieved:.5g}, at most {level.gamma:.5g} as designed."
    )
    residuals = {"X": level.residuals[0], "Y": level.residuals[1]}
    return DesignResult(
        status, controller, gamma, achieved, poles, residuals=residuals, details=details, provenance=provenance
    )


def _conditions(plant: riccati.NormalisedPlant, level: riccati.Level) -> dict[str, float]:
    """Return the condition numbers of X, Y and I - Y X / gamma^2; X or Y may be singular, as where they vanish."""
    matrices = {"X": level.X, "Y": level.Y, "I - YX/g2": np.eye(plant.A.shape[0]) - level.Y @ level.X / level.gamma**2}
    return {name: float(np.linalg.cond(m)) if m.size else 1.0 for name, m in matrices.items()}


def _own_norm(plant: riccati.NormalisedPlant, controller: riccati.Matrices, w: float) -> float:
    """Return the gain, at the peak's frequency, of the loop formed in the normalised coordinates of the synthesis."""
    D12, D21 = riccati.direct_terms(plant)
    P = StateSpace(
        plant.A,
        np.hstack([plant.B1, plant.B2]),
        np.vstack([plant.C1, plant.C2]),
        np.block([[plant.D11, D12], [D21, np.zeros((D21.shape[0], D12.shape[1]))]]),
    )
    loop = lft(P, StateSpace(*riccati.normalised_controller(plant, controller)))
    response = loop.C @ np.linalg.solve(1j * w * np.eye(loop.states) - loop.A, loop.B) + loop.D
    return float(np.linalg.norm(response, 2))


def _normalised_frequency(plant: riccati.NormalisedPlant, f_hz: float, rate_hz: float | None) -> float:
    w = 2 * np.pi * f_hz if rate_hz is None else np.tan(np.pi * f_hz / rate_hz)
    return min(float(w) / plant.speed, FASTEST)


def _sentence(gamma: float | None, reason: str) -> str:
    level = "any level" if gamma is None else f"level {gamma:g}"
    return f"{WHO}: no controller reaches {level}: {reason.rstrip('.')}."
