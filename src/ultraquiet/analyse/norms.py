"""Norms of systems."""

import numpy as np

from ultraquiet.linalg import norms
from ultraquiet.linalg.balance import modal, stable_first
from ultraquiet.linalg.equations import lyapunov, stein
from ultraquiet.linalg.even import connected, even_states
from ultraquiet.linalg.ordered import Array
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace


@takes_systems
def hinf_norm(G: StateSpace, tolerance: float = 1e-7) -> tuple[float, float]:
    """Return the H-infinity norm of a system and the frequency at which it is reached.

    ||G|| = sup over f of the largest singular value of G(f).

    Args:
        G: system, continuous or discrete.
        tolerance: relative accuracy.

    Returns:
        `(norm, f_hz)`: the norm in output units per input unit; infinity for an unstable system, at the frequency of
        its fastest growing mode, or of one that rounding does not tell from the stability boundary. `f_hz` is infinite
        when a continuous gain is approached only as f grows.

    The number is the greatest amplification of energy from any input to the output. It is exact: the level climbs until
    a Hamiltonian has no imaginary eigenvalue left, so no grid of frequencies can miss a peak.

    >>> lag = StateSpace([[-1.0]], [[1.0]], [[2.0]], [[0.0]])
    >>> norm, f_hz = hinf_norm(lag)
    >>> round(norm, 6), f_hz
    (2.0, 0.0)

    Bruinsma and Steinbuch 1990, doi:10.1016/0167-6911(90)90049-Z.
    """
    discrete = G.rate_hz is not None
    if G.boundary_hz().size:
        gain, w = np.inf, norms.least_damped(G.poles(), discrete)
    else:
        gain, w = norms.peak_gain(G.A, G.B, G.C, G.D, discrete, tolerance)
    return gain, w / (2 * np.pi) * (1.0 if G.rate_hz is None else G.rate_hz)


@takes_systems
def h2_norm(G: StateSpace) -> float:
    """Return the H2 norm, the standard deviation of the output (summed over channels) to white unit noise.

    ||G||^2 = trace(B' Q B) + trace(D' D) with Q = A' Q A + C' C (discrete), A' Q + Q A + C' C = 0 (continuous).

    Args:
        G: system. Discrete: unit variance per sample; continuous: unit two-sided intensity.

    Returns:
        The norm; infinity for an unstable system and for a continuous one with direct feedthrough.

    >>> round(h2_norm(StateSpace([[0.6]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)), 6)
    1.25
    """
    if G.boundary_hz().size:
        return float(np.inf)
    return _mean_square_gain(G.A, G.B, G.C, G.D, G.rate_hz is not None)


@takes_systems
def l2_norm(G: StateSpace) -> float:
    """Return the L2 norm, the root mean square of the response over all frequencies, of an unstable system too.

    ||G||^2 = 1 / (2 pi) integral of trace(G(jw)^H G(jw)) dw, discrete: over one turn of the unit circle.

    Args:
        G: system without poles on the stability boundary.

    Returns:
        The norm, that of `h2_norm` for a stable system; infinity with a pole on the boundary, and for a continuous
        system with direct feedthrough.

    For an unstable system the number is no standard deviation of anything: it compares responses, as a model's error.

    >>> round(l2_norm(StateSpace([[1.0]], [[1.0]], [[2.0]], [[0.0]])), 6)
    1.414214
    """
    return _axis_mean_square(G.A, G.B, G.C, G.D, G.rate_hz is not None)


def _mean_square_gain(A: Array, B: Array, C: Array, D: Array, discrete: bool) -> float:
    """Return the H2 norm; infinite for unstable systems and for continuous ones with feedthrough."""
    poles = np.linalg.eigvals(A)
    if poles.size and (np.abs(poles).max() >= 1 if discrete else poles.real.max() >= 0):
        return np.inf
    if not discrete and np.any(D != 0):
        return np.inf
    # even blocks: a lightly damped mode beside a large coupling would lose its digits
    form = modal(*even_states(*connected(A, B, C))[:3])
    B = form.B
    Q = (stein if discrete else lyapunov)(form.A.T, form.C.T @ form.C)
    total = np.trace(B.T @ Q @ B) + (np.sum(D * D) if discrete else 0.0)
    return float(np.sqrt(max(total, 0.0)))


def _axis_mean_square(A: Array, B: Array, C: Array, D: Array, discrete: bool) -> float:
    """Return the L2 norm, the mean square of the response over frequency; finite for unstable systems as well.

    Stable and unstable part are orthogonal; the unstable one counts by its image, mirrored at the stability boundary.
    """
    A, B, C, _ = even_states(A, B, C)
    T, inverse, stable = stable_first(A, discrete)
    A, B, C = inverse @ A @ T, inverse @ B, C @ T
    good, bad = slice(stable), slice(stable, None)
    a, b, c = A[bad, bad], B[bad], C[:, bad]
    if discrete and len(a):
        # C (zI - A)^-1 B = -C A^-1 B - z C A^-2 B - ...: a constant, and powers of z that decay
        E = np.linalg.inv(a)
        D, (a, c) = D - c @ E @ b, (E, c @ E @ E)
    elif len(a):
        a, b = -a, -b
    kept = _mean_square_gain(A[good, good], B[good], C[:, good], D, discrete)
    return float(np.hypot(kept, _mean_square_gain(a, b, c, np.zeros(D.shape), discrete)))
