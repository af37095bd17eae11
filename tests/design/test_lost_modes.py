"""Unstable modes that no controller moves are found, and none is feigned, whatever the units of channels and states."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.design.stabilisability import lost_modes

POLES = (1.01, 0.9, 0.8, 0.5, -0.3, 0.2)


def drawn(rng, reached, seen):
    """Return A, B, C of a plant of two inputs and outputs whose unstable mode is reached and seen, or not."""
    B, C = rng.standard_normal((6, 2)), rng.standard_normal((2, 6))
    B[0] *= reached
    C[:, 0] *= seen
    T = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    return T @ np.diag(POLES) @ T.T, T @ B, C @ T.T


@pytest.mark.parametrize("far", ["inputs", "outputs", "states", "all"])
@pytest.mark.parametrize(("reached", "seen", "said"), [(1, 1, ""), (0, 1, "out of reach"), (1, 0, "does not show")])
def test_far_units_hide_and_feign_no_lost_mode(rng, far, reached, seen, said):
    for _ in range(30):
        A, B, C = drawn(rng, reached, seen)
        u, y, x = (
            10 ** rng.uniform(-9, 9, size) if far in (kind, "all") else np.ones(size)
            for kind, size in (("inputs", 2), ("outputs", 2), ("states", 6))
        )
        plant = uq.StateSpace(A * x / x[:, None], B / x[:, None] * u, y[:, None] * C * x, np.zeros((2, 2)), 100.0)
        sentence = lost_modes("Design", plant)
        assert (said in sentence) if said else not sentence
