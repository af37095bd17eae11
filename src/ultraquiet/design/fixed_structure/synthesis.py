"""Fixed-order H-infinity synthesis for any generalised plant."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.design.fixed_structure.minimax import bfgs, lowest
from ultraquiet.design.fixed_structure.problem import Requirement, TuningProblem
from ultraquiet.design.hinf.problem.units import even_problem
from ultraquiet.design.hinf.synthesis import synthesize_hinf
from ultraquiet.design.law_structure.controller_structure import ControllerStructure, one_element
from ultraquiet.design.law_structure.elements import Dense, StablePairs
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.verification import judged
from ultraquiet.linalg import balance
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace

STEPS, ROUNDS = 200, 4
# The last descent is on the exact norm, for plants of up to so many states. Where peaks level off it learns their kink
# step by step, with little to show for each.
EXACTLY, DESCENTS, PATIENCE, STAGNANT = 60, 500, 40, 1e-6
LOUDER = (0.0, 1.0, 0.0, 2.0, -1.0)  # decades by which random constant gains differ, one after the other


@dataclass(frozen=True)
class _Settings(StatedRobustness):
    states: int
    stable: bool
    starts: int
    seed: int


@takes_systems
@single_threaded
def synthesize_structured(
    P: StateSpace,
    measurements: int,
    controls: int,
    states: int = 0,
    stable: bool = False,
    starts: int = 5,
    seed: int = 0,
    structure: ControllerStructure | None = None,
) -> DesignResult:
    """Return a controller of given order that makes the H-infinity norm of F(P, K) small.

    min over K of order n of ||P11 + P12 K (I - P22 K)^-1 P21||, K stable when asked.

    Args:
        P: generalised plant, inputs (w, u), outputs (z, y), continuous or discrete.
        measurements: size of y.
        controls: size of u.
        states: order of K; 0 is a constant gain.
        stable: whether K itself must be stable.
        starts: points the search begins at: the full-order law cut down, and random ones.
        seed: of the random ones.
        structure: of the controller, in place of one whose every entry is free.

    Returns:
        A `DesignResult`: `gamma` the level on the refined grid, `achieved` the exact norm of the finished loop,
        `details["optimum"]` the least norm of any order and `details["ratio"]` achieved over it (nan where that
        problem is singular, one where both are zero). The problem is not convex: the result is a local minimum, the
        best of those found.

    Raises:
        InputError: sizes that do not fit.

    >>> A, B = -np.eye(2), [[0, 0, 1], [0, 1, 1]]
    >>> C, D = [[1, 0], [0, 1], [1, 1]], [[0.5, 0, 0], [0, 0.5, 1], [0, 1, 0]]
    >>> result = synthesize_structured(StateSpace(A, B, C, D), measurements=1, controls=1, states=0)
    >>> result.status.ok, round(result.achieved, 3)  # sqrt(0.65), the optimum over all orders
    (True, 0.806)

    Apkarian and Noll 2006, doi:10.1109/TAC.2005.860290.
    """
    who = "synthesize_structured"
    ny = whole(who, "measurements", measurements, 1, P.D.shape[0] - 1)
    nu = whole(who, "controls", controls, 1, P.D.shape[1] - 1)
    n = whole(who, "states", states, 0)
    rng = np.random.default_rng(whole(who, "seed", seed, 0))
    given, problem_units = P, even_problem(P, ny, nu)
    if structure is None:  # of one whose every entry is free, units of u and y can be chosen
        P = problem_units.plant
    plant = StateSpace(P.A, P.B[:, -nu:], P.C[-ny:], P.D[-ny:, -nu:], P.rate_hz)
    element = StablePairs(n, nu, ny, np.ones(n)) if stable else Dense(n, nu, ny)
    law = structure or one_element(element)
    norm = Requirement("norm", slice(0, P.D.shape[0] - ny))
    problem = TuningProblem(P, plant, law, (norm,), stable_law=stable)
    full, optimum = _full_order(P, ny, nu)
    points = [law.start(rng, problem.low / 3, 3 * problem.high) for _ in range(whole(who, "starts", starts, 1))]
    if structure is None and not n:  # the plant's units say nothing of how high a constant gain is to be
        points = [10 ** LOUDER[k % len(LOUDER)] * point for k, point in enumerate(points)]
    if full is not None and structure is None and not stable:
        points = [_cut(problem, full, n), *([] if n else _gains_of(problem, full)), *points]
    exact = _ExactNorm(P, problem)
    polish = exact.descended if P.states + n <= EXACTLY else None
    lowest_point = lowest(problem, points, STEPS, ROUNDS, exact.value, polish)
    if lowest_point is None:
        return refused(f"{who}: no start gave a stable loop with {n} states; allow more states or starts.")
    theta, level = lowest_point
    K = law.law(theta, problem.plane)
    if structure is None:
        K, level, optimum = problem_units.law(K), level / problem_units.level, optimum / problem_units.level
        plant = StateSpace(given.A, given.B[:, -nu:], given.C[-ny:], given.D[-ny:, -nu:], given.rate_hz)
    achieved = hinf_norm(lft(given, K))[0]
    details = {"optimum": optimum, "ratio": _ratio(achieved, optimum), "theta": theta, "points": problem.samples.w.size}
    return judged(plant, K, _Settings(n, stable, starts, seed), level, achieved, {}, details)


class _ExactNorm:
    """The norm of the finished loop and its gradient, that of the gain at the peak's own frequency.

    A grid that grows as a search finds its gaps is another function at every step, which no descent gets to the
    bottom of.
    """

    def __init__(self, P: StateSpace, problem: TuningProblem) -> None:
        self._P, self._problem = P, problem
        self._at: tuple[bytes, float] | None = None  # parameters last measured, and where their peak is

    def value(self, theta: FloatArray, ceiling: float = np.inf) -> float:
        """Return the norm, or infinity when the loop is unstable; the ceiling saves nothing."""
        del ceiling
        if not (np.all(np.isfinite(theta)) and self._problem.stability(theta) < 0):
            return np.inf
        try:
            loop = lft(self._P, self._problem.structure.law(theta, self._problem.plane))
            norm, f_hz = hinf_norm(loop) if loop.is_stable() else (np.inf, 0.0)
        except (np.linalg.LinAlgError, UltraquietError):
            return np.inf
        self._at = theta.tobytes(), f_hz
        return norm

    def gradient(self, theta: FloatArray) -> FloatArray:
        """Return the gradient; zero where there is no norm."""
        if (self._at is None or self._at[0] != theta.tobytes()) and not np.isfinite(self.value(theta)):
            return np.zeros(theta.size)
        assert self._at is not None
        return self._problem.slope_at(theta, self._at[1])

    def descended(self, theta: FloatArray) -> FloatArray:
        """Return parameters further down."""
        return bfgs(self.value, self.gradient, theta, DESCENTS, PATIENCE, STAGNANT)[0]


def _ratio(achieved: float, optimum: float) -> float:
    if optimum == 0:
        return 1.0 if achieved == 0 else float("inf")
    return achieved / optimum


def _full_order(P: StateSpace, ny: int, nu: int) -> tuple[StateSpace | None, float]:
    """Return the law of full order and the smallest norm it proves; nothing where the problem is singular."""
    try:
        result = synthesize_hinf(P, ny, nu, regularise=True)
    except UltraquietError:
        return None, float("nan")
    return (result.controller, float(result.details["optimum"][1])) if result.controller else (None, float("nan"))


def _gains_of(problem: TuningProblem, law: StateSpace) -> list[np.ndarray]:
    """Return what a law of full order does at rest and at the plant's slowest, middle and fastest pole, as gains."""
    A, B, C, D = problem.plane.to_plane(law)
    one = np.eye(A.shape[0])
    found = []
    for w in (0.0, problem.low, float(np.sqrt(problem.low * problem.high)), problem.high):
        try:
            gain = (D + C @ np.linalg.solve(1j * w * one - A, B)).real
        except np.linalg.LinAlgError:
            continue
        if np.all(np.isfinite(gain)):
            found.append(gain.ravel())
    return found


def _cut(problem: TuningProblem, law: StateSpace, states: int) -> np.ndarray:
    """Return the parameters of a law of full order in modal coordinates, its least important states left out.

    Where more states are asked for than it has, the others hear and say nothing: C is zero there, B is not, so that a
    descent can begin to use them.
    """
    A, B, C, D = problem.plane.to_plane(law)
    form = balance.modal(A, B, C)
    size = np.linalg.norm(form.B, axis=1) * np.linalg.norm(form.C, axis=0)
    edges = np.concatenate([[0], np.cumsum(form.blocks)]).astype(int)
    order = sorted(range(len(form.blocks)), key=lambda k: -size[edges[k] : edges[k + 1]].max())
    keep = [i for k in order for i in range(edges[k], edges[k + 1])][:states]
    idle = np.geomspace(problem.low, problem.high, max(states - len(keep), 0))
    heard = np.sqrt(idle)[:, None] * np.eye(B.shape[1])[np.arange(idle.size) % B.shape[1]]
    A, B = block_diag(form.A[np.ix_(keep, keep)], -np.diag(idle)), np.vstack([form.B[keep], heard])
    C = np.hstack([form.C[:, keep], np.zeros((C.shape[0], idle.size))])
    return np.block([[A, B], [C, D]]).ravel()
