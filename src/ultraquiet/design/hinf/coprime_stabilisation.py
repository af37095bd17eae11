"""Robust stabilisation of normalised coprime factors: continuous and discrete directly.

McFarlane and Glover 1992 (doi:10.1109/9.256330); discrete: Gu, Petkov and Konstantinov, On discrete H-infinity loop
shaping design procedure routines, 2000.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.equations import continuous_riccati, discrete_riccati
from ultraquiet.linalg.even import evened
from ultraquiet.linalg.ordered import Array, Matrices
from ultraquiet.values.state_space import StateSpace

OPTIMAL = 1e-6  # a margin nearer to one than this asks for the optimal controller
# Singular values of the optimum's descriptor matrix below this share of its terms are zero; each costs a state.
DESCRIPTOR_RANK = 1e-9


class Stabiliser(NamedTuple):
    """A controller u = K y with what it rests on.

    `gamma_min` is the smallest norm any controller reaches, `X` and `Z` the solutions of the two equations, `residuals`
    theirs, `feedback` and `injection` the gains of the observer form, `innovation` the square root of R (plus C Z C' in
    discrete time), `conditions` reciprocal condition numbers (1-norm) of the matrices that are inverted, by name.
    """

    controller: Matrices
    gamma_min: float
    X: Array
    Z: Array
    residuals: tuple[float, float]
    feedback: Array
    injection: Array
    innovation: Array
    conditions: dict[str, float]


def smallest_level(M: Matrices, discrete: bool) -> tuple[float, Array, Array, tuple[float, float]]:
    """Return sqrt(1 + rho(X Z)), X, Z and both relative residuals.

    Continuous: Ar' X + X Ar - X B S^-1 B' X + C' R^-1 C = 0 and its dual, Ar = A - B S^-1 D' C, R = I + D D',
    S = I + D' D; discrete: the equations of the same coefficients.

    Raises:
        NumericalError: an unstable mode that cannot be stabilised or seen.
    """
    A, B, C, D = M
    R, S = np.eye(D.shape[0]) + D @ D.T, np.eye(D.shape[1]) + D.T @ D
    Ar = A - B @ np.linalg.solve(S, D.T @ C)
    cost, drive = _symmetric(C.T @ np.linalg.solve(R, C)), _symmetric(B @ np.linalg.solve(S, B.T))
    if discrete:
        x, z = discrete_riccati(Ar, B, cost, S), discrete_riccati(Ar.T, C.T, drive, R)
    else:
        x, z = continuous_riccati(Ar, drive, cost), continuous_riccati(Ar.T, cost, drive)
    largest = float(np.linalg.eigvals(x.X @ z.X).real.max()) if A.size else 0.0
    return float(np.sqrt(1 + max(largest, 0.0))), x.X, z.X, (x.residual, z.residual)


def smallest_norm(plant: StateSpace) -> float | None:
    """Return the smallest norm of [I; K] (I - G K)^-1 [G, I] that any law reaches; None where no equation tells it.

    [G, I] = M^-1 [N, M] with [N, M] co-inner: the norm is that of [I; K] (I - G K)^-1 M^-1, of which the smallest is
    known without a search, sqrt(1 + rho(X Z)).

    Args:
        plant: G, continuous or discrete.

    Glover and McFarlane 1989, doi:10.1109/9.29404, theorem 4.3.
    """
    try:
        level = smallest_level(_even(plant), plant.rate_hz is not None)[0]
    except (NumericalError, LinAlgError):
        return None
    return level if np.isfinite(level) else None


def central_law(plant: StateSpace, margin: float) -> StateSpace | None:
    """Return the central law at margin times that norm, as the formulas give it; None where they give none.

    Nothing of it is verified.

    Args:
        plant: G, continuous or discrete.
        margin: over the smallest norm.
    """
    stabilised = continuous if plant.rate_hz is None else discrete
    try:
        matrices = stabilised(_even(plant), margin).controller
    except (NumericalError, LinAlgError):
        return None
    return StateSpace(*matrices, rate_hz=plant.rate_hz) if all(np.isfinite(m).all() for m in matrices) else None


def continuous(M: Matrices, margin: float) -> Stabiliser:
    """Return the central controller at margin times the smallest level, in continuous time.

    At margin one it is the optimal one, which has fewer states than the plant. States should be scaled evenly.
    """
    A, B, C, D = M
    gamma_min, X, Z, residuals = smallest_level(M, discrete=False)
    gamma2 = (margin * gamma_min) ** 2
    R, S = np.eye(D.shape[0]) + D @ D.T, np.eye(D.shape[1]) + D.T @ D
    E = (1 - gamma2) * np.eye(A.shape[0]) + Z @ X
    F = -np.linalg.solve(S, D.T @ C + B.T @ X)
    injection = -np.linalg.solve(R, D @ B.T + C @ Z).T
    if margin - 1 < OPTIMAL:
        law = _regular(E, gamma2, (E @ (A + B @ F) + gamma2 * Z @ C.T @ (C + D @ F), gamma2 * Z @ C.T, B.T @ X, -D.T))
        feedback = np.zeros((D.shape[1], 0))
    else:
        feedback = gamma2 * np.linalg.solve(E.T, X @ B).T
        law = _observer(M, feedback, injection, -D.T)
    return Stabiliser(law, gamma_min, X, Z, residuals, feedback, injection, _root(R), {"E": _rcond(E)})


def discrete(M: Matrices, margin: float) -> Stabiliser:
    """Return the central controller at margin times the smallest level, in discrete time, with a direct term.

    Raises:
        NumericalError: margin one, where the matrices of the discrete formulas are singular.
    """
    if margin - 1 < OPTIMAL:
        raise NumericalError("loop shaping: the discrete formulas are singular at the smallest level; raise 'margin'.")
    A, B, C, D = M
    gamma_min, P, Q, residuals = smallest_level(M, discrete=True)
    gamma2 = (margin * gamma_min) ** 2
    n, (ny, nu) = A.shape[0], D.shape
    R1, R2 = np.eye(ny) + D @ D.T, np.eye(nu) + D.T @ D
    seen = _symmetric(R1 + C @ Q @ C.T)
    H = -np.linalg.solve(seen, C @ Q @ A.T + D @ B.T).T
    W = (gamma2 - 1) * np.eye(n) - P @ Q
    X = _symmetric(np.linalg.solve(W, gamma2 * P))
    root, left, right = _root(seen), _root(np.linalg.inv(R1)), _root(np.linalg.inv(R2))
    Rx = np.block([[seen - gamma2 * np.eye(ny), root @ left @ D], [(root @ left @ D).T, np.eye(nu)]])
    Bx, Sx = np.hstack([-H @ root, B @ right]), np.hstack([C.T @ root, C.T @ left @ D])
    inner = Rx + Bx.T @ X @ Bx
    F = -np.linalg.solve(inner, Sx.T + Bx.T @ X @ A)
    direct = -np.linalg.solve(R2 + B.T @ X @ B, D.T - B.T @ X @ H)
    feedback = right @ F[ny:] - direct @ (C + root @ F[:ny])
    conditions = {"W": _rcond(W), "inner": _rcond(inner)}
    conditions["outputs"], conditions["inputs"] = _rcond(np.eye(ny) + D @ direct), _rcond(np.eye(nu) + direct @ D)
    law = _closed(M, (A + H @ C + B @ feedback, B @ direct - H, feedback, direct))
    return Stabiliser(law, gamma_min, P, Q, residuals, feedback, H, root, conditions)


def _even(plant: StateSpace) -> Matrices:
    return (*evened(plant.A, plant.B, plant.C), plant.D)


def _observer(M: Matrices, F: Array, H: Array, direct: Array) -> Matrices:
    """Return the law x' = A x + B u + H (C x + D u - y), u = F x + direct y."""
    A, B, C, D = M
    BH = B + H @ D
    return A + H @ C + BH @ F, BH @ direct - H, F, direct


def _closed(M: Matrices, law: Matrices) -> Matrices:
    """Return the law for y with the plant's direct term, from that for y - D u."""
    D = M[3]
    A, B, C, direct = law
    wrap = np.eye(D.shape[1]) + direct @ D
    CD = np.linalg.solve(wrap, np.hstack([C, direct]))
    n = A.shape[0]
    return A - B @ D @ CD[:, :n], B - B @ D @ CD[:, n:], CD[:, :n], CD[:, n:]


def _regular(E: Array, size: float, pencil: Matrices) -> Matrices:
    """Return E x' = A x + B y, u = C x + D y as a system of rank(E) states; the others are in a steady state.

    `size` is that of the terms whose difference E is: E may vanish as a whole.
    """
    A, B, C, D = pencil
    U, s, Vt = np.linalg.svd(E)
    r = int(np.sum(s > DESCRIPTOR_RANK * max(size, float(s.max(initial=0.0)))))
    A, B, C = U.T @ A @ Vt.T, U.T @ B, C @ Vt.T
    rest = np.linalg.solve(A[r:, r:], np.hstack([A[r:, :r], B[r:]]))
    AB = np.hstack([A[:r, :r], B[:r]]) - A[:r, r:] @ rest
    CD = np.hstack([C[:, :r], D]) - C[:, r:] @ rest
    AB = AB / s[:r, None]
    return AB[:, :r], AB[:, r:], CD[:, :r], CD[:, r:]


def _rcond(M: Array) -> float:
    return float(1 / np.linalg.cond(M, 1)) if M.size else 1.0


def _root(M: Array) -> Array:
    values, vectors = np.linalg.eigh(_symmetric(M))
    return (vectors * np.sqrt(values)) @ vectors.T


def _symmetric(X: Array) -> Array:
    return (X + X.T) / 2
