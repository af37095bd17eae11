"""LQG on random stable plants: a verified controller or a sentence, nothing else."""

from collections import Counter

import numpy as np
import pytest
from random_plants import random_stable
from scipy.linalg import matrix_balance, solve_discrete_lyapunov

from ultraquiet.design import Lqg
from ultraquiet.linalg.ordered import Array
from ultraquiet.values import StateSpace

REFUSED = 0.01  # share of plants that may be refused
AGREEMENT = 1e-3


def settings_for(rng, rate_hz):
    """Return random settings; frequencies follow the rate."""
    low = rate_hz * 10 ** rng.uniform(-3.5, -1.5)
    chosen = {
        "band_hz": (low, 8 * low) if rng.random() < 0.7 else None,
        "band_order": int(rng.choice([2, 4, 8])),
        "control_weight": 10 ** rng.uniform(-8, 2),
        "sensor_noise": 10 ** rng.uniform(-4, 0),
        "disturbance_at": str(rng.choice(["input", "output"])),
        "estimator": str(rng.choice(["current", "predicted"])),
    }
    if rng.random() < 0.3:
        chosen |= {"recovery": 10 ** rng.uniform(0, 4), "recovery_at": str(rng.choice(["input", "output"]))}
    if rng.random() < 0.3:
        chosen["control_hz"] = rate_hz * 10 ** rng.uniform(-2, -0.5)
    if rng.random() < 0.2:
        chosen |= {"integral_hz": low, "integral_leak_hz": low / 30}
    if rng.random() < 0.2:
        chosen["band_at"] = "loop"
    return chosen


def closed_loop(plant, K) -> Array:
    """Return A of the loop u = K y, written without the package's interconnections; well posed or it raises."""
    wrap = np.linalg.inv(np.eye(K.D.shape[0]) - K.D @ plant.D)
    u = wrap @ np.hstack([K.D @ plant.C, K.C])
    y = np.hstack([plant.C, np.zeros((plant.D.shape[0], K.states))]) + plant.D @ u
    top = np.hstack([plant.A, np.zeros((plant.states, K.states))]) + plant.B @ u
    return np.vstack([top, np.hstack([np.zeros((K.states, plant.states)), K.A]) + K.B @ y])


def deviation(P, K) -> float:
    """Return the standard deviation of the cost under white noise, by SciPy's Lyapunov solver."""
    nu, ny = K.D.shape
    p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
    plant = StateSpace(P.A, P.B[:, m:], P.C[p:], P.D[p:, m:], P.rate_hz)
    A = closed_loop(plant, K)
    wrap = np.linalg.inv(np.eye(nu) - K.D @ plant.D)
    u = wrap @ np.hstack([K.D @ plant.C, K.C, K.D @ P.D[p:, :m]])
    y = np.hstack([plant.C, np.zeros((ny, K.states)), P.D[p:, :m]]) + plant.D @ u
    n = P.states + K.states
    B = np.vstack([P.B[:, :m] + plant.B @ u[:, n:], K.B @ y[:, n:]])
    C = np.hstack([P.C[:p], np.zeros((p, K.states))]) + P.D[:p, m:] @ u[:, :n]
    D = P.D[:p, :m] + P.D[:p, m:] @ u[:, n:]
    A, (scale, _) = matrix_balance(A, separate=True, permute=False)
    B, C = B / scale[:, None], C * scale
    X = solve_discrete_lyapunov(A, B @ B.T)
    return float(np.sqrt(np.trace(C @ X @ C.T) + np.sum(D**2)))


def judge(rng, count):
    """Return counts of words and the sentences of what was not solved."""
    words, sentences = Counter(), []
    for k in range(count):
        plant = random_stable(rng)
        settings = settings_for(rng, plant.rate_hz)
        result = Lqg(**settings).design(plant)
        words[result.status.word] += 1
        if not result.status.ok:
            assert len(str(result.status)) > 20
            sentences.append(f"{k}: {plant.states} states, {plant.D.shape}, {settings}: {result.status}")
            assert result.controller is None or result.status.word == "unstable"
            continue
        radius = np.abs(np.linalg.eigvals(closed_loop(plant, result.controller))).max()
        assert radius < 1, f"called ok with a pole of modulus {radius}: {settings}"
        if "integral_hz" not in settings and "band_at" not in settings:
            cost = deviation(Lqg(**settings).generalised(plant), result.controller)
            assert abs(result.gamma - cost) <= AGREEMENT * cost, (result.gamma, cost, result.achieved, settings)
    return words, sentences


@pytest.mark.parametrize("count", [150, pytest.param(1000, marks=pytest.mark.slow)])
def test_lqg_on_random_stable_plants(rng, count):
    words, sentences = judge(rng, count)
    print(f"LQG on {count} random stable plants: {dict(words)}")
    print(*sentences, sep="\n")
    assert words["ok"] >= (1 - REFUSED) * count
