"""The Riccati equation of discrete time."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.lyapunov import stein, symmetric
from ultraquiet.linalg.ordered import Array
from ultraquiet.linalg.riccati import (
    LONG_NEWTON,
    NEWTON_STEPS,
    NOTHING,
    POLISHED_RESIDUAL,
    Riccati,
    better,
    double,
    refusal,
    symplectic_scale,
    with_descriptor,
    without_descriptor,
)
from ultraquiet.linalg.riccati_continuous import continuous_regulator

# What double precision leaves of ill-conditioned equations once every rung has tried: stated with the solution, and
# every design is judged besides by the cost that its finished loop has.
TOLERATED_RESIDUAL = 1e-6
ROOT_TWO = np.sqrt(2.0)
ILL = 1e12  # condition of R above which its inverse is not used to find a scale


class _Terms(NamedTuple):
    A: Array
    B: Array
    Q: Array
    R: Array
    S: Array
    C: Array | None = None  # of the cost |C x + D u|^2, where it is given as a sum of squares
    D: Array | None = None

    def cost(self, K: Array) -> Array:
        """Return what u = -K x costs: by squares where they are known, for differences of large terms lose digits."""
        if self.C is not None and self.D is not None:
            left = self.C - self.D @ K
            return left.T @ left
        return symmetric(self.Q - self.S @ K - K.T @ self.S.T + K.T @ self.R @ K)

    def scaled(self, d: Array) -> "_Terms":
        """Return the equation in the states x / d."""
        C = None if self.C is None else self.C * d
        Q, S = self.Q * np.outer(d, d), self.S * d[:, None]
        return _Terms(self.A * d / d[:, None], self.B / d[:, None], Q, self.R, S, C, self.D)

    def without_cross(self) -> tuple[Array, Array, Array]:
        """Return A - B K, B R^-1 B' and the cost of K = R^-1 S', of the equation whose cost has no cross term."""
        n = self.A.shape[0]
        RB = np.linalg.solve(self.R, np.hstack([self.B.T, self.S.T]))
        K = RB[:, n:]
        return self.A - self.B @ K, symmetric(self.B @ RB[:, :n]), self.cost(K)


def discrete_riccati(A: Array, B: Array, Q: Array, R: Array, S: Array | None = None, E: Array | None = None) -> Riccati:
    """Solve E'XE = A'XA - (A'XB + S)(R + B'XB)^-1 (B'XA + S') + Q for the X that makes A - B K, pencil with E, stable.

    The ladder: structure-preserving doubling, then SciPy's QZ of the extended pencil, then the bilinear map to the
    equation of continuous time, which has the same X, each polished by Newton steps, then Newton's method (Hewer 1971)
    from whatever stabilises: the best of the rungs above, or nothing at all when A is stable. What a rung returns is
    accepted only for its residual and its stability, both computed here; the residual that the last one is left with
    may be larger than the first ones'.

    Raises:
        NumericalError: E is singular, or no rung gave a stabilising solution.
    """
    A, B = without_descriptor(E, A, B)
    if A.shape[0] == 0:
        return Riccati(np.zeros((0, 0)), 0.0, 1.0)
    solution = _solved(_Terms(A, B, Q, R, np.zeros(B.shape) if S is None else S))
    return solution._replace(X=with_descriptor(E, solution.X))


def discrete_least_squares(A: Array, B: Array, C: Array, D: Array) -> Riccati:
    """Solve the equation of the cost |C x + D u|^2 for the stabilising X: Q = C'C, S = C'D, R = D'D.

    The squares keep digits that Q - S K - K'S' + K'R K loses where control is cheap.

    Raises:
        NumericalError: as `discrete_riccati`.
    """
    if A.shape[0] == 0:
        return Riccati(np.zeros((0, 0)), 0.0, 1.0)
    return _solved(_Terms(A, B, C.T @ C, D.T @ D, C.T @ D, C, D))


def discrete_gain(A: Array, B: Array, R: Array, S: Array, X: Array) -> Array:
    """Return K = (R + B'XB)^-1 (B'XA + S'), the gain of u = -K x."""
    W, right = R + B.T @ X @ B, B.T @ X @ A + S.T
    d = np.sqrt(np.abs(np.diag(W)))
    d = np.where(d > 0, d, 1.0)
    return np.linalg.solve(W / np.outer(d, d), right / d[:, None]) / d[:, None]


def _solved(terms: _Terms) -> Riccati:
    d = _scale(terms)
    best = _ladder(terms.scaled(d))
    if best is None or not (best.accepted or (best.margin > 0 and best.residual <= TOLERATED_RESIDUAL)):
        raise refusal("discrete", terms.A.shape[0], best)
    return best._replace(X=best.X / np.outer(d, d))


def _ladder(terms: _Terms) -> Riccati | None:
    best = None
    for rung in (_doubled, _qz, _mapped):
        X = rung(terms)
        if X is not None:
            best = better(best, _polished(terms, X, NEWTON_STEPS))
            if best.accepted:
                return best
    if best is not None and best.margin > 0:
        best = better(best, _polished(terms, best.X, LONG_NEWTON))
        if best.accepted:
            return best
    if np.abs(np.linalg.eigvals(terms.A)).max() < 1:
        best = better(best, _from_rest(terms))
    return best


def _scale(terms: _Terms) -> Array:
    if not np.linalg.cond(terms.R) < ILL:
        return np.ones(terms.A.shape[0])
    return symplectic_scale(*terms.without_cross())


def _doubled(terms: _Terms) -> Array | None:
    """Structure-preserving doubling (Chu, Fan, Lin and Wang 2004, doi:10.1080/00207170410001714988)."""
    try:
        return double(*terms.without_cross())
    except LinAlgError:
        return None


def _qz(terms: _Terms) -> Array | None:
    from scipy.linalg import solve_discrete_are

    try:
        with np.errstate(invalid="ignore", over="ignore"):  # its scale factors may go beyond integers
            return solve_discrete_are(terms.A, terms.B, terms.Q, terms.R, s=terms.S)
    except (LinAlgError, ValueError):
        return None


def _mapped(terms: _Terms) -> Array | None:
    """Solve the equation of continuous time that z = (1 + s) / (1 - s) makes of this one: X is the same.

    Poles near z = -1 would go to infinity; x and u with alternating signs have A and B turned and the same cost.
    """
    poles, n = np.linalg.eigvals(terms.A), terms.A.shape[0]
    sign = 1.0 if np.abs(poles + 1).min() >= np.abs(poles - 1).min() else -1.0
    try:
        F = np.linalg.inv(sign * terms.A + np.eye(n))
        FB = F @ (sign * terms.B)
        Q, S = ROOT_TWO * F.T @ terms.Q @ F * ROOT_TWO, ROOT_TWO * F.T @ (terms.S - terms.Q @ FB)
        R = terms.R - terms.S.T @ FB - FB.T @ terms.S + FB.T @ terms.Q @ FB
        A = F @ (sign * terms.A - np.eye(n))
        return continuous_regulator(A, ROOT_TWO * FB, symmetric(Q), symmetric(R), S).X
    except (LinAlgError, NumericalError):
        return None


def _from_rest(terms: _Terms) -> Riccati:
    """Take Newton's steps from no control at all, which a stable A allows; for a convex cost they cannot diverge."""
    try:
        start = _judged(terms, stein(terms.A.T, terms.Q))
    except NumericalError:
        return NOTHING
    return _polished(terms, start.X, LONG_NEWTON, falling=False)


def _polished(terms: _Terms, X: Array, steps: int, falling: bool = True) -> Riccati:
    """Take Newton's steps while they stabilise and, when `falling`, while each makes the residual smaller."""
    current = best = _judged(terms, X)
    for _ in range(steps):
        if current.residual <= POLISHED_RESIDUAL or not current.margin > 0:
            break
        step = _judged(terms, _newton(terms, current.X))
        if not step.margin > 0 or (falling and not step.residual < current.residual):
            break
        current, best = step, better(best, step)
    return best


def _newton(terms: _Terms, X: Array) -> Array:
    K = discrete_gain(terms.A, terms.B, terms.R, terms.S, X)
    try:
        return stein((terms.A - terms.B @ K).T, terms.cost(K))
    except NumericalError:
        return np.full(X.shape, np.nan)


def _judged(terms: _Terms, X: Array) -> Riccati:
    """Return X with the residual of X = (A - BK)'X(A - BK) + cost(K), the equation's own with K = K(X)."""
    if not np.all(np.isfinite(X)):
        return Riccati(X, np.inf, -np.inf)
    try:
        K = discrete_gain(terms.A, terms.B, terms.R, terms.S, X)
    except LinAlgError:
        return Riccati(X, np.inf, -np.inf)
    closed, cost = terms.A - terms.B @ K, terms.cost(K)
    propagated = closed.T @ X @ closed
    size = np.linalg.norm(propagated) + np.linalg.norm(cost) + np.linalg.norm(X)
    left = float(np.linalg.norm(propagated + cost - X))
    bare, k = np.abs(closed), np.abs(K)
    cross = np.abs(terms.S) @ k
    whole = np.linalg.norm(
        bare.T @ np.abs(X) @ bare + np.abs(X) + np.abs(terms.Q) + cross + cross.T + k.T @ np.abs(terms.R) @ k
    )
    residual, backward = (left / float(size), left / float(whole)) if size else (0.0, 0.0)
    return Riccati(X, residual, 1.0 - float(np.abs(np.linalg.eigvals(closed)).max()), backward)
