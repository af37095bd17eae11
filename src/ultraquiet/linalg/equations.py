"""Riccati and Lyapunov equations, each solved by a ladder of methods and checked outside the solver."""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, lu_factor, lu_solve, matrix_balance, solve_continuous_lyapunov

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.ordered import Array, ordered_schur, real_schur

ACCEPTED_RESIDUAL = 1e-8  # relative; a Newton step follows above it, a refusal if that does not help
POLISHED_RESIDUAL = 1e-11  # no Newton step is taken below it
NEWTON_STEPS = 2
AXIS = 1e-9  # an eigenvalue with a real part below this share of its modulus lies on the axis
UNSPLIT = np.full((1, 1), np.nan)  # what the Schur rung returns for a spectrum that cannot be split
DOUBLINGS = 60  # 2^60 steps of the underlying recursion


class Riccati(NamedTuple):
    """A stabilising solution: X, its relative residual, and how far the closed loop is from instability.

    `margin` is minus the largest real part (continuous) or one minus the largest modulus (discrete) of the closed-loop
    poles, positive when stable.
    """

    X: Array
    residual: float
    margin: float


def continuous_riccati(A: Array, G: Array, Q: Array) -> Riccati:
    """Solve A'X + X A - X G X + Q = 0 for the X that makes A - G X stable; G and Q symmetric, of any sign.

    The ladder: ordered real Schur form of the balanced Hamiltonian, structured doubling, each polished by Newton steps.
    Whatever a rung returns is accepted only for its residual and its stability, both computed here. A Hamiltonian with
    eigenvalues on the axis ends the ladder at once: no method can split them.

    Raises:
        NumericalError: no rung gave a stabilising solution, as when the Hamiltonian has eigenvalues on the axis.
    """
    n = A.shape[0]
    if n == 0:
        return Riccati(np.zeros((0, 0)), 0.0, np.inf)
    if not np.any(Q) and np.linalg.eigvals(A).real.max() < 0:
        # X = 0: the Y equation of every mixed-sensitivity problem with a stable plant, which SciPy refuses
        return Riccati(np.zeros((n, n)), 0.0, -float(np.linalg.eigvals(A).real.max()))
    d, As, Gs, Qs = _symplectic_scaling(A, G, Q)
    found = None
    for rung in (_schur_continuous, _doubled_continuous):
        X = rung(As, Gs, Qs)
        if X is UNSPLIT:
            break
        if X is not None:
            found = _best(found, _polished_continuous(As, Gs, Qs, X))
            if found.residual <= ACCEPTED_RESIDUAL and found.margin > 0:
                return found._replace(X=found.X / np.outer(d, d))
    raise NumericalError(_refusal("continuous", n, found))


def discrete_riccati(A: Array, B: Array, Q: Array, R: Array, S: Array | None = None) -> Riccati:
    """Solve X = A'XA - (A'XB + S)(R + B'XB)^-1 (B'XA + S') + Q for the stabilising X.

    The ladder: structure-preserving doubling, then SciPy's QZ of the extended pencil, then Newton steps.

    Raises:
        NumericalError: R is singular for every rung, or no rung gave a stabilising solution.
    """
    S = np.zeros((A.shape[0], B.shape[1])) if S is None else S
    if A.shape[0] == 0:
        return Riccati(np.zeros((0, 0)), 0.0, 1.0)
    found = None
    for rung in (_doubled_discrete, _qz_discrete):
        X = rung(A, B, Q, R, S)
        if X is not None:
            found = _best(found, _polished_discrete(A, B, Q, R, S, X))
            if found.residual <= ACCEPTED_RESIDUAL and found.margin > 0:
                return found
    raise NumericalError(_refusal("discrete", A.shape[0], found))


def lyapunov(A: Array, Q: Array) -> Array:
    """Solve A X + X A' + Q = 0 for symmetric Q."""
    if A.shape[0] == 0:
        return np.zeros((0, 0))
    with warnings.catch_warnings():
        # SciPy warns where A and -A nearly share an eigenvalue; callers look at the residual instead
        warnings.simplefilter("ignore", RuntimeWarning)
        return _symmetric(solve_continuous_lyapunov(A, -Q))


def stein(A: Array, Q: Array) -> Array:
    """Solve X = A X A' + Q for stable A by doubling (squared Smith); 2^k terms of the series after k steps.

    Raises:
        NumericalError: A has an eigenvalue on or outside the unit circle.
    """
    X, E = Q.copy(), A.copy()
    for _ in range(DOUBLINGS):
        step = E @ X @ E.T
        X = X + step
        if not np.all(np.isfinite(X)):
            break
        if np.linalg.norm(step) <= 1e-16 * np.linalg.norm(X):
            return _symmetric(X)
        E = E @ E
    raise NumericalError("Stein equation: A has an eigenvalue on or outside the unit circle, so the sum has no limit.")


def continuous_residual(A: Array, G: Array, Q: Array, X: Array) -> float:
    """Return the size of A'X + XA - XGX + Q relative to its terms."""
    AX, XGX = A.T @ X, X @ G @ X
    size = 2 * np.linalg.norm(AX) + np.linalg.norm(XGX) + np.linalg.norm(Q)
    return float(np.linalg.norm(AX + AX.T - XGX + Q) / size) if size else 0.0


def discrete_gain(A: Array, B: Array, R: Array, S: Array, X: Array) -> Array:
    """Return K = (R + B'XB)^-1 (B'XA + S'), the gain of u = -K x."""
    return np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A + S.T)


def _symplectic_scaling(A: Array, G: Array, Q: Array) -> tuple[Array, ...]:
    """Scale the states by d, X -> d X d, so that the Hamiltonian's rows and columns match (Benner 2001).

    The powers of two that LAPACK finds for the 2n-by-2n matrix are halved into a symplectic scaling.
    """
    n = A.shape[0]
    H = np.abs(np.block([[A, -G], [-Q, -A.T]]))
    if not np.isfinite(H).all():
        raise NumericalError(f"Riccati equation ({n} states): its matrices overflow; scale the problem.")
    np.fill_diagonal(H, 0.0)
    _, (scale, _) = matrix_balance(H, permute=False, separate=True)
    s = np.log2(scale)
    d = np.exp2(np.round((s[:n] - s[n:]) / 2))
    return d, A * d / d[:, None], G / np.outer(d, d), Q * np.outer(d, d)


def _doubled_continuous(A: Array, G: Array, Q: Array) -> Array | None:
    """Structured doubling after a Cayley transformation (Chu, Fan and Lin 2005, doi:10.1016/j.laa.2004.10.010)."""
    n = A.shape[0]
    moduli = np.abs(np.linalg.eigvals(A))
    shift = float(np.exp(np.mean(np.log(np.maximum(moduli, 1e-12 * max(moduli.max(), 1e-300))))))
    shift = max(shift, 1e-6 * np.linalg.norm(A, 2), 1e-300)
    try:
        shifted = A - shift * np.eye(n)
        AG = np.linalg.solve(shifted, G)
        QA = np.linalg.solve(shifted.T, Q).T
        W = lu_factor(shifted.T + Q @ AG)
    except (LinAlgError, ValueError):
        return None
    E = np.eye(n) + 2 * shift * lu_solve(W, np.eye(n)).T
    H = 2 * shift * lu_solve(W, QA)
    G0 = 2 * shift * lu_solve(W, AG.T, trans=1).T
    return _double(E, _symmetric(G0), _symmetric(H))


def _doubled_discrete(A: Array, B: Array, Q: Array, R: Array, S: Array) -> Array | None:
    """Structure-preserving doubling (Chu, Fan, Lin and Wang 2004, doi:10.1080/00207170410001714988)."""
    try:
        RB = np.linalg.solve(R, np.hstack([B.T, S.T]))
    except LinAlgError:
        return None
    n = A.shape[0]
    return _double(A - B @ RB[:, n:], _symmetric(B @ RB[:, :n]), _symmetric(Q - S @ RB[:, n:]))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _double(E: Array, G: Array, H: Array) -> Array | None:
    """Double (E, G, H) until H stands still at the solution; None when it does not."""
    identity = np.eye(E.shape[0])
    for _ in range(DOUBLINGS):
        W = identity + G @ H
        try:
            WE, WG = np.split(np.linalg.solve(W, np.hstack([E, G])), 2, axis=1)
        except LinAlgError:
            return None
        step = E.T @ H @ WE
        G = _symmetric(G + E @ WG @ E.T)
        E = E @ WE
        H = _symmetric(H + step)
        size = np.linalg.norm(H)
        if not np.isfinite(size) or not np.all(np.isfinite(E)):
            return None
        if np.linalg.norm(step) <= 1e-15 * size:
            return H
    return None


def _schur_continuous(A: Array, G: Array, Q: Array) -> Array | None:
    """Stable invariant subspace of the Hamiltonian by ordered real Schur form (Laub 1979)."""
    n = A.shape[0]
    H = np.block([[A, -G], [-Q, -A.T]])
    try:
        T, U, split = ordered_schur(H, "lhp")
        if split == n:
            return _symmetric(np.linalg.solve(U[:n, :n].T, U[n:, :n].T).T)
    except (LinAlgError, ValueError):
        T = real_schur(H)[0]
    moduli, real = _spectrum(T)
    return UNSPLIT if np.any(np.abs(real) <= AXIS * np.maximum(moduli, AXIS * moduli.max())) else None


def _spectrum(T: Array) -> tuple[Array, Array]:
    """Return moduli and real parts of the eigenvalues of a real Schur form."""
    values = np.linalg.eigvals(T)
    return np.abs(values), values.real


def _qz_discrete(A: Array, B: Array, Q: Array, R: Array, S: Array) -> Array | None:
    from scipy.linalg import solve_discrete_are

    try:
        return solve_discrete_are(A, B, Q, R, s=S)
    except (LinAlgError, ValueError):
        return None


def _polished_continuous(A: Array, G: Array, Q: Array, X: Array) -> Riccati:
    held = _judged_continuous(A, G, Q, X)
    for _ in range(NEWTON_STEPS):
        if held.residual <= POLISHED_RESIDUAL or not held.margin > 0:
            break
        closed = A - G @ held.X
        AX = A.T @ held.X
        residual = AX + AX.T - held.X @ G @ held.X + Q
        step = _judged_continuous(A, G, Q, held.X + lyapunov(closed.T, _symmetric(residual)))
        if not step.residual < held.residual:
            break
        held = step
    return held


def _judged_continuous(A: Array, G: Array, Q: Array, X: Array) -> Riccati:
    if not np.all(np.isfinite(X)):
        return Riccati(X, np.inf, -np.inf)
    return Riccati(X, continuous_residual(A, G, Q, X), -float(np.linalg.eigvals(A - G @ X).real.max()))


def _polished_discrete(A: Array, B: Array, Q: Array, R: Array, S: Array, X: Array) -> Riccati:
    held = _judged_discrete(A, B, Q, R, S, X)
    for _ in range(NEWTON_STEPS):
        if held.residual <= POLISHED_RESIDUAL or not held.margin > 0:
            break
        K = discrete_gain(A, B, R, S, held.X)
        cost = Q - S @ K - K.T @ S.T + K.T @ R @ K
        step = _judged_discrete(A, B, Q, R, S, stein((A - B @ K).T, _symmetric(cost)))
        if not step.residual < held.residual:
            break
        held = step
    return held


def _judged_discrete(A: Array, B: Array, Q: Array, R: Array, S: Array, X: Array) -> Riccati:
    if not np.all(np.isfinite(X)):
        return Riccati(X, np.inf, -np.inf)
    try:
        K = discrete_gain(A, B, R, S, X)
    except LinAlgError:
        return Riccati(X, np.inf, -np.inf)
    AXA, pull = A.T @ X @ A, (A.T @ X @ B + S) @ K
    size = np.linalg.norm(AXA) + np.linalg.norm(pull) + np.linalg.norm(Q) + np.linalg.norm(X)
    residual = float(np.linalg.norm(AXA - pull + Q - X) / size) if size else 0.0
    return Riccati(X, residual, 1.0 - float(np.abs(np.linalg.eigvals(A - B @ K)).max()))


def _best(held: Riccati | None, new: Riccati) -> Riccati:
    if held is None or (new.margin > 0 >= held.margin):
        return new
    return new if (new.margin > 0) == (held.margin > 0) and new.residual < held.residual else held


def _refusal(time: str, n: int, found: Riccati | None) -> str:
    who = f"Riccati equation ({time}, {n} states)"
    if found is None:
        return (
            f"{who}: no stabilising solution exists, or none could be separated; modes lie on the stability boundary."
        )
    if not found.margin > 0:
        return f"{who}: the solution found does not stabilise (margin {found.margin:.2e}); a mode cannot be moved."
    return f"{who}: the relative residual {found.residual:.1e} is above {ACCEPTED_RESIDUAL:.0e}; scale the problem."


def _symmetric(X: Array) -> Array:
    return (X + X.T) / 2
