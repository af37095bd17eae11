"""Changes of time: zero-order hold, the bilinear map in both directions, pure delay."""

import numpy as np
from scipy.linalg import expm
from scipy.linalg.lapack import dgebal  # pyright: ignore[reportAttributeAccessIssue]

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.ordered import Array, Matrices

ROOT_TWO = np.sqrt(2.0)
UNREACHABLE = 1e14  # condition of A + I or I - A beyond which an eigenvalue is at the point that goes to infinity


def zero_order_hold(A: Array, B: Array, C: Array, D: Array, step_s: float) -> Matrices:
    """Return the system whose input is held constant over each step of `step_s` seconds."""
    n, nu = B.shape
    block = np.zeros((n + nu, n + nu))
    block[:n, :n], block[:n, n:] = A * step_s, B * step_s
    exponential = expm(block)
    return exponential[:n, :n], exponential[:n, n:], C.copy(), D.copy()


def bilinear_to_continuous(A: Array, B: Array, C: Array, D: Array) -> Matrices:
    """Map z = (1 + s) / (1 - s): the unit disc onto the left half-plane, gains, norms and state count unchanged.

    Both directions together give back the very system (Al-Saggaf and Franklin 1988). Gramians and solutions of the
    Riccati equations are common to both sides because B and C share the factor 2.

    Raises:
        NumericalError: a pole lies at z = -1, which would go to infinity.
    """
    n = A.shape[0]
    one = np.eye(n)
    _reachable(A + one, "z = -1")
    inverse = np.linalg.inv(A + one) if n else one
    return inverse @ (A - one), ROOT_TWO * inverse @ B, ROOT_TWO * C @ inverse, D - C @ inverse @ B


def bilinear_to_discrete(A: Array, B: Array, C: Array, D: Array) -> Matrices:
    """Map s = (z - 1) / (z + 1), the inverse of `bilinear_to_continuous`.

    Raises:
        NumericalError: a pole lies at s = 1, which would go to infinity.
    """
    n = A.shape[0]
    one = np.eye(n)
    _reachable(one - A, "s = 1")
    inverse = np.linalg.inv(one - A) if n else one
    return inverse @ (one + A), ROOT_TWO * inverse @ B, ROOT_TWO * C @ inverse, D + C @ inverse @ B


def tustin(A: Array, B: Array, C: Array, D: Array, rate_hz: float, exact_hz: float | None = None) -> Matrices:
    """Sample a continuous system by Tustin's rule; its response is kept exactly at `exact_hz` (0 Hz when absent)."""
    k = 2 * rate_hz if not exact_hz else 2 * np.pi * exact_hz / np.tan(np.pi * exact_hz / rate_hz)
    return bilinear_to_discrete(A / k, B / np.sqrt(k), C / np.sqrt(k), D)


def delay(samples: int, channels: int) -> Matrices:
    """Return a delay of whole samples on each of several channels, `samples * channels` states."""
    n, m = samples * channels, channels
    if samples == 0:
        return np.zeros((0, 0)), np.zeros((0, m)), np.zeros((m, 0)), np.eye(m)
    A = np.eye(n, k=-m)
    return A, np.eye(n, m), np.eye(n)[n - m :], np.zeros((m, m))


def _reachable(M: Array, where: str) -> None:
    if not M.shape[0]:
        return
    if not np.all(np.isfinite(M)):
        raise NumericalError(f"bilinear map ({M.shape[0]} states): its matrices overflow; scale the problem.")
    balanced = dgebal(M, scale=1, permute=0)[0]  # so that the units of the states do not count
    if np.linalg.cond(balanced) > UNREACHABLE:
        raise NumericalError(f"bilinear map: the system has a pole at {where}; move it by a small amount first.")
