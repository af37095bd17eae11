"""Anti-windup: nothing changes inside the limits; after them the command comes back sooner."""

import numpy as np
import pytest
from deploy_laws import RATE_HZ

from ultraquiet._base.errors import NumericalError
from ultraquiet.deploy import Twin, conditioning_gain, generate
from ultraquiet.values import StateSpace


def test_conditioned_law_is_stable(law_of):
    law = law_of(40)
    L = conditioning_gain(law.A, law.B, law.C, law.D)
    radius = np.abs(np.linalg.eigvals(law.A - L @ law.C)).max()
    print(f"spectral radius of A - L C: {radius:.6f}, of A: {np.abs(law.poles()).max():.6f}")
    assert L.shape == (40, 6)
    assert radius < 1


def test_invertible_minimum_phase_law_gets_hanus_gain(rng):
    # D large against C (zI - A)^-1 B: minimum phase for certain, and the floor on R is 1e-4 of D D'.
    A = np.diag(rng.uniform(-0.9, 0.9, 4))
    B, C, D = rng.standard_normal((4, 2)), 0.01 * rng.standard_normal((2, 4)), np.diag(rng.uniform(1.0, 2.0, 2))
    L = conditioning_gain(A, B, C, D)
    assert np.allclose(L, B @ np.linalg.inv(D), rtol=0.01, atol=0.01)


def test_inside_the_limits_nothing_changes(law_of, rng, tmp_path):
    law = law_of(20)
    y = rng.standard_normal((6, 300))
    y *= 20.0 / np.abs(law.simulate(y)).max()
    plain, aware = (generate(law, tmp_path / str(k), anti_windup=k, form="modal").law for k in (False, True))
    runs = []
    for held in (plain, aware):
        twin = Twin(held)
        twin.reset()
        runs.append(twin.run(y))
    assert np.array_equal(*runs)


def test_slow_law_leaves_the_limit_at_once(tmp_path):
    # A slow integrating law driven far beyond its limit, then asked for the other direction.
    pole = np.exp(-2 * np.pi * 0.2 / RATE_HZ)
    law = StateSpace([[pole]], [[0.02]], [[1.0]], [[0.05]], rate_hz=RATE_HZ)
    y = np.concatenate([np.full(3500, 50.0), np.full(3500, -50.0)])[None]
    wait = {}
    for aware in (False, True):
        twin = Twin(generate(law, tmp_path / str(aware), "float64", anti_windup=aware).law)
        twin.reset()
        u = twin.run(y)[0, 3500:]
        wait[aware] = int(np.argmax(u < 24.99))
    print(f"samples at the limit after the reversal: {wait[False]} plain, {wait[True]} conditioned")
    assert wait[True] <= 1
    assert wait[False] > 100


def test_gain_that_does_not_exist_is_refused(tmp_path):
    hidden = StateSpace([[1.0, 0.0], [0.0, 0.5]], [[1.0], [1.0]], [[0.0, 1.0]], [[0.0]], rate_hz=RATE_HZ)
    with pytest.raises(NumericalError, match="no anti-windup gain exists"):
        generate(hidden, tmp_path / "code", anti_windup=True)
