"""The Riccati equation of 180 states: a 6 x 6 array of modes at 3.5 kHz, in modal and in raw coordinates."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from ultraquiet._base.threads import single_threaded
from ultraquiet.linalg import discretize
from ultraquiet.linalg.equations import discrete_riccati

MODES, RATE_HZ = 90, 3500.0
LIMIT_S, RESIDUAL = 0.1, 1e-9
REPEATS = 5
CONTROL_WEIGHT = 1e-2
Array = NDArray[np.float64]


def measure() -> Iterator[tuple[str, str, str, bool]]:
    rng = np.random.default_rng(0)
    for kind, (A, B, C) in arrays(rng).items():
        Q, R = C.T @ C, CONTROL_WEIGHT * np.eye(6)
        ours, seconds = timed(lambda A=A, B=B, Q=Q, R=R: discrete_riccati(A, B, Q, R).X)
        theirs, peer = timed(lambda A=A, B=B, Q=Q, R=R: solve_discrete_are(A, B, Q, R), 1)
        found, reference = errors(A, B, Q, R, ours), errors(A, B, Q, R, theirs)
        what = f"DARE, {len(A)} states, {kind} coordinates"
        yield f"{what}: time", f"{seconds:.3f} s", f"under {LIMIT_S:g} s", seconds < LIMIT_S
        told = f"{found[0]:.1e} (SciPy {reference[0]:.1e})"
        yield "its relative residual", told, f"under {RESIDUAL:g}", found[0] < RESIDUAL
        yield "its closed loop", f"largest modulus {found[1]:.6f}", "under 1", found[1] < 1
        yield "SciPy's time over it", f"{peer / seconds:.1f}", "above 1", peer > seconds


def arrays(rng: np.random.Generator) -> dict[str, tuple[Array, Array, Array]]:
    """Return A, B, C of one array of modes of 5 to 1500 Hz, twice: modal, and [q; q'] in millivolts and megavolts."""
    w = 2 * np.pi * np.geomspace(5, 1500, MODES) * np.exp(rng.uniform(-0.05, 0.05, MODES))
    zeta = rng.uniform(0.002, 0.03, MODES)
    shapes = rng.standard_normal((MODES, 6))
    seen = shapes + 0.2 * rng.standard_normal((MODES, 6))
    zero, one = np.zeros((MODES, MODES)), np.eye(MODES)
    raw = np.block([[zero, one], [-np.diag(w**2), -np.diag(2 * zeta * w)]])
    modal = np.block([[zero, np.diag(w)], [-np.diag(w), -np.diag(2 * zeta * w)]])
    B, C = np.vstack([0 * shapes, shapes]), np.hstack([0 * seen.T, seen.T])
    found = {}
    for kind, A, b, c in (("modal", modal, B, C), ("raw", raw, 1e3 * B, 1e-6 * C)):
        M = discretize.zero_order_hold(A, b, c, np.zeros((6, 6)), 1 / RATE_HZ)
        found[kind] = M[0], M[1], M[2]
    return found


def errors(A: Array, B: Array, Q: Array, R: Array, X: Array) -> tuple[float, float]:
    """Return the relative residual of a solution and the largest modulus of its closed loop's poles."""
    K = np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A)
    terms = (A.T @ X @ A, -X, -A.T @ X @ B @ K, Q)
    residual = np.linalg.norm(sum(terms)) / sum(np.linalg.norm(t) for t in terms)
    return float(residual), float(np.abs(np.linalg.eigvals(A - B @ K)).max())


@single_threaded
def timed(solve: Callable[[], Any], repeats: int = REPEATS) -> tuple[Array, float]:
    """Return what was solved and the shortest time of some tries, processor time of this thread."""
    best, X = np.inf, np.zeros((0, 0))
    for _ in range(repeats):
        begun = time.thread_time()
        X = solve()
        best = min(best, time.thread_time() - begun)
    return X, best
