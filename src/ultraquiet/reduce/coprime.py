"""Reduction of stable coprime factors: for controllers that are unstable by themselves."""

from dataclasses import asdict, dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from ultraquiet._base.constraints import FloatArray, one_of, real_array, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.linalg import balance
from ultraquiet.linalg.equations import continuous_riccati, discrete_riccati, lyapunov, stein
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.reduce._abstract import METHODS, ReductionResult, Weights, counted, project, renamed
from ultraquiet.reduce.certificate import certified, fits, judging_plant, kept_promise
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

SIDES = ("left", "right")


@register("reduce", "coprime-factors")
@dataclass(frozen=True)
class CoprimeFactors:
    """Reduce the normalised left coprime factors of a controller, K = M^-1 N, N N~ + M M~ = I.

    Both factors are stable however unstable K is, so unstable states may go as well. The error is measured in the gap:
    || [N - Nr, M - Mr] || <= 2 (s_r+1 + ... + s_n), and a loop whose generalised stability margin is larger than that
    stays stable.

    Args:
        states: states to keep; the fewest that leave out a hundredth of the factors when absent.
        method: `truncation`, or `perturbation` (exact at 0 Hz).

    >>> K = StateSpace([[0.5, 0.0], [0.0, -9.0]], [[1.0], [1.0]], [[-2.0, 0.01]], [[0.0]])
    >>> result = CoprimeFactors(states=1).reduce(K)
    >>> result.controller.is_stable(), result.details["gap_bound"] < 1e-3
    (False, True)

    McFarlane and Glover 1990, chapter 5; Vidyasagar 1988, doi:10.1109/9.1260 .
    """

    states: int | None = None
    method: str = "truncation"

    def __post_init__(self) -> None:
        if self.states is not None:
            whole("CoprimeFactors", "states", self.states, 0)
        one_of("CoprimeFactors", "method", self.method, METHODS)

    @takes_systems
    @single_threaded
    def reduce(
        self, controller: StateSpace, plant: StateSpace | None = None, weights: Weights = None
    ) -> ReductionResult:
        """Return the reduced controller; with a plant the loop is looked at afterwards.

        `details["gap_bound"]` bounds the H-infinity norm of the error of the factors.
        """
        if plant is not None:
            fits("CoprimeFactors", controller, plant)
        discrete = controller.rate_hz is not None
        factors = normalised_left(controller)
        P, Q = balance.gramians(*factors[:3], discrete)
        keep = counted(self.states, 0, controller.states, lambda: balance.balancing(P, Q, 0)[2])
        (a, b, c, d), hankel = project(factors, P, Q, keep, discrete, self.method)
        provenance = Provenance("CoprimeFactors", asdict(self), parents=(controller.hash,), versions=versions())
        small = renamed(quotient((a, b, c, d), controller.D.shape[1]), controller, provenance)
        P_loop = None if plant is None else judging_plant(plant, weights)
        result = certified(controller, small, hankel, P=P_loop, details={"gap_bound": 2 * float(np.sum(hankel[keep:]))})
        return kept_promise(result, controller, plant)


def normalised_left(K: StateSpace) -> Matrices:
    """Return the stable system [N, M] of the normalised left coprime factors K = M^-1 N.

    Continuous: R = I + D D', H = -(B D' + Z C') R^-1; discrete: R = I + D D' + C Z C', H = -(B D' + A Z C') R^-1.
    """
    A, B, C, D = K.A, K.B, K.C, K.D
    R = np.eye(D.shape[0]) + D @ D.T
    if K.rate_hz is None:
        RC = np.linalg.solve(R, C)
        inner = np.eye(D.shape[1]) - D.T @ np.linalg.solve(R, D)
        Z = continuous_riccati((A - B @ D.T @ RC).T, C.T @ RC, B @ inner @ B.T).X
        H = -np.linalg.solve(R, (B @ D.T + Z @ C.T).T).T
    else:
        Z = discrete_riccati(A.T, C.T, B @ B.T, R, B @ D.T).X
        R = R + C @ Z @ C.T
        H = -np.linalg.solve(R, (B @ D.T + A @ Z @ C.T).T).T
    root = cholesky(R, lower=True)
    outer = solve_triangular(root, np.hstack([C, D, np.eye(D.shape[0])]), lower=True)
    n = K.states
    return A + H @ C, np.hstack([B + H @ D, H]), outer[:, :n], outer[:, n:]


def quotient(factors: Matrices, inputs: int) -> Matrices:
    """Return M^-1 N of the factors [N, M], N first with `inputs` columns."""
    A, B, C, D = factors
    N, M = slice(None, inputs), slice(inputs, None)
    CD = np.linalg.solve(D[:, M], np.hstack([C, D[:, N]]))
    C, DN = CD[:, : A.shape[0]], CD[:, A.shape[0] :]
    return A - B[:, M] @ C, B[:, N] - B[:, M] @ DN, C, DN


def reduce_observer_based(
    plant: StateSpace, F: FloatArray, L: FloatArray, states: int, side: str = "left", *, weighted: bool = False
) -> tuple[StateSpace, FloatArray]:
    """Reduce the coprime factors of u = F x', x'+ = A x' + B u - L (y - C x' - D u), an observer with state feedback.

    Left: K = (I - V)^-1 U, [U, V] = F (sI - A - L C)^-1 [-L, B + L D]. Right: the dual, with A + B F.

    Args:
        plant: A, B, C, D.
        F: state feedback `(nu, n)`, A + B F stable.
        L: observer gain `(n, ny)`, A + L C stable.
        states: to keep.
        side: `left` or `right` factors.
        weighted: weigh the factors' error by the loop, to first order: the Gramians of A + B F and of A + L C mix.

    Returns:
        The reduced controller u = K y and the Hankel values.

    Raises:
        InputError: gains that do not fit or do not stabilise.

    Liu, Anderson and Ly 1990, doi:10.1016/0005-1098(90)90001-X; SLICOT SB16BD and SB16CD do
    the same for u = -K y; in SB16BD the sign of V is turned, so that its left controllers are other ones.
    """
    who = "reduce_observer_based"
    one_of(who, "side", side, SIDES)
    whole(who, "states", states, 0)
    F, L = real_array(who, "F", F, 2), real_array(who, "L", L, 2)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    if (F.shape, L.shape) != (B.T.shape, C.T.shape):
        raise InputError(f"{who}: F is {F.shape} and L {L.shape}, the plant wants {B.T.shape} and {C.T.shape}.")
    for name, closed in (("A + B F", A + B @ F), ("A + L C", A + L @ C)):
        if not StateSpace(closed, B, C, D, plant.rate_hz).is_stable():
            raise InputError(f"{who}: {name} is unstable; give a stabilising gain.")
    discrete = plant.rate_hz is not None
    solve = stein if discrete else lyapunov
    drive, seen = np.hstack([-L, B + L @ D]), np.vstack([F, C + D @ F])
    nu, ny = F.shape[0], L.shape[1]
    if side == "left":
        factors: Matrices = (A + L @ C, drive, F, np.hstack([np.zeros((nu, ny)), -np.eye(nu)]))
        P = solve(A + B @ F, B @ B.T) if weighted else solve(A + L @ C, drive @ drive.T)
        Q = solve((A + L @ C).T, F.T @ F)
    else:
        factors = (A + B @ F, -L, seen, np.vstack([np.zeros((nu, ny)), np.eye(ny)]))
        P = solve(A + B @ F, L @ L.T)
        Q = solve((A + L @ C).T, C.T @ C) if weighted else solve((A + B @ F).T, seen.T @ seen)
    (a, b, c, _), hankel = project(factors, P, Q, states, discrete, "truncation")
    if side == "left":
        a, b = a + b[:, ny:] @ c, b[:, :ny]
    else:
        a, c = a - b @ c[nu:], c[:nu]
    return StateSpace(a, b, c, np.zeros((nu, ny)), plant.rate_hz), hankel
