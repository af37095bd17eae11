"""The scalar function that a repeated law is designed for."""

import numpy as np
import pytest
from ordinary_plants import ordinary, with_units

from ultraquiet._base.errors import InputError
from ultraquiet.design.mean_channel import mean_channel
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_it_is_the_mean_of_the_eigenvalues(seed, unit):
    plant = with_units(ordinary(np.random.default_rng(seed), (3, 3), modes=3), inputs=unit)
    assert plant.is_stable()
    f = np.geomspace(1e-3, 0.4, 9) * plant.rate_hz
    part = mean_channel(plant)
    wanted = np.linalg.eigvals(np.moveaxis(plant.frequency_response(f), 2, 0)).mean(axis=1)
    largest = np.abs(wanted).max()
    np.testing.assert_allclose(part.frequency_response(f)[0, 0], wanted, atol=1e-4 * largest)


def test_of_equal_channels_it_is_the_channel():
    one = StateSpace([[0.9]], [[1.0]], [[0.5]], [[0.0]], rate_hz=3500.0)
    part = mean_channel(append(*[one] * 6))
    assert part.states == 1
    np.testing.assert_allclose(part.frequency_response([1.0, 100.0]), one.frequency_response([1.0, 100.0]), rtol=1e-9)


def test_an_unstable_plant_keeps_its_states_and_a_plant_that_is_not_square_is_refused():
    one = StateSpace([[1.1]], [[1.0]], [[0.5]], [[0.0]], rate_hz=3500.0)
    assert mean_channel(append(one, one)).states == 2
    with pytest.raises(InputError, match="square"):
        mean_channel(StateSpace([[0.9]], [[1.0]], [[1.0], [1.0]], [[0.0], [0.0]], rate_hz=10.0))
