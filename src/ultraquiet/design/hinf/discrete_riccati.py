"""H-infinity control directly in discrete time, by two game Riccati equations in z and no bilinear map."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from ultraquiet._base.errors import NumericalError
from ultraquiet.design.hinf.riccati import INDEFINITE, ROUND_OFF, with_direct_term
from ultraquiet.linalg import balance
from ultraquiet.linalg.equations import Riccati, discrete_riccati
from ultraquiet.linalg.ordered import Array, Matrices

EPSILON = 1e-14  # relative error of a product, times which the condition tells the round-off of a solution
REGULAR = 1e9  # condition of R up to which what a cross term leaves of the cost is told from round-off


# Of the poles' mean modulus, mapped to z = 1j; not one, where a single unstable pole would go to infinity.
ASIDE = 4 / 3


class OutOfReachError(NumericalError):
    """An equation was solved, and what it says is that no controller exists."""


def aside(poles: Array) -> float:
    """Return the rad/s that a continuous problem is divided by on its way here, one where every pole is zero."""
    size = np.abs(poles)
    size = size[size > 0]
    return ASIDE * (float(np.exp(np.mean(np.log(size)))) if size.size else 1.0)


class Game(NamedTuple):
    """x+ = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u, y = C2 x + D21 w."""

    A: Array
    B1: Array
    B2: Array
    C1: Array
    C2: Array
    D11: Array
    D12: Array
    D21: Array

    @property
    def dual(self) -> "Game":
        """The transposed problem: measurements become controls."""
        A, B1, B2, C1, C2, D11, D12, D21 = (m.T for m in self)
        return Game(A, C1, C2, B1, B2, D11, D21, D12)


def central(M: Matrices, ny: int, nu: int, gamma: float) -> tuple[Matrices, dict[str, float]]:
    """Return the central controller u = K y of a discrete plant at a level, and the residuals of the equations.

    The first game, over X, turns the problem into one of estimating its best control with r = V (w - w_worst) in the
    place of w; the second, the dual of what is left, has the solution Z = Y (I - X Y)^-1 and leaves a problem whose z
    can be made zero: that is the controller. X and Y that stabilise and are not negative, rho(XY) < 1 (w is scaled by
    gamma) and the right inertia are all that existence asks for.

    Raises:
        NumericalError: no controller reaches the level; the sentence says which equation fails and how.
    """
    plant, into, out, D22 = _scaled(M, ny, nu, gamma)
    state, filtering = _solved(plant, "state-feedback equation X"), _solved(plant.dual, "filter equation Y")
    X, Y = state.X, filtering.X
    coupling = float(np.abs(np.linalg.eigvals(X @ Y)).max()) if X.size else 0.0
    if not coupling < 1:
        raise OutOfReachError(f"the spectral radius of XY is {coupling:.6g} gamma^2")
    left = _without_worst(plant, X, "state-feedback equation X")
    Z = np.linalg.solve(np.eye(X.shape[0]) - Y @ X, Y)
    g = _without_worst(left.dual, (Z + Z.T) / 2, "filter equation Y").dual
    A, B, C, D = _nulling(g)
    K = with_direct_term((A, B @ into, out @ C, out @ D @ into), D22)
    return K, {"X": state.residual, "Y": filtering.residual}


def _nulling(g: Game) -> Matrices:
    """Return the controller that makes z zero where D12 and D21 are square: y tells r, and u answers it."""
    ny, nu, n = g.D21.shape[0], g.D12.shape[1], g.A.shape[0]
    r = np.linalg.solve(g.D21, np.hstack([-g.C2, np.eye(ny)]))
    u = -np.linalg.solve(g.D12, np.hstack([g.C1, np.zeros((nu, ny))]) + g.D11 @ r)
    state = np.hstack([g.A, np.zeros((n, ny))]) + g.B1 @ r + g.B2 @ u
    return state[:, :n], state[:, n:], u[:, :n], u[:, n:]


def _scaled(M: Matrices, ny: int, nu: int, gamma: float) -> tuple[Game, Array, Array, Array]:
    """Return the game at level one in even coordinates, and what brings y in and u out again."""
    A, B, C, D = M
    p, m = D.shape[0] - ny, D.shape[1] - nu
    into = np.diag(1 / _sizes(np.hstack([C[p:], D[p:, :m]])))
    out = np.diag(1 / _sizes(np.vstack([B[:, m:], D[:p, m:]]).T))
    B1, B2, C1, C2 = B[:, :m] / gamma, B[:, m:] @ out, C[:p], into @ C[p:]
    form = balance.modal(A, np.hstack([B1, B2]), np.vstack([C1, C2]))
    D11, D12, D21 = D[:p, :m] / gamma, D[:p, m:] @ out, into @ D[p:, :m] / gamma
    return (
        Game(form.A, form.B[:, :m], form.B[:, m:], form.C[:p], form.C[p:], D11, D12, D21),
        into,
        out,
        D[p:, m:],
    )


def _sizes(rows: Array) -> Array:
    size = np.linalg.norm(rows, axis=1)
    return np.where(size > 0, size, 1.0)


def _solved(g: Game, name: str) -> Riccati:
    """Solve the equation of a game.

    Raises:
        NumericalError: no stabilising solution, or an indefinite one.
    """
    A, (B, R, S), Q = g.A, _cost(g), g.C1.T @ g.C1
    spread = float(np.linalg.cond(R))
    if spread < REGULAR:
        RS = np.linalg.solve(R, S.T)
        if np.linalg.norm(Q - S @ RS) <= max(ROUND_OFF, EPSILON * spread) * np.linalg.norm(Q):
            # the whole cost can be met; what is left of it is round-off, of which X would be made
            A, Q, S = A - B @ RS, np.zeros_like(Q), np.zeros_like(S)
    try:
        riccati = discrete_riccati(A, B, Q, R, S)
    except NumericalError as error:
        raise NumericalError(f"{name}: {error}") from None
    # at unit diagonal, so that neither the units of states nor large entries elsewhere hide what is negative
    d = np.sqrt(np.maximum(np.abs(np.diag(riccati.X)), max(ROUND_OFF * np.sum(g.C1**2), np.finfo(float).tiny)))
    values = np.linalg.eigvalsh(riccati.X / np.outer(d, d)) if riccati.X.size else np.zeros(1)
    if values[0] < -INDEFINITE:
        raise OutOfReachError(f"{name}: its solution is indefinite, smallest eigenvalue {values[0]:.2e}")
    return riccati


def _without_worst(g: Game, X: Array, name: str) -> Game:
    """Return the game in r and v, |z|^2 - |w|^2 + x+'X x+ - x'X x = |v|^2 - |r|^2.

    r = V11 (w - F1 x), v = V21 (w - F1 x) + V22 (u - F2 x), where w = F1 x is the worst and u = F2 x the best.

    Raises:
        NumericalError: the inertia is wrong, w gains more than one.
    """
    m = g.B1.shape[1]
    B, R, S = _cost(g)
    R = R + B.T @ X @ B
    V11, V21, V22 = _inertia(R, m, name)
    F = -np.linalg.solve(R, S.T + B.T @ X @ g.A)
    B1, D11, D21 = (solve_triangular(V11, k.T, trans=1).T for k in (g.B1, V21, g.D21))
    return Game(g.A + g.B1 @ F[:m], B1, g.B2, -V22 @ F[m:], g.C2 + g.D21 @ F[:m], D11, V22, D21)


def _cost(g: Game) -> tuple[Array, Array, Array]:
    """Return B, R and S of the cost |z|^2 - |w|^2."""
    m = g.B1.shape[1]
    D = np.hstack([g.D11, g.D12])
    R = D.T @ D
    R[:m, :m] -= np.eye(m)
    return np.hstack([g.B1, g.B2]), R, g.C1.T @ D


def _inertia(R: Array, m: int, name: str) -> tuple[Array, Array, Array]:
    """Return V11, V21, V22 with R = [V21 V22]'[V21 V22] - [V11 0]'[V11 0].

    Raises:
        NumericalError: R does not have m negative and otherwise positive eigenvalues in this order.
    """
    try:
        V22 = cholesky(R[m:, m:])
        V21 = solve_triangular(V22, R[m:, :m], trans=1)
        V11 = cholesky(V21.T @ V21 - R[:m, :m])
    except LinAlgError:
        raise OutOfReachError(f"{name}: the direct terms seen by its solution let some w through") from None
    return V11, V21, V22
