"""Residual tests of identified models: alarms as often as promised on good ones, and on wrong orders nearly always."""

import numpy as np
import pytest
from campaigns import draw

import ultraquiet as uq

LEVELS = (0.05, 0.01)
SIGMAS = 4.0  # binomial deviations allowed: twelve rates are looked at in every run
# A quarter of a point at 5 %: the statistics are chi-squared only in the limit of long records.
LIMIT_ERROR = 0.05


def p_values(rng, count, order=5):
    """p-values of whiteness, past and future input on the fitted record and on a second one."""
    rows = {"this record": [], "another record": []}
    for _ in range(count):
        first, second = draw("suite_rate", rng), draw("suite_rate", rng)
        result = uq.identify.BoxJenkins(order=order).identify(first.record)
        if order == 5 and result.loss[0] > 1.02 * np.mean(first.innovations**2):
            continue  # another minimum: not a correctly identified model
        own = uq.validate.residual_test(result.model, first.record)
        other = uq.validate.residual_test(result.model, second.record, covariance=result.covariance)
        for test in (own, other):
            rows[test.origin].append([test.whiteness_p[0], test.correlation_p[0, 0], test.feedback_p[0, 0]])
    return {k: np.array(v) for k, v in rows.items()}


def rates(rng, draws):
    missed = []
    for origin, p in p_values(rng, draws).items():
        for level in LEVELS:
            share = np.mean(p < level, axis=0)
            off = SIGMAS * np.sqrt(level * (1 - level) / len(p)) + LIMIT_ERROR * level
            print(f"\n{origin}, {len(p)} draws, at {level:.0%}: white {share[0]:.1%}, past {share[1]:.1%}, ", end="")
            print(f"future {share[2]:.1%}; allowed {max(0, level - off):.1%} to {level + off:.1%}", end="")
            missed += [(origin, level, x) for x in share if abs(x - level) > off]
    assert not missed


@pytest.mark.slow
@pytest.mark.draws(false_alarm=8e-4)  # binomial, twelve rates
def test_alarms_over_a_thousand_models(rng):
    rates(rng, 1000)


@pytest.mark.slow
@pytest.mark.draws(false_alarm=1.2e-2)  # binomial: more than 12 of 80 at 5 %, more than 4 at 1 %, six times each
def test_alarms_over_eighty_models(rng):
    rates(rng, 80)


@pytest.mark.slow
@pytest.mark.draws(false_alarm=0.1)  # 13 of 160 draws catch fewer, records of order 3 most of them
def test_power_against_orders_too_low(rng):
    """Order 4 gives up the plant's real pole at 200 Hz, which some records hardly show: it is printed alone."""
    caught = []
    for order in (2, 3, 4):
        for origin, p in p_values(rng, 8, order).items():
            seen = p[:, :2].min(axis=1) < 1e-3
            print(f"\norder {order}, {origin}: {np.mean(seen):.0%} caught at 0.1 %", end="")
            if order < 4:
                caught.extend(seen)
    assert np.mean(caught) >= 7 / 8
