"""A control rate below the sampling rate: the plant in closed form, records, and what folds."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.values import Decimation, Record, StateSpace

CASES = [(1, 0, None), (4, 2, None), (4, 2, 1), (4, 1, 2), (5, 3, 5), (2, 0, 1)]


def plant_of(rng, ny, nu, unit=1.0, direct=0.0):
    n = 6
    A = rng.standard_normal((n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((n, nu)), unit * rng.standard_normal((ny, n))
    return StateSpace(A, B, C, direct * rng.standard_normal((ny, nu)), 8000.0)


@pytest.mark.parametrize("shape", [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)], ids=str)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_slow_plant_is_exact(case, shape, rng):
    """Held by hand, run at the full rate, filtered and decimated by hand: the samples of the closed form."""
    factor, averages, latency = case
    ny, nu, unit = shape
    decimation = Decimation(factor, averages, latency)
    plant = plant_of(rng, ny, nu, unit, direct=0.3 * unit)
    u = rng.standard_normal((nu, 40))
    wait = (factor if latency is None else latency) - 1
    fast = np.repeat(u, factor, axis=1)
    fast = np.hstack([np.zeros((nu, wait)), fast])[:, : 40 * factor]
    y = plant.simulate(fast)
    for _ in range(averages):
        y = np.stack([np.convolve(row, np.ones(factor) / factor)[: 40 * factor] for row in y])
    slow = decimation.plant(plant)
    assert slow.rate_hz == 8000.0 / factor
    assert np.allclose(slow.simulate(u), y[:, ::factor], rtol=1e-9, atol=1e-9 * np.abs(y).max())
    made = decimation.record(Record(decimation.held(u), plant.simulate(decimation.held(u)), 8000.0))
    assert np.array_equal(made.inputs, u)
    assert made.provenance.settings["held"] is True
    assert np.allclose(made.outputs, y[:, ::factor], rtol=1e-9, atol=1e-9 * np.abs(y).max())


@pytest.mark.three_draws
@pytest.mark.parametrize("case", [(4, 2, None), (4, 2, 1), (5, 1, 2)], ids=str)
def test_a_record_with_free_commands_holds_the_plant_that_a_controller_meets(case, rng):
    """Of commands that moved at the full rate: within 0.01 % of the peak, but for the images that a hold would add."""
    decimation = Decimation(*case)
    A = np.array([[0.85, 0.25], [-0.25, 0.85]])
    plant = StateSpace(A, [[0.1], [1.0]], [[0.3, 0.0]], [[0.0]], 8000.0)
    size = 256
    # every line as loud, of any phase: beside one that is drawn faint, what images leave would be as large as itself
    lines = np.exp(2j * np.pi * rng.random(size * decimation.factor // 2 + 1))
    u = np.tile(np.fft.irfft(lines)[None], 3)
    slow = decimation.record(Record(u, plant.simulate(u), 8000.0))
    assert slow.provenance.settings["held"] is False
    sent, heard = (np.fft.rfft(x[0, -size:]) for x in (slow.inputs, slow.outputs))  # steady: no leakage
    f = np.fft.rfftfreq(size, 1 / slow.rate_hz)
    inside = (f > 0) & (f < 0.3 * slow.rate_hz)
    seen = heard[inside] / sent[inside]
    true = decimation.plant(plant).frequency_response(f[inside])[0, 0]
    z = np.exp(2j * np.pi * f[inside] / 8000.0)
    hold = np.sum([z**-i for i in range(decimation.factor)], axis=0) / decimation.factor * z**-decimation.wait
    bare = plant.frequency_response(f[inside])[0, 0] * hold * decimation.frequency_response(f[inside], 8000.0)
    peak = np.abs(true).max()
    miss, images = np.abs(seen - bare) / peak, np.abs(true - bare) / peak
    low = f[inside] < 0.1 * slow.rate_hz
    print(f"{case}: worst {miss.max():.3%} of the peak, images {images.max():.3%}, low {images[low].max():.3%}")
    assert miss.max() < 1e-4
    assert images[low].max() < (0.002 if decimation.averages > 1 else 0.02)


@pytest.mark.parametrize("averages", [1, 2, 3])
def test_what_folds_onto_low_frequencies_is_filtered_as_stated(averages):
    decimation = Decimation(4, averages)
    folded = np.abs(decimation.frequency_response([1800.0, 2000.0, 4000.0], 8000.0))
    assert 20 * np.log10(folded[0]) == pytest.approx(-18.5 * averages, abs=0.1 * averages)
    assert folded[1:].max() < 1e-12
    phase = np.angle(decimation.frequency_response([10.0], 8000.0)[0])
    assert -phase / (2 * np.pi * 10.0) * 8000.0 == pytest.approx(decimation.filter_delay_samples)


def test_rates_that_are_in_no_whole_ratio_are_refused():
    with pytest.raises(InputError, match=r"the nearest are 4000, 2666\.67 Hz"):
        Decimation.to(3000.0, 8000.0)
    with pytest.raises(InputError, match="'latency' must be between 1 and 4"):
        Decimation(4, latency=5)
    with pytest.raises(InputError, match="fewer than two control samples"):
        Decimation(4).record(Record(np.ones((1, 7)), np.ones((1, 7)), 8000.0))
    with pytest.raises(InputError, match="continuous time"):
        Decimation(4).plant(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
