"""One law on many benches, measured by their sensors."""

import numpy as np
import pytest
from test_loop_on_bench import wrapped

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.analyse import peak_sensitivity
from ultraquiet.linalg import discretize
from ultraquiet.simulate import campaign, drawn_benches
from ultraquiet.testing.problems import damped_plant
from ultraquiet.values.interconnect import gain, series

BAND_HZ = (10.0, 60.0)


@pytest.mark.slow
def test_what_the_sensors_say_is_what_the_models_say(seed):
    """Three units of one channel; a law that damps two of them and upsets the third."""
    plant = damped_plant(seed, channels=1)
    size = np.abs(plant.frequency_response(np.arange(1.0, 400.0))).max()
    rate = plant.rate_hz
    units = [uq.StateSpace(plant.A, plant.B, c / size * plant.C, plant.D, rate) for c in (0.6, 1.0, 80.0)]
    delay = uq.StateSpace(*discretize.delay(1, 1), rate_hz=rate)
    law = gain([[-0.5]], rate)
    found = campaign([wrapped(unit) for unit in units], law, BAND_HZ)
    told = [peak_sensitivity(series(delay, unit), law)[0] for unit in units]
    print(found.status(), found.figures["peak_sensitivity_db"].round(2).tolist(), np.round(told, 2).tolist())
    assert found.stable.tolist() == np.isfinite(told).tolist() == [True, True, False]
    assert found.worst == 2
    for k in (0, 1):
        assert found.figures["peak_sensitivity_db"][k] == pytest.approx(told[k], abs=0.1)
    assert np.isfinite(found.figures["broadband_db"][:2]).all()
    assert found.share_stable == pytest.approx(2 / 3)


def test_benches_are_drawn_one_unit_each():
    first, second = drawn_benches(uq.bench.Hexapod(spread=1.0), [3, 4])
    assert (first.seed, first.unit_seed, second.unit_seed) == (3, 3, 4)
    assert not np.array_equal(first.linear_model().A, second.linear_model().A)
    with pytest.raises(InputError, match="need a 'spread' above zero"):
        drawn_benches(uq.bench.Hexapod(), [1])
    with pytest.raises(InputError, match="has no 'unit_seed'"):
        drawn_benches(object(), [1])
    with pytest.raises(InputError, match="give at least one"):
        campaign([], gain([[1.0]], 10.0), BAND_HZ)
    with pytest.raises(InputError, match="'band_hz' must lie"):
        campaign([], gain([[1.0]], 10.0), (100.0, 5.0))
    with pytest.raises(InputError, match="campaign: 'band_hz' ends at 2000 Hz, beyond Nyquist's 1750 Hz"):
        campaign([first], gain(np.zeros((6, 6)), 3500.0), (100.0, 2000.0))
