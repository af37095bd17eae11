"""Invariant zeros of state-space matrices."""

import numpy as np

from ultraquiet.linalg.balance import scaled
from ultraquiet.linalg.ordered import Array

RANK = 1e-10  # relative to the largest entry of the scaled system


def invariant_zeros(A: Array, B: Array, C: Array, D: Array) -> Array:
    """Return the values of z at which [A - zI, B; C, D] loses rank, zeros at infinity left out.

    Rows, then columns, of D are compressed and the states that they tie down removed until D is invertible
    (Emami-Naeini and Van Dooren 1982, doi:10.1016/0005-1098(82)90070-X): zeros at infinity, of which every sample of
    delay brings one per channel, are removed exactly and not mistaken for large finite ones.
    """
    if not A.shape[0] or not D.size:
        return np.zeros(0, dtype=np.complex128)
    A, B, C, _ = scaled(A, B, C)
    # one number for all inputs and one for all outputs keep the zeros and make B and C as large as A
    size = np.linalg.norm(A) or 1.0
    b, c = size / (np.linalg.norm(B) or 1.0), size / (np.linalg.norm(C) or 1.0)
    B, C, D = B * b, C * c, D * b * c / size
    A, B, C, D = _row_compressed(A, B, C, D * size)
    At, Ct, Bt, Dt = _row_compressed(A.T, C.T, B.T, D.T)
    if not At.shape[0]:
        return np.zeros(0, dtype=np.complex128)
    core = At - Ct @ np.linalg.solve(Dt, Bt) if Dt.size else At
    return np.linalg.eigvals(core).astype(np.complex128)


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
