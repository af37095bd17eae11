"""Residual tests: right error rate on good models, power on poor ones."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

import ultraquiet as uq
from ultraquiet._base.errors import InputError, RateError
from ultraquiet.linalg import portmanteau

DRAWS, SAMPLES, LAGS = 300, 1000, 20


def spread(p_values):
    """Largest distance of the p-values' distribution from the uniform one, in its own standard units (Kolmogorov)."""
    p = np.sort(p_values)
    steps = np.arange(1, p.size + 1) / p.size
    return np.sqrt(p.size) * np.max(np.abs(p - steps + 0.5 / p.size))


@pytest.mark.draws(false_alarm=2e-3)  # twice the one in a thousand of 1.95; 3.0 adds nothing
def test_p_values_of_white_residuals_are_uniform(rng):
    white, free, colored = [], [], []
    for _ in range(DRAWS):
        e, u = rng.standard_normal((2, SAMPLES))
        u = lfilter([1.0], [1.0, -0.9], u)
        white.append(portmanteau.ljung_box(e, LAGS).p_value)
        free.append(portmanteau.cross_correlation(e, u, LAGS).p_value)
        red = lfilter([1.0], [1.0, -0.8], e)
        colored.append(portmanteau.cross_correlation(red, u, LAGS, 60).p_value)
    figures = [spread(np.array(p)) for p in (white, free, colored)]
    print(f"\nKolmogorov distance: white {figures[0]:.2f}, free {figures[1]:.2f}, free of coloured {figures[2]:.2f}")
    # 1.95 is passed by one uniform sample in a thousand; the coloured case rests on an estimated variance.
    assert max(figures[:2]) < 1.95
    assert figures[2] < 3.0


@pytest.mark.draws(false_alarm=2e-3)  # two counts beyond what one in a thousand passes
@pytest.mark.parametrize(("samples", "lags"), [(400, 40), (100, 10)])
def test_white_residuals_of_short_records_are_refused_as_often_as_is_said(samples, lags, rng):
    """By chi-squared four times as many at the level of a thousandth; half as many again are what its docs allow."""
    p = np.array([portmanteau.ljung_box(e, lags).p_value for e in rng.standard_normal((8000, samples))])
    counts = [int(np.sum(p < level)) for level in (0.01, 0.001)]
    print(f"\n{counts} of {p.size} refused at 0.01 and 0.001")
    assert counts[0] <= binom.isf(1e-3, p.size, 1.1 * 0.01)
    assert counts[1] <= binom.isf(1e-3, p.size, 1.5 * 0.001)


def test_power_against_colour_and_input(rng):
    missed = np.zeros(2)
    for _ in range(50):
        e, u = rng.standard_normal((2, 4096))
        missed[0] += portmanteau.ljung_box(e + 0.25 * np.concatenate([[0], e[:-1]]), 40).p_value > 1e-3
        missed[1] += portmanteau.cross_correlation(e + 0.2 * np.concatenate([[0, 0], u[:-2]]), u, 40).p_value > 1e-3
    print(f"\nof 50 residuals 5 % too large, missed by whiteness {missed[0]:.0f}, by the input {missed[1]:.0f}")
    assert np.all(missed <= 5)


def bench_like(rng, samples=3000):
    truth = uq.PolynomialModel([[0, 0.4, 0.2]], [[1, -1.5, 0.8]], 100.0, c=[1, 0.4], d=[1, -0.7])
    u, e = rng.standard_normal(samples), 0.1 * rng.standard_normal(samples)
    y = lfilter(truth.b[0], truth.f[0], u) + lfilter(truth.c, truth.d, e)
    return truth, uq.Record(u, y, 100.0), e


def test_the_truth_passes_and_a_wrong_model_fails(rng):
    truth, record, e = bench_like(rng)
    good = uq.validate.residual_test(truth, record, origin="exact")
    wrong = uq.PolynomialModel(truth.b, [[1, -1.45, 0.78]], 100.0, c=truth.c, d=truth.d)
    bad = uq.validate.residual_test(wrong, record)
    print(f"\ntruth p {good.whiteness_p[0]:.2f}, {good.correlation_p[0, 0]:.2f}; wrong {bad.correlation_p[0, 0]:.1e}")
    # The first samples pay for the unknown past.
    assert good.residuals[0, 20:] == pytest.approx(e[20:], abs=0.05)
    assert good.loss[0] == pytest.approx(np.mean(e**2), rel=0.02)
    assert good.whiteness_p[0] > 1e-4
    assert good.correlation_p[0, 0] > 1e-4
    assert bad.correlation_p[0, 0] < 1e-6
    assert np.mean(np.abs(good.autocorrelation) < good.band) > 0.7


def test_refusals(rng):
    truth, record, _ = bench_like(rng)
    with pytest.raises(RateError, match=r"the model is sampled at 100 Hz but the record is sampled at 50 Hz"):
        uq.validate.residual_test(truth, uq.Record(record.inputs, record.outputs, 50.0))
    with pytest.raises(InputError, match=r"40 lags need at least 400 samples, the record has 100"):
        uq.validate.residual_test(truth, record.part(0, 100))
    with pytest.raises(InputError, match=r"model has 1 inputs and 1 outputs, the record 1 and 2"):
        uq.validate.compare(truth, uq.Record(record.inputs, np.vstack([record.outputs] * 2), 100.0))
    with pytest.raises(InputError, match=r"'initial' must be 'estimate' or 'rest'"):
        uq.validate.compare(truth, record, initial="zero")
    pair = uq.PolynomialMatrix([[truth, truth]])
    twice = uq.Record(np.vstack([record.inputs] * 2), record.outputs, 100.0)
    with pytest.raises(InputError, match=r"2 models, each with its own noise"):
        uq.validate.residual_test(pair, twice)


def modes(f_hz, shape, units=(1.0, 1.0), rate=1000.0):
    """A state space of lightly damped modes at these frequencies, `shape` outputs and inputs of these sizes."""
    ny, nu = shape
    n, rng = len(f_hz), np.random.default_rng(7)
    pole = np.exp((-0.03 + 1j) * 2 * np.pi * np.array(f_hz) / rate)
    A = np.kron(np.diag(pole.real), np.eye(2)) + np.kron(np.diag(pole.imag), [[0.0, 1.0], [-1.0, 0.0]])
    B = rng.standard_normal((2 * n, nu)) / units[1]
    return uq.StateSpace(A, B, rng.standard_normal((ny, 2 * n)) * units[0], np.zeros((ny, nu)), rate)


def recorded(plant, rng, color=0.0, samples=2000):
    ny, nu = plant.D.shape
    u = rng.standard_normal((nu, samples)) / np.abs(plant.B).max()
    y = plant.simulate(u)
    e = lfilter([1.0], [1.0, -color], rng.standard_normal((ny, samples)))
    return uq.Record(u, y + 0.05 * y.std(axis=1, keepdims=True) * e / e.std(axis=1, keepdims=True), plant.rate_hz)


def judged(model, record):
    test = uq.validate.state_space_test(model, record)
    return uq.validate.verdict(model, uq.validate.compare(model, record), test), test


SHAPES = {"1x1": ((1, 1), (1.0, 1.0)), "4x3": ((4, 3), (1e5, 1e-6)), "3x5": ((3, 5), (1e-3, 1e4))}


# Two verdicts a draw, each of which errs once in a thousand good models.
@pytest.mark.draws(false_alarm=6e-3)
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("color", [0.0, 0.9])
def test_a_plain_state_space_is_judged_by_what_its_simulated_error_holds_of_the_inputs(rng, name, color):
    plant, other = (modes([30.0, f], *SHAPES[name]) for f in (100.0, 102.0))
    right, test = judged(plant, recorded(plant, rng, color))
    wrong, _ = judged(plant, recorded(other, rng, color))
    print(f"\n{name}: {right}; {wrong}")
    assert test.simulated
    assert np.isnan(test.whiteness_p).all()
    assert right.ok
    assert "free of the inputs" in right.sentence
    assert wrong.word == "not white"
    assert "simulated error still follows the inputs" in wrong.sentence


@pytest.mark.draws(false_alarm=2e-3)
def test_an_innovation_form_is_judged_by_its_innovations(rng):
    plant, other = (modes([30.0, f], (1, 1)) for f in (100.0, 103.0))
    K = 0.1 * plant.C.T
    forms = [uq.InnovationForm(x.A, x.B, x.C, x.D, K, [[1.0]], x.rate_hz) for x in (plant, other)]
    u, e = rng.standard_normal((2, 1, 3000))
    y = plant.simulate(u) + uq.StateSpace(plant.A, K, plant.C, [[1.0]], plant.rate_hz).simulate(e)
    record = uq.Record(u, y, plant.rate_hz)
    (right, test), (wrong, _) = (judged(form, record) for form in forms)
    print(f"\n{right}; {wrong}")
    assert not test.simulated
    assert test.residuals[0, 200:] == pytest.approx(e[0, 200:], abs=0.1)
    assert right.ok
    assert wrong.word == "not white"


@pytest.mark.draws(false_alarm=1e-3)
def test_a_model_found_for_simulation_keeps_its_verdict_on_a_second_record_whose_noise_has_colour(rng):
    plant = modes([30.0, 100.0], (1, 1))
    first, second = (recorded(plant, rng, 0.9) for _ in range(2))
    model = uq.identify.Subspace(order=4, refine=True).identify(first).model
    status, test = judged(model, second)
    assert test.simulated
    assert test.origin == "another record"
    assert status.ok, status


def test_a_record_without_noise_gives_nothing_to_test(rng):
    plant = modes([30.0, 100.0], (4, 3))
    u = rng.standard_normal((3, 1000))
    status, _ = judged(plant, uq.Record(u, plant.simulate(u), plant.rate_hz))
    assert status.ok
    assert "no noise to test" in status.sentence


def test_a_state_space_without_a_simulated_error_is_refused(rng):
    record = recorded(modes([30.0], (1, 1)), rng)
    wild = uq.StateSpace([[1.1]], [[1.0]], [[1.0]], [[0.0]], 1000.0)
    with pytest.raises(InputError, match="unstable, its simulated error has no bound"):
        uq.validate.state_space_test(wild, record)
    with pytest.raises(InputError, match=r"40 lags need at least 400 samples, the record has 300"):
        uq.validate.state_space_test(modes([30.0], (1, 1)), record.part(0, 300))
