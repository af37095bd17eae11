"""Records of a simulation without noise: what a model leaves of them is rounding, and no test of noise applies."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.identify.subspace import fit
from ultraquiet.linalg import vector_fitting

METHODS = {
    "subspace": uq.identify.Subspace(order=4),
    "subspace refined": uq.identify.Subspace(order=4, refine=True),
    "predictor": uq.identify.PredictorSubspace(order=4),
    "output error": uq.identify.OutputError(order=4),
    "box-jenkins": uq.identify.BoxJenkins(order=4),
}


def simulated(rng, ny, nu):
    """Two modes of about the same size, without noise."""
    A, B, C = np.zeros((4, 4)), np.zeros((4, nu)), np.zeros((ny, 4))
    for k, (turn, radius) in enumerate(((0.3, 0.98), (0.6, 0.97))):
        c, s = radius * np.cos(turn), radius * np.sin(turn)
        pair = slice(2 * k, 2 * k + 2)
        A[pair, pair] = [[c, s], [-s, c]]
        B[2 * k], C[:, 2 * k] = 1 + 0.3 * rng.standard_normal(nu), 1e-3 * (1 + 0.3 * rng.standard_normal(ny))
    plant = uq.StateSpace(A, B, C, np.zeros((ny, nu)), 800.0)
    u = 20 * rng.standard_normal((nu, 3000))
    return plant, uq.Record(u, plant.simulate(u), 800.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(1, 1), (2, 3)])
def test_a_record_without_noise_is_explained_and_said_to_be(rng, method, shape):
    plant, record = simulated(rng, *shape)
    found = METHODS[method].identify(record)
    print(f"{method}: {found.status}")
    assert found.status.ok
    assert "no noise to test" in found.status.sentence
    f = np.geomspace(1, 390, 100)
    H, G = (each.frequency_response(f) for each in (found.state_space(), plant))
    assert np.abs(H - G).max() < 1e-3 * np.abs(G).max()


def test_rounding_is_given_no_noise_model():
    """A draw whose rounding passed for coloured noise: the search began from poles of none and ended away."""
    _, record = simulated(np.random.default_rng(3682636393), 1, 1)
    found = METHODS["predictor"].identify(record)
    assert found.status.ok
    assert found.fit_percent[0] > 99.9999


def test_a_sum_of_outputs_that_is_explained_alone_is_no_end():
    """A draw whose search explained one sum of both outputs to rounding and neither of them: it had no factor."""
    _, record = simulated(np.random.default_rng(2422282065), 2, 3)
    found = METHODS["predictor"].identify(record)
    assert found.status.ok
    assert found.fit_percent.min() > 99.9999


def test_errors_that_are_shares_of_one_another_are_not_taken_for_none(rng):
    e = rng.standard_normal(2000)
    shared = np.stack([e, 2 * e])
    none = 1e-12 * rng.standard_normal((2, 2000))
    assert fit.log_size(none, True) < fit.log_size(shared, True)
    assert fit.log_size(2 * shared, True) - fit.log_size(shared, True) == pytest.approx(2 * np.log(4), abs=0.1)


@pytest.mark.parametrize("method", ["subspace", "output error"])
def test_what_an_order_too_low_leaves_is_no_rounding(rng, method):
    _, record = simulated(rng, 1, 1)
    low = {"subspace": uq.identify.Subspace(order=2), "output error": uq.identify.OutputError(order=2)}
    found = low[method].identify(record)
    print(f"{method}: {found.status}")
    assert not found.status.ok


@pytest.mark.parametrize("noise", [0.0, 1e-10, 1e-8, 1e-7])
def test_an_order_that_nobody_gave_is_not_blamed_where_there_is_hardly_noise(rng, noise):
    _, record = simulated(rng, 1, 1)
    y = record.outputs + noise * record.outputs.std() * rng.standard_normal(record.outputs.shape)
    found = uq.identify.Subspace().identify(uq.Record(record.inputs, y, record.rate_hz))
    print(found.details["order"], found.status)
    assert found.status.ok
    assert found.details["order"] <= 8


@pytest.mark.draws(false_alarm=0.01)  # 2 of 400 were told as not white or not converged before the fit was
def test_a_gain_is_no_model_without_feedthrough(rng):
    u = rng.standard_normal((1, 2000))
    for noise in (0.0, 0.1):
        record = uq.Record(u, 5.0 * u + noise * rng.standard_normal(u.shape), 1000.0)
        strictly_proper = uq.identify.WeightedRational(order=4).identify(record)
        direct = uq.identify.WeightedRational(order=2, feedthrough=True).identify(record)
        print(strictly_proper.status, direct.status)
        assert strictly_proper.status.word == "poor fit"
        assert direct.fit_percent[0] > 90.0


@pytest.mark.parametrize("start", [0, 500])
def test_what_rounding_alone_tells_apart_moves_no_recursion(start, rng):
    u = rng.standard_normal((1, 2000))
    method = uq.identify.RecursiveArx(order=4, start_samples=start)
    result = method.identify(uq.Record(u, 5.0 * u, 1000.0))  # y(t - k) is 5 u(t - k): which of both, nothing says
    assert result.model.rows[0][0].is_stable()
    assert -10.0 < result.fit_percent[0] < 10.0


def test_poles_at_the_origin_take_no_logarithm_of_zero(rng):
    u = rng.standard_normal((1, 2000))
    with np.errstate(all="raise"):
        result = uq.identify.Rational(order=4).identify(uq.Record(u, u, 1000.0))
    assert np.isfinite(result.fit_percent[0])


def test_a_pair_as_good_as_one_pole_at_the_origin_leaves_no_empty_function():
    """Draws whose relocated poles were a pair 1e-20 off the origin: its second function vanished at every line."""
    u = np.random.default_rng(3867583413).standard_normal((1, 2000))
    with np.errstate(all="raise"):
        result = uq.identify.Rational(order=4).identify(uq.Record(u, u, 1000.0))
    assert np.isfinite(result.fit_percent[0])


@pytest.mark.parametrize("apart", [1e-20, 1e-17, 1e-15])
def test_residues_of_a_pair_that_is_nearly_one_pole(apart):
    z = np.exp(1j * np.linspace(0.02, np.pi - 0.02, 60))
    start = np.array([-0.3 + 1j * apart, -0.3 - 1j * apart, 0.5])
    with np.errstate(all="raise"):
        found = vector_fitting.fit(z, (1.0 / (z + 0.3) + 2.0 / (z - 0.8))[None, None], np.ones(60), start, 10)
    assert found.error < 1e-9


@pytest.mark.parametrize("apart", [1e-20, 1e-17, 1e-15, 1e-12, 1e-9])
@pytest.mark.parametrize("at", [0.0, 0.1, 0.6])
def test_a_pair_that_is_nearly_one_pole_moves_to_where_two_are(at, apart):
    """One relocation finds poles of exact samples to what rounding leaves of the pair; two equal ones miss 0.05."""
    z = np.exp(1j * np.linspace(0.02, np.pi - 0.02, 60))
    own = np.array([-0.3, 0.2, 0.8])
    H = np.sum(np.array([1.0, 0.5, 2.0]) / (z[:, None] - own), axis=1)
    start = np.array([at + 1j * apart, at - 1j * apart, 0.5])
    with np.errstate(all="raise"):
        once = vector_fitting.fit(z, H[None, None], np.ones(60), start, 1)
        found = vector_fitting.fit(z, H[None, None], np.ones(60), start, 3)
    print(f"error {once.error:.1e} after one relocation, {found.error:.1e} after three")
    assert once.error < 1e-5
    assert np.sort(found.poles.real) == pytest.approx(own, abs=1e-9)
    assert found.error < 1e-12
