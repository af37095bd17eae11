"""Weights have the gains they promise, are stable and invertible."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.analyse import zeros
from ultraquiet.design import band_pass, high_pass, peak


@pytest.mark.parametrize("rate_hz", [None, 3500.0])
@pytest.mark.parametrize("order", [2, 4, 8, 12])
def test_band_pass_follows_its_formula(rng, order, rate_hz):
    low, high = sorted(rng.uniform(5, 300, 2))
    high += 10
    height, floor = rng.uniform(2, 50), rng.uniform(0.05, 1)
    W = band_pass((low, high), height, floor, order, rate_hz)
    f = np.geomspace(1, 1000, 200)
    gain = np.abs(W.frequency_response(f)[0, 0])
    if rate_hz is not None:
        # Tustin's rule bends the axis: frequencies as the continuous weight sees them, exact at the centre
        centre = np.sqrt(low * high)
        f = centre * np.tan(np.pi * f / rate_hz) / np.tan(np.pi * centre / rate_hz)
    x = np.abs((f**2 - low * high) / (f * (high - low)))
    wanted = floor * np.sqrt((x**order + (height / floor) ** 2) / (x**order + 1))
    np.testing.assert_allclose(gain, wanted, rtol=1e-6)
    assert W.states == order
    assert W.is_stable()
    assert not zeros(W).outside.any()


@pytest.mark.parametrize("rate_hz", [None, 3500.0])
def test_high_pass_rises_where_asked(rate_hz):
    W = high_pass(400.0, 1e-3, 1e-1, 2, rate_hz)
    gain = np.abs(W.frequency_response([1.0, 400.0])[0, 0])
    assert abs(gain[0] / 1e-3 - 1) < 1e-3
    assert abs(gain[1] / (1e-3 * np.sqrt(2)) - 1) < 1e-3
    assert W.is_stable()


def test_peak_stands_at_its_tone():
    W = peak(25.0, 50.0, 0.01, 3500.0, channels=2)
    g = W.frequency_response([25.0, 5.0])
    np.testing.assert_allclose(np.abs(g[0, 0]), [50.0, 1.0], rtol=3e-1)
    assert abs(abs(g[1, 1, 0]) - 50) < 1e-6
    assert g[0, 1, 0] == 0


def test_mistakes_are_refused():
    with pytest.raises(InputError, match="band_hz"):
        band_pass((100.0, 10.0), 1.0, 0.5)
    with pytest.raises(InputError, match="band_hz"):
        band_pass((100.0, 2000.0), 2.0, 0.5, rate_hz=3500.0)
    with pytest.raises(InputError, match="even"):
        band_pass((10.0, 100.0), 2.0, 0.5, order=3)
    with pytest.raises(InputError, match="corner_hz"):
        high_pass(1800.0, 1e-3, 1e-1, rate_hz=3500.0)
