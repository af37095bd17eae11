"""Gramians of a system between two weights."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.equations import lyapunov, stein_factor
from ultraquiet.linalg.ordered import Matrices

SINGULAR = 1e-12  # directions of a weight's Gramian below this share of the largest are left out of its inverse


def input_gramian(
    M: Matrices, W: Matrices, discrete: bool, combination: float = 0.0, *, guard: bool = False
) -> FloatArray:
    """Return the controllability Gramian of a stable system M behind a stable input weight W.

    P = P11 - combination^2 P12 P22^-1 P21, the blocks those of the Gramian of M W: 0 is Enns 1984, 1 is Lin and Chiu
    1992, between them Varga and Anderson 2003 (doi:10.1016/S0005-1098(03)00030-X). With `guard` the equation's right
    side is made positive, so that a system reduced by one weighted Gramian is stable (the same, section 3).

    Raises:
        NumericalError: the cascade is not stable.
    """
    A, B, _, _ = M
    n = A.shape[0]
    Aw, Bw, Cw, Dw = W
    big = np.block([[A, B @ Cw], [np.zeros((Aw.shape[0], n)), Aw]])
    drive = np.vstack([B @ Dw, Bw])
    if not _stable(Aw, discrete):
        raise NumericalError("frequency-weighted reduction: a weight is unstable; give one that is stable.")
    whole = _gramian(big, drive, discrete)
    P = whole[:n, :n]
    if combination and Aw.shape[0]:
        inverse = np.linalg.pinv(whole[n:, n:], rcond=SINGULAR, hermitian=True)
        P = P - combination**2 * whole[:n, n:] @ inverse @ whole[n:, :n]
    if not guard:
        return (P + P.T) / 2
    right = P - A @ P @ A.T if discrete else -(A @ P + P @ A.T)
    values, vectors = np.linalg.eigh((right + right.T) / 2)
    root = vectors * np.sqrt(np.abs(values))
    return _gramian(A, root, discrete)


def output_gramian(
    M: Matrices, V: Matrices, discrete: bool, combination: float = 0.0, *, guard: bool = False
) -> FloatArray:
    """Return the observability Gramian of a stable system M before a stable output weight V; see `input_gramian`."""
    return input_gramian(transposed(M), transposed(V), discrete, combination, guard=guard)


def transposed(M: Matrices) -> Matrices:
    """Return the dual system."""
    A, B, C, D = M
    return A.T, C.T, B.T, D.T


def static(D: FloatArray) -> Matrices:
    """Return a weight without states."""
    p, m = D.shape
    return np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), D


def _gramian(A: FloatArray, B: FloatArray, discrete: bool) -> FloatArray:
    """Return the controllability Gramian of a stable system.

    In discrete time from its factor: beside slow modes of a weight that hardly show in it, the solution of the equation
    itself may come out indefinite where the states of the system are.
    """
    if not discrete:
        return lyapunov(A, B @ B.T)
    R = stein_factor(A, B)
    return R @ R.T


def _stable(A: FloatArray, discrete: bool) -> bool:
    poles = np.linalg.eigvals(A)
    return not poles.size or bool(np.abs(poles).max() < 1 if discrete else poles.real.max() < 0)
