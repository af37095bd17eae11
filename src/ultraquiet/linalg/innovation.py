"""One-step errors and predictions of x+ = A x + B u + K e, y = C x + D u + e on plain arrays."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg import response

GONE = 1e-9  # share of its first size below which a free motion no longer counts


def errors(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    K: FloatArray,
    u: FloatArray,
    y: FloatArray,
    *,
    estimate: bool = True,
    offset: bool = True,
) -> FloatArray:
    """Return e = y - C x - D u with x+ = (A - K C) x + (B - K D) u + K y, initial state and a constant fitted."""
    inner = A - K @ C
    e = y - response.simulate(
        inner, np.hstack([B - K @ D, K]), C, np.hstack([D, np.zeros((len(C), len(C)))]), np.vstack([u, y]), _zero(A)
    )
    if offset:
        e = e - e.mean(axis=1, keepdims=True)
    if estimate and len(A):
        e = e - free_motion(inner, C, e)
    return e


def free_motion(A: FloatArray, C: FloatArray, miss: FloatArray) -> FloatArray:
    """Return C A^t x0 with x0 fitted to `miss` `(ny, n)` by least squares, as long as the motion counts."""
    n = miss.shape[1]
    rows, x = [], C
    first = float(np.linalg.norm(C))
    for _ in range(n):
        rows.append(x)
        x = x @ A
        if float(np.linalg.norm(x)) < GONE * first:
            break
    observed = np.stack(rows)
    flat = observed.reshape(-1, len(A))
    x0 = np.linalg.lstsq(flat, miss[:, : len(rows)].T.reshape(-1), rcond=None)[0]
    out = np.zeros_like(miss)
    out[:, : len(rows)] = (flat @ x0).reshape(len(rows), -1).T
    return out


def ahead(A: FloatArray, C: FloatArray, K: FloatArray, e: FloatArray, steps: int) -> FloatArray:
    """Return what a prediction `steps` samples ahead misses: e(t) + sum_{i=1}^{steps-1} C A^{i-1} K e(t - i)."""
    miss, gain = e.copy(), K
    for i in range(1, min(steps, e.shape[1])):
        miss[:, i:] += C @ gain @ e[:, :-i]
        gain = A @ gain
    return miss


def _zero(A: FloatArray) -> FloatArray:
    return np.zeros(A.shape[0])
