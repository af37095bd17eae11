"""States that a generalised plant hides: stable, and all but without a part in what its inputs do to its outputs."""

import numpy as np

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg import balance
from ultraquiet.linalg.even import even_states
from ultraquiet.values.state_space import StateSpace

# Share of the largest Hankel value below which a state says nothing: an equation that holds it solves round-off.
HIDDEN = 1e-13
# Poles nearer to the stability boundary, relative to the size of A, are left alone: beside an integrator, whose Hankel
# value has no bound, everything would seem to be hidden.
SLOW = 1e-8


def without_hidden(P: StateSpace) -> tuple[StateSpace, int]:
    """Return a system without the stable states that are hidden or nearly so, and how many were taken off.

    Balanced truncation of the stable part where its Hankel values fall below `HIDDEN` of the largest: what that does to
    the response is at most twice their sum. A system that hides nothing is returned as it is.
    """
    if not P.states:
        return P, 0
    discrete = P.rate_hz is not None
    border = SLOW * float(np.linalg.norm(P.A, 2))
    try:
        # moved (continuous) or blown up (discrete) by the border, so that what is slower than it counts as unstable
        moved = P.A * (1 + SLOW) if discrete else P.A + border * np.eye(P.states)
        T, inverse, stable = balance.stable_first(moved, discrete)
        A, B, C = inverse @ P.A @ T, inverse @ P.B, P.C @ T
        part = slice(stable)
        R, L = balance.gramian_factors(A[part, part], B[part], C[:, part], discrete)
    except (NumericalError, np.linalg.LinAlgError):
        return P, 0  # poles on the boundary: nothing can be said of what is beside them
    values = np.linalg.svd(L.T @ R, compute_uv=False)
    kept = int(np.sum(values > HIDDEN * values.max(initial=0.0)))
    if kept == stable:
        return P, 0
    left, right, _ = balance.balancing_by(R, L, kept)
    n = P.states - stable
    into = np.vstack([np.hstack([left, np.zeros((kept, n))]), np.hstack([np.zeros((n, stable)), np.eye(n)])])
    out = np.vstack([np.hstack([right, np.zeros((stable, n))]), np.hstack([np.zeros((n, kept)), np.eye(n)])])
    A, B, C, _ = even_states(into @ A @ out, into @ B, C @ out)
    return StateSpace(A, B, C, P.D, P.rate_hz), stable - kept
