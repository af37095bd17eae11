"""Bands of state-space responses: their coverage, the plain covariance of a pole, units, refusals."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet._base.errors import InputError

RATE_HZ, SAMPLES = 200.0, 2000
F_HZ = np.array([1.0, 5.0, 9.0, 10.5, 12.0, 20.0, 30.0, 31.0, 35.0, 50.0, 80.0])


def drawn(rng, ny, nu, colour, size=1.0):
    """A plant of two modes and a record of it with coloured noise of a tenth of the outputs."""
    A = np.array([[0.9, 0.3, 0, 0], [-0.3, 0.9, 0, 0], [0, 0, 0.5, 0.7], [0, 0, -0.7, 0.5]])
    B, C = rng.uniform(0.5, 1.5, (4, nu)), rng.uniform(0.5, 1.5, (ny, 4)) * rng.choice([-1, 1], (ny, 4))
    plant = uq.StateSpace(A, B, size * C, np.zeros((ny, nu)), RATE_HZ)
    u = rng.standard_normal((nu, SAMPLES))
    y = plant.simulate(u)
    e = np.asarray(lfilter([1.0], [1.0, -colour], rng.standard_normal(y.shape), axis=1))
    return plant, uq.Record(u, y + 0.1 * y.std(axis=1, keepdims=True) * e / e.std(), RATE_HZ)


def band_of(record):
    method = uq.identify.Subspace(order=4, horizon=12, feedthrough=False, refine=True)
    return uq.validate.state_space_band(method.identify(record).state_space(), record, F_HZ)


def covered(ny, nu, colour, draws):
    """Share of gains inside their band of 95 %, and the mean squared distance in deviations, 2 when right."""
    inside, distance = [], []
    for k in range(draws):
        plant, record = drawn(np.random.default_rng(k), ny, nu, colour)
        band, truth = band_of(record), plant.frequency_response(F_HZ)
        gain_db = 20 * np.log10(np.abs(truth))
        inside.append(np.mean((band.gain_low_db < gain_db) & (gain_db < band.gain_high_db)))
        distance.append(np.mean(band.distance(truth)))
    share = float(np.mean(inside))
    print(f"{ny} x {nu}, colour {colour}: {100 * share:.1f} % covered, mean distance {np.mean(distance):.2f} of 2")
    return share, float(np.mean(distance))


def test_bands_are_of_the_right_size():
    # ten draws of 66 gains that go together by threes or so: the share scatters by 2 %
    share, distance = covered(3, 2, 0.5, 10)
    assert 0.87 < share <= 0.995
    assert 1.3 < distance < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(("ny", "nu", "colour"), [(1, 1, 0.0), (2, 2, 0.0), (4, 3, 0.8), (3, 5, -0.7)])
def test_bands_cover_ninety_five_percent(ny, nu, colour):
    share, _ = covered(ny, nu, colour, 200)
    assert 0.93 <= share <= 0.97


@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_units_change_no_percent(size):
    one, other = (band_of(drawn(np.random.default_rng(1), 2, 3, 0.5, s)[1]) for s in (1.0, size))
    print(f"uncertainty {one.percent.min():.2f} .. {one.percent.max():.2f} %")
    assert other.percent == pytest.approx(one.percent, rel=1e-3)


def test_refusals():
    _, record = drawn(np.random.default_rng(1), 2, 2, 0.0)
    lag = uq.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ)
    with pytest.raises(InputError, match="1 outputs and 1 inputs"):
        uq.validate.state_space_band(lag, record, F_HZ)
    with pytest.raises(InputError, match="rate is 100"):
        uq.validate.state_space_band(uq.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 100.0), record, F_HZ)
    wild = uq.StateSpace([[1.5]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)), RATE_HZ)
    with pytest.raises(InputError, match="unstable"):
        uq.validate.state_space_band(wild, record, F_HZ)


def test_a_mode_that_rings_as_long_as_the_record_has_the_band_of_an_output_error(seed):
    """A record is no period: as one, the lines beside the mode told 6 times more or less of it, by the draw.

    Both methods find the same least error, so that their bands are one but for how each knows its noise.
    """
    poles = np.exp(2j * np.pi * np.array([4.0, 18.0]) / RATE_HZ * (1 + 0.01j))
    A = np.zeros((4, 4))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    plant = uq.StateSpace(A, [[0.0], [1.0], [0.0], [2.0]], [[1.0, 0.0, -0.7, 0.0]], [[0.0]], RATE_HZ)
    ratios = []
    for k in range(3):
        rng = np.random.default_rng(100 * seed + k)
        u = rng.standard_normal((1, SAMPLES))
        y = plant.simulate(u)
        record = uq.Record(u, y + 0.1 * y.std() * rng.standard_normal(y.shape), RATE_HZ)
        methods = uq.identify.Subspace(order=4, refine=True), uq.identify.OutputError(order=4)
        bands = [uq.validate.response_band(method.identify(record), [4.0]) for method in methods]
        ratios.append(float(np.divide(*((b.gain_high_db - b.gain_db)[0, 0, 0] for b in bands))))
    assert ratios == pytest.approx([1.0] * 3, abs=0.25)


def in_motion(rng, mean):
    """A record cut from a longer one: a mode that rings on, its inputs about a mean."""
    p = 0.995 * np.exp(0.3j)
    plant = uq.StateSpace([[p.real, p.imag], [-p.imag, p.real]], [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]], 100.0)
    u = mean + rng.standard_normal((1, 5000))
    y = plant.simulate(u)[:, 2000:]
    return uq.Record(u[:, 2000:], y + 0.02 * y.std() * rng.standard_normal(y.shape), 100.0)


@pytest.mark.parametrize("mean", [0.0, 30.0])
def test_a_record_that_begins_in_motion_says_as_much_as_one_from_rest(mean, rng):
    """Beside the band of the output-error model, whose past is fitted too: what rings on is no noise."""
    record, f = in_motion(rng, mean), [1.0, 4.77, 10.0]
    methods = uq.identify.Subspace(order=2, refine=True, feedthrough=False), uq.identify.OutputError(order=2)
    bands = [uq.validate.response_band(method.identify(record), f).percent.ravel() for method in methods]
    print(*bands)
    np.testing.assert_allclose(*bands, rtol=0.2)


@pytest.mark.parametrize("focus", ["simulation", "prediction"])
def test_what_the_inputs_mean_is_says_nothing_of_the_response(focus):
    method = uq.identify.Subspace(order=2, refine=True, feedthrough=False, focus=focus)
    records = [in_motion(np.random.default_rng(1), mean) for mean in (0.0, 30.0)]
    bands = [uq.validate.response_band(method.identify(r), [1.0, 4.77, 10.0]).percent.ravel() for r in records]
    print(*bands)
    np.testing.assert_allclose(*bands, rtol=1e-3)
