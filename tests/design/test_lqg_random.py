"""LQG on random stable plants: a verified controller or a sentence, nothing else."""

from collections import Counter

import numpy as np
import pytest
from random_plants import random_stable
from scipy.linalg import matrix_balance

from ultraquiet.design import Lqg
from ultraquiet.linalg.ordered import Array

REFUSED = 0.01  # share of plants that may be refused
SPARE = 2  # refusals of a short run beyond that share, which chance may bring
AGREEMENT = 1e-3
NOTHING = 1e-12  # a cost that is zero but for round-off
EACH = 2  # every other plant's cost is computed again, which takes longer than the design
DOUBLINGS = 40  # 2^40 samples


def settings_for(rng, plant, fitting):
    """Return random settings; frequencies follow the rate, weights the plant's gain when they are to be `fitting`."""
    rate_hz = plant.rate_hz
    f_hz = np.geomspace(rate_hz / 1e4, rate_hz / 2, 50)
    gain = np.median(np.linalg.norm(np.moveaxis(plant.frequency_response(f_hz), 2, 0), 2, axis=(1, 2)))
    size = max(gain, 1e-12) ** 2 if fitting else 1.0
    low = rate_hz * 10 ** rng.uniform(-3.5, -1.5)
    chosen = {
        "band_hz": (low, 8 * low) if rng.random() < 0.7 else None,
        "band_order": int(rng.choice([2, 4, 8])),
        "control_weight": size * 10 ** rng.uniform(-6, 2),
        "sensor_noise": 10 ** rng.uniform(-4, 0),
        "disturbance_at": str(rng.choice(["input", "output"])),
        "estimator": str(rng.choice(["current", "predicted"])),
    }
    if chosen["disturbance_at"] == "input":
        chosen["disturbance"] = 1.0 / size
    if rng.random() < 0.3:
        chosen |= {"recovery": 10 ** rng.uniform(0, 4), "recovery_at": str(rng.choice(["input", "output"]))}
    if rng.random() < 0.3:
        chosen["control_hz"] = rate_hz * 10 ** rng.uniform(-2, -0.5)
    if rng.random() < 0.2:
        chosen |= {"integral_hz": low, "integral_leak_hz": low / 30}
    if rng.random() < 0.2:
        chosen["band_at"] = "loop"
    return chosen


def closed(P, K) -> tuple[Array, Array, Array, Array]:
    """Return the loop u = K y round a generalised plant, written without the package's interconnections.

    Controls and measurements are found together: their direct loop may be large, and one after the other loses digits.
    """
    nu, ny = K.D.shape
    p, m, n, k = P.D.shape[0] - ny, P.D.shape[1] - nu, P.states, K.states
    joint = np.block([[np.eye(nu), -K.D], [-P.D[p:, m:], np.eye(ny)]])
    driven = np.block([[np.zeros((nu, n)), K.C, np.zeros((nu, m))], [P.C[p:], np.zeros((ny, k)), P.D[p:, :m]]])
    u, y = np.split(np.linalg.solve(joint, driven), [nu])
    state = np.vstack(
        [np.hstack([P.A, np.zeros((n, k)), P.B[:, :m]]), np.hstack([np.zeros((k, n)), K.A, np.zeros((k, m))])]
    )
    state += np.vstack([P.B[:, m:] @ u, K.B @ y])
    out = np.hstack([P.C[:p], np.zeros((p, k)), P.D[:p, :m]]) + P.D[:p, m:] @ u
    return state[:, : n + k], state[:, n + k :], out[:, : n + k], out[:, n + k :]


def deviation(P, K) -> float:
    """Return the standard deviation of the cost under white noise: the series of A^k B B' A'^k, summed by doubling.

    SciPy's solvers of the Lyapunov equation lose the cost of loops whose poles lie within 1e-6 of the unit circle.
    """
    A, B, C, D = closed(P, K)
    with np.errstate(invalid="ignore"):  # SciPy also casts the scale to integers
        A, (scale, _) = matrix_balance(A, separate=True, permute=False)
    B, C = B / scale[:, None], C * scale
    X, power = B @ B.T, A
    for _ in range(DOUBLINGS):
        X = X + power @ X @ power.T
        power = power @ power
    return float(np.sqrt(max(np.trace(C @ X @ C.T), 0.0) + np.sum(D**2)))


def judge(rng, count, fitting=True):
    """Return counts of words and the sentences of what was not solved."""
    words, sentences = Counter(), []
    for k in range(count):
        plant = random_stable(rng)
        settings = settings_for(rng, plant, fitting) | {"disk_margin": 0.0}
        result = Lqg(**settings).design(plant)
        words[result.status.word] += 1
        if not result.status.ok:
            assert len(str(result.status)) > 20
            sentences.append(f"{k}: {plant.states} states, {plant.D.shape}, {settings}: {result.status}")
            assert result.controller is None or result.status.word == "unstable"
            continue
        radius = np.abs(np.linalg.eigvals(closed(plant, result.controller)[0])).max()
        assert radius < 1, f"called ok with a pole of modulus {radius}: {settings}"
        if k % EACH == 0 and "integral_hz" not in settings and "band_at" not in settings:
            cost = deviation(Lqg(**settings).generalised(plant), result.controller)
            assert abs(result.gamma - cost) <= AGREEMENT * cost + NOTHING, (
                result.gamma,
                cost,
                result.achieved,
                settings,
            )
    return words, sentences


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("count", [3, pytest.param(1000, marks=pytest.mark.slow)])
def test_lqg_on_random_stable_plants(rng, count, cases):
    count = cases(count)
    words, sentences = judge(rng, count)
    print(f"LQG on {count} random stable plants: {dict(words)}")
    print(*sentences, sep="\n")
    assert words["ok"] >= (1 - REFUSED) * count - SPARE


@pytest.mark.slow
@pytest.mark.parametrize("count", [60])
def test_weights_out_of_all_proportion_are_designed_for_or_refused(rng, count):
    """Weights of order one on plants whose gain lies anywhere in twelve decades: judged alike, a sentence otherwise."""
    words, sentences = judge(rng, count, fitting=False)
    print(f"LQG with weights out of proportion: {dict(words)}")
    assert all("weight on u" in s for s in sentences), sentences
