"""Laws behind a washout: nothing at 0 Hz, everything else as bounded; refused where the law is needed there."""

import numpy as np
import pytest
from ordinary_plants import ordinary

from ultraquiet._base.errors import InputError
from ultraquiet.analyse import hinf_norm, peak_sensitivity
from ultraquiet.design import PeakBounded
from ultraquiet.design.peak_bounded.washout import washout
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import sensitivity, series

SETTINGS = {"band_hz": (30.0, 55.0), "states": 4, "steps": 10, "draws": 0}


def accelerometer(rate_hz=1000.0):
    """A mode at 40 Hz seen by a sensor that hears less and less below 5 Hz, one sample late."""
    w, r = 2 * np.pi * 40.0 / rate_hz, np.exp(-0.05 * 2 * np.pi * 40.0 / rate_hz)
    A = np.array([[2 * r * np.cos(w), -(r**2), 0.0], [1.0, 0.0, 0.0], [0.1, -0.1, 0.0]])
    mode = StateSpace(A, [[1.0], [0.0], [0.0]], [[0.0, 0.0, 1.0]], [[0.0]], rate_hz)
    return series(mode, washout(5.0, rate_hz))


def test_an_offset_moves_no_command_and_the_bounds_hold():
    plant = accelerometer()
    plain, behind = (PeakBounded(**SETTINGS, washout_hz=corner).design(plant) for corner in (None, 0.5))
    gains = [
        abs(series(sensitivity(plant, r.controller), r.controller).frequency_response([0.0])[0, 0, 0])
        for r in (plain, behind)
    ]
    peak, _ = peak_sensitivity(plant, behind.controller)
    print(
        f"K S at 0 Hz {gains[0]:.3g} and {gains[1]:.3g}; attenuation "
        f"{plain.details['attenuation_db']:.2f} and {behind.details['attenuation_db']:.2f} dB, peak {peak:.2f} dB"
    )
    assert behind.status.ok
    assert gains[0] > 0.1
    assert gains[1] < 1e-9 * gains[0]
    assert peak <= 6.05
    assert behind.details["attenuation_db"] > plain.details["attenuation_db"] - 1.0
    control = hinf_norm(series(sensitivity(plant, behind.controller), behind.controller))[0]
    assert behind.details["figures"].plants[0].control_gain == pytest.approx(control, rel=1e-4)
    assert behind.controller.states == plain.controller.states + 1


@pytest.mark.slow
def test_each_reading_of_a_wide_plant_passes_its_own(rng):
    plant = ordinary(rng, (3, 5))
    result = PeakBounded(states=4, steps=4, draws=0, washout_hz=1e-3).design(plant)
    K = result.controller.frequency_response([0.0, 1.0])
    print(result.status)
    assert result.controller.D.shape == (5, 3)
    assert np.abs(K[..., 0]).max() < 1e-9 * np.abs(K[..., 1]).max()


@pytest.mark.parametrize("rate_hz", [None, 50.0, 3500.0])
def test_the_washout_has_its_corner_and_unit_gain(rate_hz):
    f = np.array([0.0, 0.2, 20.0])
    W = washout(0.2, rate_hz).frequency_response(f)[0, 0]
    assert abs(W[0]) < 1e-12
    assert abs(W[1]) == pytest.approx(np.sqrt(0.5), rel=1e-2)
    assert abs(W[2]) == pytest.approx(1.0, rel=1e-3)


def test_where_it_would_make_the_law_deaf_it_is_refused():
    with pytest.raises(InputError, match=r"'washout_hz' = 30 must lie below the band, which begins at 30 Hz"):
        PeakBounded(**SETTINGS, washout_hz=30.0).design(accelerometer())
    integrator = StateSpace([[1.0]], [[0.01]], [[1.0]], [[0.0]], 1000.0)
    with pytest.raises(InputError, match=r"a pole at 0 Hz, where 'washout_hz' = 1 makes the law deaf; leave it out"):
        PeakBounded(**SETTINGS, washout_hz=1.0).design(integrator)
    with pytest.raises(InputError, match="'washout_hz'"):
        PeakBounded(washout_hz=-1.0)
