"""Every result of an identification states its response's confidence, or says that and why it knows none."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.result import assemble

RATE_HZ = 2000.0
F_HZ = np.array([5.0, 40, 90, 130, 150, 165, 200, 260, 300, 320, 340, 420, 600, 850])
REFINED = {
    "simulation": lambda _: uq.identify.Subspace(order=4, horizon=12, feedthrough=False, refine=True),
    "unweighted": lambda _: uq.identify.Subspace(order=4, horizon=12, feedthrough=False, refine=True, weighted=False),
    # the noise has a pole at each output, which the predictor holds besides
    "prediction": lambda ny: uq.identify.PredictorSubspace(order=4 + ny, horizon=20),
    "output error": lambda _: uq.identify.OutputError(order=4),
    "box-jenkins, simulation": lambda _: uq.identify.BoxJenkins(order=4, c_order=1, d_order=2, focus="simulation"),
    "weighted rational": lambda _: uq.identify.WeightedRational(order=4),
}


def drawn(rng, ny, nu, volts=40.0, metres=1e-3):
    """A plant of two modes, in units far from one, and a record of it under coloured noise of a tenth of them."""
    f_hz, zeta = np.array([150.0, 320.0]), np.array([0.06, 0.05])
    poles = np.exp(2 * np.pi * f_hz / RATE_HZ * (-zeta + 1j * np.sqrt(1 - zeta**2)))
    A = np.zeros((4, 4))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    B = rng.uniform(0.5, 1.5, (4, nu)) / volts
    C = metres * rng.uniform(0.5, 1.5, (ny, 4)) * rng.choice([-1, 1], (ny, 4))
    plant = uq.StateSpace(A, B, C, np.zeros((ny, nu)), RATE_HZ)
    u = volts * rng.standard_normal((nu, 2500))
    y = plant.simulate(u)
    e = np.asarray(lfilter([1.0, 0.3], [1.0, -0.7], rng.standard_normal(y.shape), axis=1))
    noisy = y + 0.1 * y.std(axis=1, keepdims=True) * e / e.std(axis=1, keepdims=True) + 3.0 * metres
    return plant, uq.Record(u, noisy, RATE_HZ)


def covered(name, ny, nu, draws):
    """Shares of gains and of phases inside their bands of 95 %, in per cent."""
    gains, phases = [], []
    for k in range(draws):
        plant, record = drawn(np.random.default_rng([7, k]), ny, nu)
        band = uq.validate.response_band(REFINED[name](ny).identify(record), F_HZ)
        truth = plant.frequency_response(F_HZ)
        gain_db = 20 * np.log10(np.abs(truth))
        gains.append(np.mean((band.gain_low_db < gain_db) & (gain_db < band.gain_high_db)))
        turned = np.abs(np.angle(truth / band.values, deg=True))
        phases.append(np.mean(turned < band.phase_high_deg - band.phase_deg))
    error = 100 * np.std(gains) / np.sqrt(draws)
    print(
        f"{name}, {ny} x {nu}: gains {100 * np.mean(gains):.1f} +- {error:.1f} %, phases {100 * np.mean(phases):.1f} %"
    )
    return 100 * float(np.mean(gains)), 100 * float(np.mean(phases)), float(error)


@pytest.mark.slow
@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (3, 2)])
@pytest.mark.parametrize("name", REFINED)
def test_bands_cover_ninety_five_percent_under_coloured_noise(name, ny, nu):
    gains, phases, error = covered(name, ny, nu, 200)
    for share in (gains, phases):
        assert 93 - error < share < 97 + error


@pytest.mark.gate("output error", "box-jenkins, simulation")
@pytest.mark.parametrize("name", ["prediction", "output error", "box-jenkins, simulation"])
def test_bands_of_results_are_of_the_right_size(name):
    # 14 gains of one plant go together by threes or so: over 10 draws the share scatters by 3.5 %
    gains, phases, _ = covered(name, 1, 1, 10)
    assert gains > 82
    assert phases > 82


@pytest.mark.gate("simulation")
@pytest.mark.parametrize("name", ["simulation", "unweighted", "prediction"])
def test_a_band_has_the_units_of_its_record(name):
    near, far = (drawn(np.random.default_rng(1), 3, 2, *units)[1] for units in ((1.0, 1.0), (1e6, 1e-9)))
    one, other = (uq.validate.response_band(REFINED[name](3).identify(r), F_HZ) for r in (near, far))
    assert other.percent == pytest.approx(one.percent, rel=1e-3)


def test_a_result_without_a_band_says_why():
    _, record = drawn(np.random.default_rng(1), 1, 1)
    methods = (uq.identify.Subspace(order=4), uq.identify.PredictorSubspace(order=5, refine=False))
    for method in (*methods, uq.identify.Rational(order=4)):
        result = method.identify(record)
        assert result.no_band.startswith("no band: ")
        for asked in (uq.validate.response_band, uq.validate.from_covariance):
            with pytest.raises(InputError, match="no band: "):
                asked(result, F_HZ)


def test_a_state_space_bounds_its_error_as_coefficients_do():
    plant, record = drawn(np.random.default_rng(2), 3, 2)
    result = REFINED["simulation"](3).identify(record)
    bound = uq.validate.from_covariance(result, F_HZ, kind="additive")
    error = np.moveaxis(plant.frequency_response(F_HZ) - result.model.frequency_response(F_HZ), -1, 0)
    assert np.all(np.linalg.norm(error, 2, axis=(1, 2)) < 1.5 * bound.radius)
    assert np.median(np.linalg.norm(error, 2, axis=(1, 2)) / bound.radius) > 0.1


def test_channels_of_several_orders_each_have_their_band():
    rng = np.random.default_rng(3)
    u = rng.standard_normal(2000)
    y = np.stack([lfilter([0, 0.5], [1, -0.8], u), lfilter([0, 0.2, 0.1], [1, -1.2, 0.7], u)])
    record = uq.Record(u, y + 0.05 * rng.standard_normal(y.shape), RATE_HZ)
    alone = [uq.identify.OutputError(order=k).identify(record.pick(outputs=[k - 1])) for k in (1, 2)]
    fits = [[uq.identify.OutputError(order=k).fit(ChannelData.of(record, k - 1), RATE_HZ)] for k in (1, 2)]
    both = uq.validate.response_band(assemble(fits, [record], alone[0].provenance), F_HZ)
    for i, result in enumerate(alone):
        assert both.percent[i] == pytest.approx(uq.validate.response_band(result, F_HZ).percent[0], rel=1e-9)
