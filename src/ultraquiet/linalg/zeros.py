"""Invariant zeros of state-space matrices."""

from typing import Any

import numpy as np

from ultraquiet.linalg.even import even_scale
from ultraquiet.linalg.ordered import Array

RANK = 1e-10  # relative to the largest entry of the scaled system
SWEEPS = 30  # of states, inputs and outputs in turn; a handful settles it


def invariant_zeros(A: Array, B: Array, C: Array, D: Array) -> Array:
    """Return the values of z at which [A - zI, B; C, D] loses rank, zeros at infinity left out.

    Rows, then columns, of D are compressed and the states that they tie down removed until D is invertible
    (Emami-Naeini and Van Dooren 1982, doi:10.1016/0005-1098(82)90070-X): zeros at infinity, of which every sample of
    delay brings one per channel, are removed exactly and not mistaken for large finite ones.
    """
    if not A.shape[0] or not D.size:
        return np.zeros(0, dtype=np.complex128)
    A, B, C, D, size = _even(*(np.asarray(M, dtype=np.float64) for M in (A, B, C, D)))
    A, B, C, D = _row_compressed(A, B, C, D)
    At, Ct, Bt, Dt = _row_compressed(A.T, C.T, B.T, D.T)
    if not At.shape[0]:
        return np.zeros(0, dtype=np.complex128)
    core = At - Ct @ np.linalg.solve(Dt, Bt) if Dt.size else At
    return np.linalg.eigvals(core).astype(np.complex128) * size


def _even(A: Array, B: Array, C: Array, D: Array) -> tuple[Array, Array, Array, Array, float]:
    """Return the system in units of its own, of states, inputs, outputs and time, and how much faster the old time is.

    No unit moves a zero, and a rank is only told apart from rounding where every row and column is about one.
    """
    size = 1.0
    for _ in range(SWEEPS):
        faster = _power_of_two(float(np.linalg.norm(A)))
        A, B, size = A / faster, B / faster, size * faster
        d = even_scale(A, B, C)
        u = _power_of_two(np.sqrt(np.sum((B / d[:, None]) ** 2, axis=0) + np.sum(D**2, axis=0)))
        y = _power_of_two(np.sqrt(np.sum((C * d) ** 2, axis=1) + np.sum((D / u) ** 2, axis=1)))
        A, B, C, D = A * d / d[:, None], B / d[:, None] / u, C * d / y[:, None], D / u / y[:, None]
        if faster == 1.0 and np.all(d == 1) and np.all(u == 1) and np.all(y == 1):
            break
    return A, B, C, D, size


def _power_of_two(size: Any) -> Any:
    """Return the powers of two next to sizes, one for a size of zero."""
    return np.exp2(np.round(np.log2(np.where(size > 0, size, 1.0))))


def _row_compressed(A: Array, B: Array, C: Array, D: Array) -> tuple[Array, ...]:
    """Remove the states that outputs without feedthrough tie to zero, until D has full row rank."""
    tiny = RANK * max((float(np.abs(M).max()) for M in (A, B, C, D) if M.size), default=0.0)
    while C.shape[0]:
        U, s, _ = np.linalg.svd(D) if D.shape[1] else (np.eye(D.shape[0]), np.zeros(0), None)
        rank = int(np.sum(s > tiny))
        C, D = U.T @ C, U.T @ D
        if rank == C.shape[0]:
            break
        free, C, D = C[rank:], C[:rank], D[:rank]
        _, s, Vt = np.linalg.svd(free)
        tied = int(np.sum(s > tiny))
        if tied == 0:
            continue
        V = np.vstack([Vt[tied:], Vt[:tied]]).T
        A, B, C = V.T @ A @ V, V.T @ B, C @ V
        m = A.shape[0] - tied
        C, D = np.vstack([C[:, :m], A[m:, :m]]), np.vstack([D, B[m:]])
        A, B = A[:m, :m], B[:m]
    return A, B, C, D
