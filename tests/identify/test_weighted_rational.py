"""Rational fits by maximum likelihood: the Cramer-Rao bound, bands that cover, orders and delays from the data."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from test_rational import RATE_HZ

import ultraquiet as uq

DATA = Path(__file__).parents[1] / "data"
F_HZ = np.arange(4.0, 1700.0, 4.0)


def resolved(rng, modes, nu, ny, rate_hz=RATE_HZ):
    """A plant of modes that the lines resolve, apart from each other and alike in strength: the bound is asymptotic."""
    f = np.geomspace(100, 900, modes) * np.exp(rng.uniform(-0.15, 0.15, modes))
    zeta = rng.uniform(0.03, 0.06, modes)
    s = 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))
    poles = s if rate_hz is None else np.exp(s / rate_hz)
    A = np.zeros((2 * modes, 2 * modes))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    size = np.repeat(np.sqrt(-s.real), 2)
    B, C = (rng.uniform(0.7, 1.3, k) * rng.choice([-1.0, 1.0], k) for k in ((2 * modes, nu), (ny, 2 * modes)))
    B, C = size[:, None] * B, C * size
    return uq.StateSpace(A, B, C, np.zeros((ny, nu)), rate_hz)


def noisy(G, variance, rng):
    e = rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)
    return uq.FrequencyResponse(F_HZ, G + e * np.sqrt(variance / 2), variance=variance)


def noise_of(G, rng, share=0.03):
    """Variances that differ from line to line."""
    return (share * np.sqrt(np.mean(np.abs(G) ** 2))) ** 2 * np.exp(0.5 * rng.standard_normal(G.shape))


def bound(exact, f_hz):
    """Cramer-Rao bound of the gains: the covariance at the truth, read off a fit without noise."""
    band = exact.band(f_hz, level=0.95)
    return (band.real**2 + band.imaginary**2) / 1.959964**2


@pytest.mark.slow
@pytest.mark.draws(false_alarm=3e-3)  # the mean coverage of thirty draws is 95.1 %, their spread 0.63 %: three sigma
@pytest.mark.parametrize(("rate_hz", "channels"), [(RATE_HZ, 1), (None, 1), (RATE_HZ, 2)])
def test_the_cramer_rao_bound_is_reached_and_bands_cover(rate_hz, channels, rng):
    """100 draws and more, over several plants: the errors of one fit's lines are alike, so that draws count."""
    ratio, cover, lines = [], [], np.geomspace(5, 1600, 60)
    method = uq.identify.WeightedRational(order=6)
    for _ in range(8 if channels == 1 else 5):
        plant = resolved(rng, 3, channels, channels, rate_hz)
        G, truth = plant.frequency_response(F_HZ), plant.frequency_response(lines)
        variance = noise_of(G, rng)
        exact = method.identify_response(uq.FrequencyResponse(F_HZ, G, variance=variance), rate_hz)
        least = bound(exact, lines)
        squared = np.zeros_like(least)
        for _ in range(20):
            fit = method.identify_response(noisy(G, variance, rng), rate_hz)
            band = fit.band(lines)
            miss = band.values - truth
            squared += np.abs(miss) ** 2 / 20
            cover.append(
                [
                    np.mean(np.abs(miss.real) < band.real),
                    np.mean(np.abs(miss.imag) < band.imaginary),
                    np.mean((np.abs(truth) > band.low) & (np.abs(truth) < band.high)),
                ]
            )
            assert fit.model.is_stable()
        ratio.append(np.mean(squared / least))
    covered = np.mean(cover, axis=0)
    told = "continuous" if rate_hz is None else "discrete"
    print(
        f"\n{told}, {channels} x {channels}, {len(cover)} draws: squared error {np.mean(ratio):.3f} of the bound; "
        f"95 % bands cover {covered[0]:.1%} (real), {covered[1]:.1%} (imaginary), {covered[2]:.1%} (modulus)"
    )
    assert np.mean(ratio) < 1.3
    assert 0.93 < np.mean(covered) < 0.97


@pytest.mark.slow
def test_the_order_is_found_in_the_noise(rng):
    orders, words = [], []
    for _ in range(8):
        modes = int(rng.integers(1, 4))
        plant = resolved(rng, modes, 1, 2)
        G = plant.frequency_response(F_HZ)
        # Every mode must stand above the noise to be found.
        variance = np.full(G.shape, (1e-3 * np.abs(G).min(axis=2).max()) ** 2)
        fit = uq.identify.WeightedRational(highest_order=10).identify_response(noisy(G, variance, rng), RATE_HZ)
        orders.append(fit.order - 2 * modes)
        words.append(fit.status.word)
    print(f"order found less true: {orders}; {words.count('ok')} of {len(words)} ok")
    assert sum(o == 0 for o in orders) >= 7
    assert words.count("ok") >= 7


def test_too_low_an_order_is_not_called_white(rng):
    plant = resolved(rng, 3, 1, 1)
    G = plant.frequency_response(F_HZ)
    variance = np.full(G.shape, (1e-3 * np.abs(G).min()) ** 2)
    fit = uq.identify.WeightedRational(order=2).identify_response(noisy(G, variance, rng), RATE_HZ)
    print(fit.status)
    assert fit.status.word == "not white"


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_no_output_of_a_record_is_missed_for_its_unit(unit, rng):
    plant = resolved(rng, 2, 1, 2)
    u = rng.standard_normal((1, 2000))
    y = plant.simulate(u)
    y = y + 0.02 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    method = uq.identify.WeightedRational(order=4)
    one, other = (method.identify(uq.Record(u, y * [[1.0], [k]], RATE_HZ)) for k in (1.0, unit))
    print(one.fit_percent, other.fit_percent, other.status)
    assert other.status.word == one.status.word
    assert np.abs(other.fit_percent - one.fit_percent).max() < 1e-3
    assert one.fit_percent.min() > 95


@pytest.mark.parametrize("rate_hz", [None, RATE_HZ])
def test_the_delay_is_estimated(rate_hz, rng):
    plant = resolved(rng, 2, 1, 1, rate_hz)
    delay_s = 3 / RATE_HZ
    G = plant.frequency_response(F_HZ) * np.exp(-2j * np.pi * F_HZ * delay_s)
    measured = noisy(G, noise_of(G, rng, 0.01), rng)
    method = uq.identify.WeightedRational(order=4, delay_s=None)
    fit = method.identify_response(measured, rate_hz)
    g = np.geomspace(6, 800, 100)
    T = plant.frequency_response(g) * np.exp(-2j * np.pi * g * delay_s)
    miss = np.abs(fit.frequency_response(g) - T).max() / np.abs(T).max()
    print(f"{fit.delay_s * RATE_HZ:.3f} samples of 3, response within {miss:.1e}")
    assert miss < 0.05
    deviation_s = np.sqrt(fit.pole_covariance[-1, -1]) if rate_hz is None else 0.01 / RATE_HZ
    assert abs(fit.delay_s - delay_s) < 4 * deviation_s


def with_a_far_zero(plant, zero):
    """The plant, of one input and output, with a C that puts a zero near `zero` rad/s."""
    A, B, C = plant.A, plant.B, plant.C
    along = B.T / (B.T @ B)
    left = zero + np.trace(A)
    C = C - (left * C @ B + C @ A @ B) / (left + along @ A @ B) * along
    return uq.StateSpace(A, B, C, plant.D, plant.rate_hz)


@pytest.mark.gate("1-1-1.0")
@pytest.mark.parametrize(("ny", "nu", "units"), [(1, 1, 1.0), (2, 3, 1e-6)])
def test_a_far_zero_and_a_delay_that_stand_in_for_each_other_are_both_told(ny, nu, units, rng):
    """Between a zero far above the lines and its mirror image with some more delay the noise decides by chance."""
    delay_s, zero = 3 / RATE_HZ, 40.0 * F_HZ[-1]
    plant = with_a_far_zero(resolved(np.random.default_rng(0), 2, 1, 1, None), zero)
    mirrored = []
    for _ in range(6 if ny == 1 else 3):
        gains = rng.uniform(0.5, 2.0, (ny, nu, 1)) * units
        G = gains * plant.frequency_response(F_HZ) * np.exp(-2j * np.pi * F_HZ * delay_s)
        measured = noisy(G, noise_of(G, rng, 0.01 * np.sqrt(ny * nu)), rng)
        fit = uq.identify.WeightedRational(order=4, delay_s=None).identify_response(measured)
        deviation_s = np.sqrt(fit.pole_covariance[-1, -1])
        away_s = [abs(theta[-1] - fit.delay_s) for theta, _ in fit.other_minima]
        print(f"delay off by {fit.delay_s - delay_s:.1e} s, deviation {deviation_s:.1e} s, others {away_s} s away")
        assert abs(fit.delay_s - delay_s) < 4 * deviation_s
        assert all(cost >= fit.point.cost for _, cost in fit.other_minima)
        mirrored.append(any(1 / zero < away < 3 / zero for away in away_s))
    # Where the noise moves the zero to infinity the two are one.
    assert any(mirrored)


@pytest.mark.draws(false_alarm=3e-2)  # 4 of 301: where one sharp mode makes up the mean, its own error does too
def test_what_a_record_leaks_is_fitted_with_it(rng):
    """A record cut from the middle of a run: the model is as good as its noise allows."""
    plant = resolved(rng, 3, 2, 1)
    u = rng.standard_normal((2, 6000))
    y = plant.simulate(u)
    y = y + 0.01 * y.std() * rng.standard_normal(y.shape)
    found = uq.identify.WeightedRational().identify(uq.Record(u, y, RATE_HZ).part(3000))
    g = np.geomspace(6, 1600, 100)
    T, fit = plant.frequency_response(g), found.details["fit"]
    band = fit.band(g)
    told = np.mean(band.real**2 + band.imaginary**2) / 1.959964**2
    ratio = np.mean(np.abs(band.values - T) ** 2) / told
    print(
        f"order {fit.order}, squared error {ratio:.2f} of the variance told, {found.fit_percent[0]:.2f} % simulated, "
        f"{found.status}"
    )
    assert found.status.ok
    assert fit.order == 6
    # One draw of some twenty parameters.
    assert ratio < 3.0
    assert found.fit_percent[0] > 98.0


@pytest.mark.slow
@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (3, 2)])
def test_lines_at_which_no_input_moves_hide_no_mode(rng, ny, nu):
    """Gains are known there a million times less well, or not at all; those of the band keep their own noise."""
    poles = [np.exp(2 * np.pi * f / 1000.0 * (-0.02 + 1j)) for f in (20.0, 110.0)]
    A = np.zeros((4, 4))
    for k, z in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[z.real, z.imag], [-z.imag, z.real]]
    plant = uq.StateSpace(A, rng.uniform(0.5, 1.0, (4, nu)), rng.uniform(0.5, 1.0, (ny, 4)), np.zeros((ny, nu)), 1000.0)
    U = np.fft.rfft(rng.standard_normal((nu, 6000)))
    U[:, np.fft.rfftfreq(6000, 1e-3) > 200.0] = 0.0
    u = np.fft.irfft(U, 6000)
    y = plant.simulate(u)
    y += 0.003 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    found = uq.identify.WeightedRational(order=4).identify(uq.Record(u, y, 1000.0))
    print(found.status, found.fit_percent)
    assert found.status.ok
    assert found.model.states >= 4  # two for each direction of a mode
    assert found.fit_percent.min() > 98.0


@pytest.mark.slow
def test_two_inertia_bench_by_its_periods():
    """Order by the data, judged on periods the fit has not seen; the response at the lines alone gives 89.8 / 90.6 %.

    The measured current also moves below the lines of the multisine, and the model is fitted there as well.
    """
    held = scipy.io.loadmat(DATA / "two_inertia" / "multisine_10_periods.mat")
    y = np.stack([held["motor_speed"].ravel(), held["load_speed"].ravel()]).astype(float)
    record = uq.Record(held["current"].ravel().astype(float), y, 2500.0)
    result = uq.identify.WeightedRational(period_samples=2500, weigh="output").identify(record.part(0, 7 * 2500))
    fit = uq.validate.compare(result.model, record.part(7 * 2500)).fit_percent
    print(
        f"\ntwo-inertia, order {result.details['order']} by MDL, seven periods: {fit.round(2)} % simulated on three "
        f"unseen ones, {result.status}"
    )
    assert result.model.is_stable()
    assert np.all(fit >= 88.0)


def test_refusals(rng):
    plant = resolved(rng, 2, 1, 1)
    G = plant.frequency_response(F_HZ)
    method = uq.identify.WeightedRational()
    with pytest.raises(uq.errors.InputError, match="no variance to weigh"):
        method.identify_response(uq.FrequencyResponse(F_HZ, G), RATE_HZ)
    with pytest.raises(uq.errors.InputError, match="contradict a rate of 1000 Hz"):
        method.identify_response(uq.FrequencyResponse(F_HZ, G, variance=np.ones(G.shape)), 1000.0)
    with pytest.raises(uq.errors.InputError, match="finite variance above zero"):
        method.identify_response(uq.FrequencyResponse(F_HZ, G, variance=np.zeros(G.shape)), RATE_HZ)
    offset = uq.FrequencyResponse([0.0], G[:, :, :1], variance=np.ones((1, 1, 1)))
    with pytest.raises(uq.errors.InputError, match="no line above 0 Hz"):
        method.identify_response(offset, RATE_HZ)
    few = uq.FrequencyResponse(F_HZ[:10], G[:, :, :10], variance=np.ones((1, 1, 10)))
    with pytest.raises(uq.errors.InputError, match="order 6 takes 12 lines, there are 10"):
        uq.identify.WeightedRational(order=6).identify_response(few, RATE_HZ)
    with pytest.raises(uq.errors.InputError, match="no coherence"):
        uq.spectra.with_coherence_variance(uq.FrequencyResponse(F_HZ, G), 5)


def ringing(rng, share, samples):
    """A plant whose lower mode rings for seconds, driven by `samples`, and a record of it with so much noise."""
    plant = uq.StateSpace(
        *discrete_modes(np.array([20.0, 90.0]), np.array([0.01, 0.02]), np.array([1.0, -0.7])), rate_hz=1000.0
    )
    y = plant.simulate(samples)
    return plant, uq.Record(samples, y + share * y.std() * rng.standard_normal(y.shape), 1000.0)


def discrete_modes(f_hz, zeta, weights):
    s = 2 * np.pi * f_hz * (-zeta + 1j * np.sqrt(1 - zeta**2))
    A, B, C = np.zeros((4, 4)), np.zeros((4, 1)), np.zeros((1, 4))
    for k, p in enumerate(np.exp(s / 1000.0)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
        B[2 * k + 1], C[0, 2 * k] = np.sqrt(1 - abs(p) ** 2), weights[k]
    return A, B, C, [[0.0]]


def multisine(periods, seed):
    signal = uq.signals.Multisine(start_hz=1, stop_hz=450, period_samples=2000, peak=3)
    return signal.generate(2000 * periods, 1000.0, seed=seed)[None]


@pytest.mark.draws(false_alarm=1e-3)  # a verdict at the level of a thousandth
def test_periods_of_one_record_weigh_as_their_mean_response_does(rng, seed):
    """The curvature of a resonance is no distortion: taken for it, the lines that know a mode best weighed least."""
    plant, record = ringing(rng, 0.01, multisine(10, seed))
    record = record.part(4 * 2000)
    found = uq.identify.WeightedRational(order=4, period_samples=2000).identify(record)
    assert found.status.ok, found.status
    g = np.geomspace(2.0, 440.0, 200)
    T = plant.frequency_response(g)
    miss = np.linalg.norm(found.model.frequency_response(g) - T) / np.linalg.norm(T)
    print(f"{miss:.1e} off")
    assert miss < 2e-3


@pytest.mark.draws(false_alarm=1.5e-2)  # of 180 such fits one was of order 6 and one not white
@pytest.mark.gate("1.0-3", "1e-09-4")
@pytest.mark.parametrize("periods", [3, 4, 8])
@pytest.mark.parametrize("unit", [1.0, 1e-9])
def test_few_periods_give_no_line_a_mode_of_its_own(periods, unit, rng, seed):
    """The noise of a line from two differences is a tenth of the truth, or none, at one line or other."""
    plant, n = resolved(rng, 2, 1, 1), 2048
    signal = uq.signals.Multisine(start_hz=10.0, stop_hz=1200.0, period_samples=n, peak=1.0)
    u = signal.generate(samples=periods * n, rate_hz=RATE_HZ, seed=seed)[None]
    y = plant.simulate(u)
    y = unit * (y + 0.05 * y.std() * rng.standard_normal(y.shape))
    found = uq.identify.WeightedRational(period_samples=n).identify(uq.Record(u, y, RATE_HZ))
    assert found.status.ok, found.status
    assert found.model.states == 4
    assert found.details["cost"] == pytest.approx(1.0, abs=0.25)


@pytest.mark.draws(false_alarm=1e-3)  # a test at the level of a thousandth; 1 of 400 draws
def test_a_model_that_misses_more_than_the_noise_is_not_ok(rng):
    """White over the lines is what wrong models leave: of a late input, of a gain."""
    method = uq.identify.WeightedRational(order=4)
    _, record = ringing(rng, 0.01, rng.standard_normal((1, 5000)))
    assert method.identify(record).status.ok
    late = uq.Record(record.inputs[:, 1:], record.outputs[:, :-1], 1000.0)
    plain = uq.Record(record.inputs, record.inputs, 1000.0)
    for wrong in (late, plain):
        assert method.identify(wrong).status.word in {"poor fit", "not white", "not converged"}


@pytest.mark.slow
def test_periods_that_are_not_said_are_fitted_all_the_same(rng, seed):
    """Between the lines of the periods no input moves, and nothing is known of the gain."""
    plant, record = ringing(rng, 0.01, multisine(20, seed))
    found = uq.identify.WeightedRational(order=4).identify(record.part(4000))
    g = np.geomspace(2.0, 440.0, 200)
    T = plant.frequency_response(g)
    miss = np.linalg.norm(found.model.frequency_response(g) - T) / np.linalg.norm(T)
    print(f"{miss:.1e} off, {found.status}")
    assert miss < 2e-3


def sharp(rng, ny, nu, units):
    """Two modes of a quarter and half a hertz, seen through a tenth of white noise; at their peaks, the true gains."""
    s = 2 * np.pi * np.array([60.0, 150.0]) * (-0.002 + 1j)
    A = np.zeros((4, 4))
    for k, p in enumerate(np.exp(s / 1000.0)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    B, C = (rng.uniform(0.5, 1.5, k) * rng.choice([-1.0, 1.0], k) for k in ((4, nu), (ny, 4)))
    C *= [1.0, 1.0, 0.3, 0.3]
    plant = uq.StateSpace(A, units * B, C, np.zeros((ny, nu)), 1000.0)
    u = rng.standard_normal((nu, 8000)) / units
    y = plant.simulate(u)
    return plant, uq.Record(u, y + 0.1 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape), 1000.0)


@pytest.mark.gate("1-1-1.0")
@pytest.mark.draws(false_alarm=5e-3)  # one of 305 draws is off by 0.407 at a peak
@pytest.mark.parametrize(("ny", "nu", "units"), [(1, 1, 1.0), (2, 3, 1e6)])
def test_modes_sharper_than_a_window_are_found_at_their_order(rng, ny, nu, units):
    for _ in range(4 if ny == 1 else 1):
        plant, record = sharp(rng, ny, nu, units)
        found = uq.identify.WeightedRational(order=4).identify(record)
        told, true = (x.frequency_response(np.array([60.0, 150.0])) for x in (found.model, plant))
        share = np.abs(told - true).max(axis=(0, 1)) / np.abs(true).max(axis=(0, 1))
        print(f"off by {share} at the peaks, {found.status}")
        assert share.max() < 0.4


def without_one(rng, ny, nu, units):
    """Such a record, its second mode more than 0.12 of an output's RMS: the verdict lets 0.1 of it be missed."""
    while True:
        plant, record = sharp(rng, ny, nu, units)
        second = uq.StateSpace(plant.A[2:, 2:], plant.B[2:], plant.C[:, 2:], plant.D, plant.rate_hz)
        share = second.simulate(record.inputs).std(axis=1) / record.outputs.std(axis=1)
        if share.max() > 0.12:
            return record


@pytest.mark.parametrize(("ny", "nu", "units"), [(1, 1, 1.0), (2, 3, 1e-6)])
def test_a_mode_that_is_missing_is_told(rng, ny, nu, units):
    for _ in range(4 if ny == 1 else 1):
        found = uq.identify.WeightedRational(order=2).identify(without_one(rng, ny, nu, units))
        print(found.fit_percent, found.status)
        assert not found.status.ok
