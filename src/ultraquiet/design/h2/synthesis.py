"""H2 synthesis for a given generalised plant."""

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import NumericalError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import h2_norm
from ultraquiet.design.h2.riccati import H2Problem, solve
from ultraquiet.design.result import DesignResult, is_stable, refused
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

AGREEMENT = 1e-3  # promised and achieved norm must agree this well


@takes_systems
@single_threaded
def synthesize_h2(P: StateSpace, measurements: int, controls: int) -> DesignResult:
    """Return the controller that minimises the H2 norm of a closed loop.

    min over K of ||F(P, K)||_2, u = K y.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y), continuous or discrete.
        measurements: number of last outputs y.
        controls: number of last inputs u.

    Returns:
        A `DesignResult`: `gamma` is the norm that the two Riccati equations promise, `achieved` the H2 norm of the
        finished loop.

    Raises:
        InputError: sizes that do not fit the plant.

    gamma is the standard deviation of z for white w of unit variance.

    >>> P = StateSpace([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> result = synthesize_h2(P, measurements=1, controls=1)
    >>> abs(result.gamma / result.achieved - 1) < 1e-9
    True

    Doyle, Glover, Khargonekar and Francis 1989, doi:10.1109/9.29425.
    """
    ny = whole("synthesize_h2", "measurements", measurements, 1, P.D.shape[0] - 1)
    nu = whole("synthesize_h2", "controls", controls, 1, P.D.shape[1] - 1)
    try:
        solution = solve(H2Problem.of(P, ny, nu), P.rate_hz is not None)
    except NumericalError as error:
        return refused(str(error))
    settings = {"measurements": ny, "controls": nu}
    provenance = Provenance("synthesize_h2", settings, parents=(P.hash,), versions=versions())
    K = StateSpace(*solution.controller(), rate_hz=P.rate_hz, provenance=provenance)
    loop = lft(P, K)
    poles = loop.poles()
    promised, achieved = solution.cost(), h2_norm(loop)
    if not is_stable(poles, P.rate_hz) or not solution.agrees(achieved, AGREEMENT):
        return refused(f"H2 synthesis: promised {promised:.6g}, achieved {achieved:.6g}; scale the plant.")
    status = Status(StatusWord.OK, f"The loop is stable and its H2 norm is {achieved:.5g}.")
    return DesignResult(status, K, promised, achieved, poles, residuals=solution.residuals, provenance=provenance)
