"""A second opinion on an H-infinity optimum: another theory, other equations, no bilinear map for discrete plants."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import positive, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.design.hinf import discrete_riccati
from ultraquiet.linalg.discretize import bilinear_to_discrete
from ultraquiet.linalg.ordered import Array, Matrices
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace

# Of the poles' mean modulus, mapped to z = 1j; not one, where a single unstable pole would go to infinity.
ASIDE = 4 / 3
WIDTH = 1e-3  # relative distance from the optimum at which the two sides are asked for


class Opinion(NamedTuple):
    """What the second route says of a level.

    `reaches` whether its own controller keeps the loop stable and the norm at `level` (a little above the optimum
    claimed), `norm` what that controller gives, `below` whether it finds a controller a little below as well, and why
    not.
    """

    agrees: bool
    level: float
    reaches: bool
    norm: float
    below: bool
    sentence: str


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
        M = _discrete(P)
    except NumericalError as error:
        return Opinion(False, high, False, float("nan"), False, f"The second route has no say: {error}")
    norm, why_not = _reached(M, ny, nu, high)
    under, why = _reached(M, ny, nu, low)
    reaches, lower = norm <= high * (1 + tolerance), under <= low * (1 + tolerance)
    if not reaches:
        said = f"does not reach {high:.6g}: {why_not or f'its loop has the norm {norm:.6g}'}"
    elif lower:
        said = f"reaches {low:.6g} too: the optimum is lower than claimed"
    else:
        said = f"reaches {high:.6g} with the norm {norm:.6g} and not {low:.6g}: {why or f'its loop gives {under:.6g}'}"
    return Opinion(reaches and not lower, high, reaches, norm, lower, f"Direct discrete synthesis {said.rstrip('.')}.")


def _discrete(P: StateSpace) -> Matrices:
    if P.rate_hz is not None:
        return P.A, P.B, P.C, P.D
    speed = ASIDE * _middle(np.abs(P.poles()))
    return bilinear_to_discrete(P.A / speed, P.B / np.sqrt(speed), P.C / np.sqrt(speed), P.D)


def _middle(size: Array) -> float:
    size = size[size > 0]
    return float(np.exp(np.mean(np.log(size)))) if size.size else 1.0


def _reached(M: Matrices, ny: int, nu: int, level: float) -> tuple[float, str]:
    """Return the norm of the loop with the level's central controller, infinite with the reason when there is none."""
    try:
        K, _ = discrete_riccati.central(M, ny, nu, level)
        return hinf_norm(lft(StateSpace(*M, rate_hz=1.0), StateSpace(*K, rate_hz=1.0)))[0], ""
    except (NumericalError, InputError, np.linalg.LinAlgError) as error:
        return np.inf, str(error)
