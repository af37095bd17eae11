"""What the Riccati equations of continuous and discrete time share: the outcome, its choice, doubling, scaling."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dgebal  # pyright: ignore[reportAttributeAccessIssue]

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.lyapunov import DOUBLINGS, symmetric
from ultraquiet.linalg.ordered import Array

ACCEPTED_RESIDUAL = 1e-8  # relative; a Newton step follows above it, a refusal if that does not help
POLISHED_RESIDUAL = 1e-11  # no Newton step is taken below it
NEWTON_STEPS = 2
# Newton's method halves the error of a far start, and squares it near the end: 60 halvings outlast double precision.
LONG_NEWTON = 60
SINGULAR = 1e12  # condition of E above which its inverse says nothing
# What is left of an equation, relative to its terms without their signs, is the round-off of these terms: no solver
# leaves less where they cancel, as in front of poles that are slow beside others.
ROUND_OFF = 1e-14


class Riccati(NamedTuple):
    """A stabilising solution: X, its relative residual, and how far the closed loop is from instability.

    `margin` is minus the largest real part (continuous) or one minus the largest modulus (discrete) of the closed-loop
    poles, positive when stable. `backward` is the residual relative to the terms of the equation taken without signs,
    entry by entry: how far the data of an equation lie off that X solves exactly.
    """

    X: Array
    residual: float
    margin: float
    backward: float = np.inf

    @property
    def accepted(self) -> bool:
        """Whether it stabilises and fulfils its equation, as far as the round-off of the terms lets it."""
        return self.margin > 0 and (self.residual <= ACCEPTED_RESIDUAL or self.backward <= ROUND_OFF)


NOTHING = Riccati(np.zeros((0, 0)), np.inf, -np.inf)


def better(best: Riccati | None, new: Riccati) -> Riccati:
    """Return the one that stabilises, then the one with the smaller residual."""
    if best is None or (new.margin > 0 >= best.margin):
        return new
    return new if (new.margin > 0) == (best.margin > 0) and new.residual < best.residual else best


def refusal(time: str, n: int, best: Riccati | None) -> NumericalError:
    """Return the error that says what the best rung came to."""
    who = f"Riccati equation ({time}, {n} states)"
    if best is None or not np.isfinite(best.residual):
        reason = "no stabilising solution exists, or none could be separated; modes lie on the stability boundary."
    elif not best.margin > 0:
        reason = f"the solution found does not stabilise (margin {best.margin:.2e}); a mode cannot be moved."
    else:
        reason = f"the relative residual of the best solution, {best.residual:.1e}, is too large; scale the problem."
    return NumericalError(f"{who}: {reason}")


def cost_unit(G: Array, Q: Array) -> float:
    """Return r, a power of two, such that X / r solves an equation in r G and Q / r that are of one size."""
    g, q = float(np.linalg.norm(G)), float(np.linalg.norm(Q))
    if not (np.isfinite(g) and np.isfinite(q) and g > 0 and q > 0):
        return 1.0
    return float(np.exp2(np.round((np.log2(q) - np.log2(g)) / 2)))


def symplectic_scale(A: Array, G: Array, Q: Array) -> Array:
    """Return d, powers of two, such that the states x / d make the Hamiltonian's rows and columns alike (Benner 2001).

    The powers of two that LAPACK finds for the 2n-by-2n matrix are halved into a symplectic scaling.

    Raises:
        NumericalError: a matrix is not finite.
    """
    n = A.shape[0]
    H = np.abs(np.block([[A, -G], [-Q, -A.T]]))
    if not np.isfinite(H).all():
        raise NumericalError(f"Riccati equation ({n} states): its matrices overflow; scale the problem.")
    np.fill_diagonal(H, 0.0)
    s = np.log2(dgebal(H, scale=1, permute=0)[3])
    return np.exp2(np.round((s[:n] - s[n:]) / 2))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def double(E: Array, G: Array, H: Array) -> Array | None:
    """Double (E, G, H) until H stands still at the solution; None when it does not."""
    identity = np.eye(E.shape[0])
    for _ in range(DOUBLINGS):
        W = identity + G @ H
        try:
            WE, WG = np.split(np.linalg.solve(W, np.hstack([E, G])), 2, axis=1)
        except LinAlgError:
            return None
        step = E.T @ H @ WE
        G = symmetric(G + E @ WG @ E.T)
        E = E @ WE
        H = symmetric(H + step)
        size = np.linalg.norm(H)
        if not np.isfinite(size) or not np.all(np.isfinite(E)):
            return None
        if np.linalg.norm(step) <= 1e-15 * size:
            return H
    return None


def without_descriptor(E: Array | None, A: Array, B: Array) -> tuple[Array, Array]:
    """Return E^-1 A and E^-1 B, for which E'XE is what X is otherwise.

    Raises:
        NumericalError: E is singular to working precision, rows and columns taken at unit size.
    """
    if E is None or not A.shape[0]:
        return A, B
    rows = np.linalg.norm(E, axis=1, keepdims=True)
    unit = E / np.where(rows > 0, rows, 1)
    columns = np.linalg.norm(unit, axis=0, keepdims=True)
    condition = np.linalg.cond(unit / np.where(columns > 0, columns, 1))
    if not condition < SINGULAR:
        raise NumericalError(
            f"Riccati equation ({A.shape[0]} states): E is singular to working precision (condition {condition:.1e}); "
            "remove the algebraic equations first."
        )
    AB = np.linalg.solve(unit, np.hstack([A, B]) / np.where(rows > 0, rows, 1))
    return AB[:, : A.shape[0]], AB[:, A.shape[0] :]


def with_descriptor(E: Array | None, X: Array) -> Array:
    """Return E^-T X E^-1."""
    if E is None or not X.shape[0]:
        return X
    half = np.linalg.solve(E.T, X)
    return symmetric(np.linalg.solve(E.T, half.T))
