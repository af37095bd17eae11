"""Geophones of another corner: below it they hear jerk, above it velocity, and the bound on a broad band moves."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError

# Best flat attenuation of heave over 5-100 Hz at 6 dB of peak and 1000 V/V, dB: no controller reaches more.
BOUNDS_DB = {12.0: 14.6, 4.5: 33.1, 1.0: 39.8}


def test_the_corner_divides_what_a_geophone_hears():
    f = np.array([8.0, 20.0, 300.0])  # below, images of the sampling stand beside what little is heard
    usual = uq.bench.Hexapod(unit="ground").linear_response(f)[0, 0]
    for corner in (4.5, 1.0):
        other = uq.bench.Hexapod(unit="ground", geophone_hz=corner).linear_response(f)[0, 0]
        s = 2j * np.pi * f
        wanted = 1.0
        for hz, sign in ((corner, 1), (12.0, -1)):
            w = 2 * np.pi * hz
            wanted = wanted * (s**2 / (s**2 + 2 * 0.65 * w * s + w**2)) ** sign
        assert np.allclose(other / usual, wanted, rtol=0.03)


def test_model_and_response_agree_and_draws_scale_the_corner():
    f = np.geomspace(0.5, 1500.0, 60)
    for unit in ("ground", "flight"):
        bench = uq.bench.Hexapod(unit=unit, geophone_hz=4.5, spread=1.0, unit_seed=3)
        model, truth = bench.linear_model().frequency_response(f), bench.linear_response(f)
        assert np.abs(model - truth).max() < 0.02 * np.abs(truth).max()
        assert bench.drawn(7).geophone_hz == 4.5
        assert 4.2 < bench.drawn_parameters()["geophone_hz, mean"] < 4.8
    with pytest.raises(InputError, match="'geophone_hz' must lie"):
        uq.bench.Hexapod(geophone_hz=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("corner", BOUNDS_DB)
def test_the_bound_on_the_broad_band_moves_with_the_corner(corner):
    heave = uq.design.common_mode(uq.bench.Hexapod(unit="ground", geophone_hz=corner).linear_model())
    limit = uq.limits.best_flat_attenuation(heave, (5.0, 100.0), peak_db=6.0, control_gain=1000.0)
    print(f"{corner:g} Hz: {limit.attenuation_db:.1f} dB can be reached, {limit.bound_db:.1f} dB cannot be exceeded")
    assert limit.bound_db == pytest.approx(BOUNDS_DB[corner], abs=0.5)
