"""The Riccati equation of continuous time."""

import numpy as np
from scipy.linalg import LinAlgError, lu_factor, lu_solve

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.lyapunov import lyapunov, symmetric
from ultraquiet.linalg.ordered import Array, ordered_schur, real_schur
from ultraquiet.linalg.riccati import (
    LONG_NEWTON,
    NEWTON_STEPS,
    POLISHED_RESIDUAL,
    Riccati,
    better,
    cost_unit,
    double,
    refusal,
    symplectic_scale,
    with_descriptor,
    without_descriptor,
)

DEFECTS = 3  # equations of the defect solved in turn
AXIS = 1e-9  # an eigenvalue with a real part below this share of its modulus lies on the axis
# Scales that differ by more than this are those of a Hamiltonian that falls apart, as where Q is zero: what balances it
# has no end there, and the stable subspace loses X. The coordinates as they were given are tried then.
FAR = 2.0**16
UNSPLIT = np.full((1, 1), np.nan)  # what the Schur rung returns for a spectrum that cannot be split


def continuous_riccati(A: Array, G: Array, Q: Array) -> Riccati:
    """Solve A'X + X A - X G X + Q = 0 for the X that makes A - G X stable; G and Q symmetric, of any sign.

    The ladder: ordered real Schur form of the balanced Hamiltonian, structured doubling, each polished by Newton steps,
    then Newton's method with line search from whatever stabilises. Where the best of them does not stabilise or leaves
    more than round-off, the equation of its own defect is solved by the Schur form and added, which works from any
    start. What a rung returns is accepted only for what it leaves of the equation and for its stability, both computed
    here. A Hamiltonian with eigenvalues on the axis ends the ladder at once: no method can split them.

    Raises:
        NumericalError: no rung gave a stabilising solution, as when the Hamiltonian has eigenvalues on the axis.

    Mehrmann and Tan 1988, doi:10.1109/9.1303 (the defect's own equation).
    """
    n = A.shape[0]
    if n == 0:
        return Riccati(np.zeros((0, 0)), 0.0, np.inf, 0.0)
    if not np.any(Q) and np.linalg.eigvals(A).real.max() < 0:
        # X = 0: the Y equation of every mixed-sensitivity problem with a stable plant, which SciPy refuses
        return Riccati(np.zeros((n, n)), 0.0, -float(np.linalg.eigvals(A).real.max()), 0.0)
    r = cost_unit(G, Q)
    scale = symplectic_scale(A, G * r, Q / r)
    best = None
    for d in (scale, np.ones(n))[: 1 + (scale.max() > FAR * scale.min())]:
        back = r / np.outer(d, d)
        found = _ladder(A * d / d[:, None], G * back, Q / back)
        best = best if found is None else better(best, found._replace(X=found.X * back))
        if best is not None and best.accepted:
            return best
    raise refusal("continuous", n, best)


def _ladder(A: Array, G: Array, Q: Array) -> Riccati | None:
    best = None
    for rung in (_schur, _doubled):
        X = rung(A, G, Q)
        if X is UNSPLIT:
            break
        if X is not None:
            best = better(best, _polished(A, G, Q, X, NEWTON_STEPS))
            if best.accepted:
                return best
    if best is not None and best.margin > 0:
        best = better(best, _polished(A, G, Q, best.X, LONG_NEWTON))
    for _ in range(DEFECTS):
        if best is None or best.accepted:
            break
        corrected = _corrected(A, G, Q, best.X)
        if corrected is None:
            break
        best = better(best, corrected)
        if best is not corrected:
            break
    return best


def _corrected(A: Array, G: Array, Q: Array, X: Array) -> Riccati | None:
    """Return X + Z, where Z solves (A - GX)'Z + Z (A - GX) - Z G Z + defect(X) = 0; None when that cannot be split."""
    AX = A.T @ X
    defect = symmetric(AX + AX.T - X @ G @ X + Q)
    if not np.all(np.isfinite(defect)):
        return None
    closed, r = A - G @ X, cost_unit(G, defect)
    d = symplectic_scale(closed, G * r, defect / r)
    back = r / np.outer(d, d)
    Z = _schur(closed * d / d[:, None], G * back, defect / back)
    return None if Z is None or Z is UNSPLIT else _polished(A, G, Q, X + Z * back, NEWTON_STEPS)


def continuous_regulator(
    A: Array, B: Array, Q: Array, R: Array, S: Array | None = None, E: Array | None = None
) -> Riccati:
    """Solve A'XE + E'XA - (E'XB + S) R^-1 (B'XE + S') + Q = 0 for the X that makes A - B R^-1 (B'XE + S') stable.

    `residual` and `margin` are those of the equation without E, which is solved.

    Raises:
        NumericalError: R or E is singular, or there is no stabilising solution.
    """
    A, B = without_descriptor(E, A, B)
    cross: Array = np.zeros(B.shape) if S is None else S
    RB = _solved(R, np.hstack([B.T, cross.T]))
    n = A.shape[0]
    solution = continuous_riccati(A - B @ RB[:, n:], symmetric(B @ RB[:, :n]), symmetric(Q - cross @ RB[:, n:]))
    return solution._replace(X=with_descriptor(E, solution.X))


def newton_direction(A: Array, G: Array, Q: Array, X: Array) -> Array:
    """Return what one Newton step adds to a solution: an estimate of its error, entry by entry.

    Raises:
        NumericalError: A - GX and its mirror image share an eigenvalue.
    """
    AX = A.T @ X
    return lyapunov((A - G @ X).T, symmetric(AX + AX.T - X @ G @ X + Q))


def continuous_residual(A: Array, G: Array, Q: Array, X: Array) -> float:
    """Return the size of A'X + XA - XGX + Q relative to its terms."""
    return _residuals(A, G, Q, X)[0]


def _residuals(A: Array, G: Array, Q: Array, X: Array) -> tuple[float, float]:
    """Return the size of A'X + XA - XGX + Q relative to its terms, and to them without signs."""
    AX, XGX = A.T @ X, X @ G @ X
    size = 2 * np.linalg.norm(AX) + np.linalg.norm(XGX) + np.linalg.norm(Q)
    left = float(np.linalg.norm(AX + AX.T - XGX + Q))
    bare = np.abs(X)
    AX = np.abs(A.T) @ bare
    whole = np.linalg.norm(AX + AX.T + bare @ np.abs(G) @ bare + np.abs(Q))
    return (left / float(size), left / float(whole)) if size else (0.0, 0.0)


def _solved(R: Array, right: Array) -> Array:
    """Return R^-1 times the right side; R is symmetric, taken at unit diagonal."""
    d = np.sqrt(np.abs(np.diag(R)))
    d = np.where(d > 0, d, 1.0)
    try:
        return np.linalg.solve(R / np.outer(d, d), right / d[:, None]) / d[:, None]
    except LinAlgError:
        raise refusal("continuous, R singular", right.shape[1], None) from None


def _doubled(A: Array, G: Array, Q: Array) -> Array | None:
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
    return double(E, symmetric(G0), symmetric(H))


def _schur(A: Array, G: Array, Q: Array) -> Array | None:
    """Stable invariant subspace of the Hamiltonian by ordered real Schur form (Laub 1979)."""
    n = A.shape[0]
    H = np.block([[A, -G], [-Q, -A.T]])
    try:
        T, U, split = ordered_schur(H, "lhp")
        if split == n:
            return symmetric(np.linalg.solve(U[:n, :n].T, U[n:, :n].T).T)
    except (LinAlgError, ValueError):
        T = real_schur(H)[0]
    values = np.linalg.eigvals(T)
    moduli, real = np.abs(values), values.real
    return UNSPLIT if np.any(np.abs(real) <= AXIS * np.maximum(moduli, AXIS * moduli.max())) else None


def _polished(A: Array, G: Array, Q: Array, X: Array, steps: int) -> Riccati:
    current = _judged(A, G, Q, X)
    for _ in range(steps):
        if current.residual <= POLISHED_RESIDUAL or not current.margin > 0:
            break
        closed = A - G @ current.X
        AX = A.T @ current.X
        residual = symmetric(AX + AX.T - current.X @ G @ current.X + Q)
        try:
            direction = lyapunov(closed.T, residual)
        except NumericalError:
            break
        step = _judged(A, G, Q, current.X + _length(residual, direction @ G @ direction) * direction)
        if not (step.residual < current.residual and step.margin > 0):
            break
        current = step
    return current


def _length(residual: Array, bend: Array) -> float:
    """Return the t in [0, 2] that makes |(1 - t) residual - t^2 bend| least (Benner and Byers 1998)."""
    a, b, c = np.sum(residual**2), np.sum(residual * bend), np.sum(bend**2)
    if not np.isfinite(c) or c == 0:
        return 1.0
    # (1 - t)^2 a - 2 (1 - t) t^2 b + t^4 c
    turns = np.roots([4 * c, 6 * b, 2 * a - 4 * b, -2 * a])
    candidates = np.concatenate([[2.0], turns.real[(np.abs(turns.imag) < 1e-9) & (turns.real > 0) & (turns.real < 2)]])
    cost = (1 - candidates) ** 2 * a - 2 * (1 - candidates) * candidates**2 * b + candidates**4 * c
    return float(candidates[np.argmin(cost)])


def _judged(A: Array, G: Array, Q: Array, X: Array) -> Riccati:
    if not np.all(np.isfinite(X)):
        return Riccati(X, np.inf, -np.inf)
    residual, backward = _residuals(A, G, Q, X)
    return Riccati(X, residual, -float(np.linalg.eigvals(A - G @ X).real.max()), backward)
