"""What a slow mode leaves in a residual is seen, and noise alone is not taken for it."""

import numpy as np
from scipy.signal import lfilter

from ultraquiet.linalg import portmanteau

RATE_HZ, SAMPLES, LAGS = 3500.0, 8000, 40


def test_a_slow_remainder_is_seen_over_its_period_though_not_at_single_lags():
    w = 2 * np.pi * 7.4 / RATE_HZ
    pole = np.exp(w * (-0.5 + 1j * np.sqrt(0.75)))
    short, spanning = [], []
    for k in range(10):
        u, e = np.random.default_rng(k).standard_normal((2, SAMPLES))
        slow = lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], u)
        e = e + 0.3 * slow / slow.std()
        period = portmanteau.slowest_period(np.array([pole, pole.conj()]))
        short.append(portmanteau.free_of_inputs(e, u[None], LAGS, 200))
        spanning.append(portmanteau.free_of_inputs(e, u[None], LAGS, 200, period))
    print(
        f"seen in {np.mean(np.array(spanning) < 1e-3):.0%} over a period, {np.mean(np.array(short) < 1e-3):.0%} without"
    )
    assert np.mean(np.array(spanning) < 1e-3) >= 0.8
    assert np.mean(np.array(short) < 1e-3) <= 0.2


def test_noise_alone_alarms_as_often_as_it_says():
    # 200 draws at 5 %: 10 expected, more than 22 once in 2000 campaigns
    alarms = 0
    for k in range(200):
        rng = np.random.default_rng(k)
        u, e = rng.standard_normal((2, 3000)), rng.standard_normal(3000)
        alarms += portmanteau.free_of_inputs(e, u, LAGS, 0, 400) < 0.05
    assert alarms <= 22


def test_the_slowest_period_is_bounded_by_what_poles_can_say():
    assert portmanteau.slowest_period(np.array([1.0 + 0j])) == int(np.ceil(2 * np.pi / portmanteau.NEAR_ONE))
    assert portmanteau.slowest_period(np.array([0.0 + 0j])) == 2
