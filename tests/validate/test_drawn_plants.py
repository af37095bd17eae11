"""Plants drawn from a covariance have it."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.analyse import monte_carlo
from ultraquiet.validate import drawn_plants, response_band
from ultraquiet.values.interconnect import gain

RATE_HZ = 100.0


@pytest.fixture
def result(rng):
    truth = uq.PolynomialModel(b=[[0.0, 0.5, 0.2]], f=[[1.0, -1.2, 0.5]], rate_hz=RATE_HZ)
    u = rng.standard_normal(3000)
    y = truth.state_space().simulate(u[None])[0] + 0.2 * rng.standard_normal(3000)
    return uq.identify.OutputError(order=2).identify(uq.Record(u, y, RATE_HZ))


def test_their_spread_is_that_of_the_band(result, seed):
    f = np.array([1.0, 10.0, 30.0])
    drawn = np.array([p.frequency_response(f)[0, 0] for p in drawn_plants(result, 600, seed)])
    ratio = np.mean(np.abs(drawn - drawn.mean(axis=0)) ** 2, axis=0) / response_band(result, f).variance[0, 0]
    print(f"variance drawn over variance promised: {ratio.round(3).tolist()}")
    assert np.all(np.abs(ratio - 1) < 0.3)
    again = next(drawn_plants(result, 1, seed))
    assert np.array_equal(again.frequency_response(f)[0, 0], drawn[0])


@pytest.mark.slow
def test_a_loop_over_the_covariance(result, seed):
    found = monte_carlo(drawn_plants(result, 50, seed), gain([[-0.2]], RATE_HZ), (0.0, 5.0))
    print(found.status())
    assert found.share_stable == 1.0
    assert found.share_interval()[0] > 0.9
    spread = found.quantile("worst_direction_db", 0.95) - found.quantile("worst_direction_db", 0.05)
    assert 0 < spread < 1.0


def test_models_without_covariance_are_refused(rng):
    plant = uq.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ)

    class Result:
        model, covariance = plant, np.zeros((1, 0, 0))

    with pytest.raises(InputError, match="take 'state_space_band', a polynomial method"):
        drawn_plants(Result(), 3)
