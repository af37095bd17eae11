"""A loop that is slow at a tone: the run grows with it, and what had not settled is said, never read as a poor law."""

import numpy as np
import pytest
from scipy.signal import cont2discrete

import ultraquiet as uq
from ultraquiet._base.errors import InputError, InterlockError
from ultraquiet.bench import Wrapped
from ultraquiet.values import StateSpace

RATE_HZ, TONE_HZ = 200.0, 5.0


def stage(settles_s, noise=0.0, longest_s=np.inf, outputs=1):
    """Return a damped stage of 3 Hz as a bench, and a resonator at the tone whose loop settles with a time constant."""
    w = 2 * np.pi * 3.0
    continuous = [np.array(each) for each in ([[0, 1], [-w * w, -1.4 * w]], [[0], [w * w]], [[1.0, 0]], [[0.0]])]
    A, B, C, *_ = cont2discrete(continuous, 1 / RATE_HZ)
    angle = 2 * np.pi * TONE_HZ / RATE_HZ
    reach = (C @ np.linalg.solve(np.exp(1j * angle) * np.eye(2) - A, B))[0, 0]
    gain, phase = 2 / (settles_s * RATE_HZ) / abs(reach), angle - np.angle(reach)
    turn = (1 - 1e-6) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    sees = np.vstack([np.eye(1, outputs), np.zeros((1, outputs))])
    law = StateSpace(turn, sees, -gain * np.array([[np.cos(phase), -np.sin(phase)]]), np.zeros((1, outputs)), RATE_HZ)
    state, ran, rng = np.zeros(2), [0], np.random.default_rng(1)

    def step(u, d):
        nonlocal state
        ran[0] += 1
        if ran[0] > longest_s * RATE_HZ:
            raise InterlockError("the run took too long", "duration", ran[0], ran[0] / RATE_HZ)
        y = np.arange(1.0, outputs + 1) * (C @ state) + noise * rng.standard_normal(outputs)
        state = A @ state + B @ (u + d)
        return y

    def reset():
        nonlocal state
        state, ran[0] = np.zeros(2), 0

    return Wrapped(step, reset, RATE_HZ, ["coil"], [f"gap {k}" for k in range(outputs)]), law


class Brief:
    """A bench that refuses long runs before it moves, as hardware does."""

    def __init__(self, bench):
        self._bench = bench

    def __getattr__(self, name):
        return getattr(self._bench, name)

    def run(self, u, disturbance=None, controller=None):
        if np.shape(u)[1] > 4 * RATE_HZ:
            raise InputError("a run that long is refused; nothing was moved")
        return self._bench.run(u, disturbance=disturbance, controller=controller)


@pytest.mark.gate("1-0.1-0.0", "3-0.5-0.001", "1-2.0-0.001", "3-5.0-0.0", "3-20.0-0.001")
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("settles_s", [0.1, 0.5, 2.0, 5.0, 20.0])
@pytest.mark.parametrize("outputs", [1, 3])
def test_what_is_said_to_have_settled_has(settles_s, noise, outputs):
    bench, law = stage(settles_s, noise, outputs=outputs)
    found = uq.simulate.attenuation(bench, law, (TONE_HZ,), 1.0, 2.0)
    run_s, reduction = found.closed[0].duration_s, found.worst_reduction_db[0]
    print(f"{settles_s} s, noise {noise}: {reduction:.1f} dB after {run_s:.0f} s, settled {found.settled[0]}")
    assert found.opened[0].samples == found.closed[0].samples
    if found.settled[0]:
        later = uq.simulate.attenuation(bench, law, (TONE_HZ,), 1.0, 2 * run_s)
        assert later.worst_reduction_db[0] - reduction < 0.5 or np.any(found.closed_v[0] < 5 * found.floor_v[0])
    else:
        assert run_s == 32.0
    if settles_s == 0.1:
        assert found.settled == (True,)
        assert run_s == 2.0
    if settles_s >= 5.0:
        assert found.settled == (False,)


@pytest.mark.parametrize("beforehand", [False, True])
def test_a_bench_that_runs_no_longer_keeps_what_it_showed(beforehand):
    bench, law = stage(5.0, longest_s=4.0)
    if beforehand:
        bench = Brief(bench)
    found = uq.simulate.attenuation(bench, law, (TONE_HZ,), 1.0, 2.0)
    print(found.settled, found.closed[0].duration_s)
    assert found.closed[0].duration_s == 2.0
    assert found.settled == (False,)
