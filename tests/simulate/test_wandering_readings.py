"""Loops whose readings wander: what drifts is no growth, and growth is not taken for a drift."""

import numpy as np
import pytest
from drawn_loops import RATE_HZ, LinearBench, modal

import ultraquiet as uq

LOOPS = 40


class Wandering(LinearBench):
    """A bench whose every reading takes a random walk besides, of `wander` times the root of the seconds."""

    wander = 0.0

    def noise(self, samples):
        """Return white noise and what has added up, `(samples, ny)`."""
        steps = self._rng.standard_normal((samples, len(self.sensors)))
        return super().noise(samples) + self.wander / np.sqrt(RATE_HZ) * np.cumsum(steps, axis=0)


def slow_loop(rng, growth_per_s, wander):
    """Return a wandering bench with four modes and one state at 0 Hz that grows or decays so fast, and next to no law.

    Nothing of the law moves a pole by more than rounding: what the bench does by itself is the truth.
    """
    ny, nu = ((1, 1), (2, 2), (4, 3), (3, 5))[rng.integers(4)]
    A, B, C = modal(rng, ny, nu)
    if growth_per_s is not None:
        pole = np.exp(growth_per_s / RATE_HZ)
        A = np.block([[A, np.zeros((8, 1))], [np.zeros((1, 8)), np.array([[pole]])]])
        B = np.vstack([B, 3.0 / RATE_HZ * rng.standard_normal((1, nu))])
        C = np.hstack([C, rng.standard_normal((ny, 1))])
    bench = Wandering(A, B, C, 0.01, np.random.default_rng(rng.integers(2**32)), (25.0, 10.0))
    bench.wander = wander
    return bench, uq.StateSpace(
        np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), 1e-9 * rng.standard_normal((nu, ny)), RATE_HZ
    )


def test_readings_that_wander_are_no_growth(rng):
    """One of them; forty, and what grows beside, are in the long run."""
    check = uq.simulate.check_stability(*slow_loop(rng, None, 0.01), 4.0)
    print(check.status)
    assert check.status.word != "unstable"


@pytest.mark.parametrize("growth_per_s", [1.0, -1.0])
def test_growth_beside_a_drift_is_told(rng, growth_per_s):
    """A walk for ever neither grows nor decays, so that a loop that decays beside one need not be known to."""
    check = uq.simulate.check_stability(*slow_loop(rng, growth_per_s, 0.01), 16.0)
    print(check.status)
    assert check.status.word in ({"unstable"} if growth_per_s > 0 else {"ok", "not known"})


@pytest.mark.slow
def test_forty_drifts_are_never_judged_wrongly(rng):
    """Without a slow state, and with one that grows or decays by 3 to 0.03 a second, walks of all sizes."""
    false = unknown = 0
    for k in range(LOOPS):
        growth = None if k % 4 == 0 else 3.0 * 10 ** -rng.uniform(0, 2) * rng.choice([-1, 1])
        bench, law = slow_loop(rng, growth, 10 ** rng.uniform(-4, -1))
        check = uq.simulate.check_stability(bench, law)
        word, grows = check.status.word, growth is not None and growth > 0
        false += word in ("ok", "unstable") and (word == "unstable") != grows
        unknown += word == "not known"
        if word != ("unstable" if grows else "ok"):
            print(f"true {growth}, walk {bench.wander:.2g}: {check.status}")
    print(f"{LOOPS} loops: {false} false, {unknown} not known")
    assert false == 0
