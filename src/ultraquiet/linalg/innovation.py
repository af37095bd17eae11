"""One-step errors and predictions of x+ = A x + B u + K e, y = C x + D u + e on plain arrays."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.linalg import response

GONE = 1e-9  # share of its largest size below which a free motion no longer counts


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
    return e - unknown_past(inner, C, e, estimate=estimate, offset=offset)


def unknown_past(
    A: FloatArray, C: FloatArray, miss: FloatArray, *, estimate: bool = True, offset: bool = True
) -> FloatArray:
    """Return C A^t x0 + c, x0 and c `(ny,)` fitted together to `miss` `(ny, n)` by least squares: see `fitted_past`."""
    return fitted_past(A, C, miss, estimate=estimate, offset=offset)[1]


def fitted_past(
    A: FloatArray, C: FloatArray, miss: FloatArray, *, estimate: bool = True, offset: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return x0 `(n_x,)` and C A^t x0 + c `(ny, n)`, x0 and c fitted together to `miss` by least squares.

    One after the other they would take from each other: over a record that a slow mode outlasts, its free motion has a
    mean of its own. Each output counts in units of its own deviation.

    Args:
        A: of the free motion, `(n_x, n_x)`.
        C: of the free motion, `(ny, n_x)`.
        miss: what is to be explained.
        estimate: whether x0 is free; zero otherwise.
        offset: whether c is free; zero otherwise.
    """
    ny, n = miss.shape
    size = miss.std(axis=1)
    size[size == 0.0] = 1.0
    motion = _motion(A, C / size[:, None], n) if estimate and len(A) else np.zeros((1, ny, 0))
    rows, _, states = motion.shape
    constants = np.broadcast_to(np.eye(ny if offset else 0, ny).T, (rows, ny, ny if offset else 0))
    X = np.concatenate([motion, constants], axis=2).reshape(rows * ny, -1)
    target = (miss / size[:, None]).T
    wanted = target[:rows].reshape(-1)
    if offset and rows < n:
        # After the motion has died away the constant is alone: all those samples are one row of their mean.
        rest = np.sqrt(n - rows)
        X = np.vstack([X, rest * np.eye(ny, states + ny, k=states)])
        wanted = np.concatenate([wanted, rest * target[rows:].mean(axis=0)])
    found = _least_squares(X, wanted)
    out = np.zeros((n, ny))
    out[:rows] = (X[: rows * ny, :states] @ found[:states]).reshape(rows, ny)
    x0 = found[:states] if states else np.zeros(len(A))
    return x0, np.asarray(((out + (found[states:] if offset else 0.0)) * size).T)


def _motion(A: FloatArray, C: FloatArray, n: int) -> FloatArray:
    """Return C A^t `(rows, ny, n_x)`, as long as the motion counts."""
    rows, x, largest = [], C, np.zeros(len(A))
    for _ in range(n):
        size = np.linalg.norm(x, axis=0)
        largest = np.maximum(largest, size)
        if rows and np.all(size <= GONE * largest):
            break
        rows.append(x)
        x = x @ A
    return np.stack(rows)


def _least_squares(X: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the solution with columns of unit size, so that the units of states do not decide which are told apart."""
    size = np.linalg.norm(X, axis=0)
    size[size == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(X / size, wanted, rcond=None)[0] / size)


def ahead(A: FloatArray, C: FloatArray, K: FloatArray, e: FloatArray, steps: int) -> FloatArray:
    """Return what a prediction `steps` samples ahead misses: e(t) + sum_{i=1}^{steps-1} C A^{i-1} K e(t - i)."""
    miss, gain = e.copy(), K
    for i in range(1, min(steps, e.shape[1])):
        miss[:, i:] += C @ gain @ e[:, :-i]
        gain = A @ gain
    return miss


def _zero(A: FloatArray) -> FloatArray:
    return np.zeros(A.shape[0])
