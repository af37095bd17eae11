"""Rational fits of measured responses, and the periodic responses they start from."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.identify.response import fewest_modes
from ultraquiet.linalg import pole_residue, vector_fitting
from ultraquiet.linalg.modes import rank_one

RATE_HZ = 3500.0
CLOSE = 8  # plants drawn


def random_modal(rng, modes, nu, ny, rate_hz=RATE_HZ):
    """A plant of modes between 5 and 1000 Hz, in blocks, responding one sample late."""
    f = np.sort(np.exp(rng.uniform(np.log(5), np.log(1000), modes)))
    zeta = rng.uniform(0.005, 0.05, modes)
    poles = np.exp(2 * np.pi * f / rate_hz * (-zeta + 1j * np.sqrt(1 - zeta**2)))
    A = np.zeros((2 * modes, 2 * modes))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    size = np.repeat(np.sqrt(1 - np.abs(poles)), 2)
    B, C = size[:, None] * rng.standard_normal((2 * modes, nu)), rng.standard_normal((ny, 2 * modes)) * size
    return uq.StateSpace(A, B, C, np.zeros((ny, nu)), rate_hz), poles


def response(plant, f):
    return uq.FrequencyResponse(f, plant.frequency_response(f))


def test_an_exact_response_gives_its_poles_back(rng):
    for _ in range(5):
        plant, poles = random_modal(rng, 4, 2, 2)
        f = np.unique(np.concatenate([np.geomspace(1, 1700, 400), np.abs(np.angle(poles)) * RATE_HZ / (2 * np.pi)]))
        z = np.exp(2j * np.pi * f / RATE_HZ)
        G = plant.frequency_response(f)
        start = np.exp(2 * np.pi * np.geomspace(2, 1500, 4) / RATE_HZ * (-0.1 + 1j))
        weight = 1 / np.sqrt(np.mean(np.abs(G) ** 2, axis=(0, 1)))
        found = vector_fitting.fit(z, G, weight, np.concatenate([start, start.conj()]), 40)
        own = np.sort_complex(np.concatenate([poles, poles.conj()]))
        error = np.abs(np.sort_complex(found.poles) - own).max()
        print(f"poles within {error:.1e}, error {found.error:.1e}")
        assert found.error < 1e-6
        assert error < 1e-6


def test_zeros_at_one_are_kept(rng):
    plant, _ = random_modal(rng, 3, 2, 2)
    z = np.exp(2j * np.pi * np.geomspace(1, 1700, 200) / RATE_HZ)
    poles = vector_fitting.paired(np.exp(rng.uniform(-0.3, -0.01, 6) + 1j * np.array([0, 0, 0.2, -0.2, 1, -1])))
    poles = vector_fitting.paired(
        np.concatenate([poles[poles.imag == 0], poles[poles.imag > 0], poles[poles.imag > 0].conj()])
    )
    G = plant.frequency_response(np.geomspace(1, 1700, 200))
    R = vector_fitting.residues(z, G, np.ones(200), poles, zeros_at_one=2).residues
    for power in (1, 2):
        moment = np.einsum("ijk,k->ij", R, (1 - poles) ** -float(power))
        assert np.abs(moment).max() < 1e-8 * np.einsum("ijk,k->ij", np.abs(R), np.abs(1 - poles) ** -power).max()


def test_the_order_is_found_and_the_model_meets_the_plant(rng):
    plant, _ = random_modal(rng, 4, 3, 3)
    f = np.arange(1, 1700.0)
    fit = uq.identify.Rational().identify_response(response(plant, f), RATE_HZ)
    error = np.abs(fit.model.frequency_response(f) - plant.frequency_response(f))
    relative = error.max() / np.abs(plant.frequency_response(f)).max()
    print(f"order {fit.order}, {fit.model.states} states, relative error {relative:.1e}")
    assert fit.status.ok
    assert fit.order == 8
    assert fit.model.is_stable()
    assert relative < 5e-3


@pytest.mark.slow
def test_noise_makes_no_poles(seed, rng):
    """The suite's plant: the order stays what the physics is worth, whatever the noise."""
    from ultraquiet.pipeline import packaged_study
    from ultraquiet.pipeline.identification import plant as identified

    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    wanted = packaged_study("suite").plant
    records = {}
    for name, start, stop, peak in (("lowest", 1, 12, 20), ("low", 12.5, 150, 12), ("high", 150.5, 1749, 3)):
        signal = uq.signals.Multisine(start_hz=start, stop_hz=stop, period_samples=7000, peak_v=peak)
        for j in range(6):
            u = np.zeros((6, 21000))
            u[j] = signal.generate(21000, RATE_HZ, int(rng.integers(2**31)))
            records[f"{name}-{j + 1}"] = bench.run(u)
    found = identified(records, wanted)
    G, truth = found.values["plant"], bench.linear_model()
    f = np.concatenate([np.arange(3, 130, 0.5), np.geomspace(130, 1700, 300)])
    T = np.moveaxis(truth.frequency_response(f), 2, 0)
    error = np.linalg.norm(np.linalg.solve(T, np.moveaxis(G.frequency_response(f), 2, 0) - T), 2, axis=(1, 2))
    print(f"order {found.facts.order}, {G.states} states; worst direction off by {error.max():.1%} over 3-1700 Hz")
    assert G.is_stable()
    assert error.max() < 0.25
    assert np.median(error) < 0.03


@pytest.mark.slow
def test_a_hold_leaves_one_of_three_zeros_at_dc():
    """The bench's own response, without noise: asked for all three of eq. (10), the lowest lines cannot be met."""
    truth = uq.bench.Hexapod(unit="ground").linear_model()
    f = np.geomspace(1, 1700, 400)
    low = np.geomspace(1, 4, 20)
    T = np.moveaxis(truth.frequency_response(low), 2, 0)
    errors = {}
    for zeros in (1, 3):
        fit = uq.identify.Rational(order=16, zeros_at_dc=zeros).identify_response(response(truth, f), RATE_HZ)
        G = np.moveaxis(fit.model.frequency_response(low), 2, 0)
        errors[zeros] = np.linalg.norm(np.linalg.solve(T, G - T), 2, axis=(1, 2)).max()
    print(f"worst direction off over 1-4 Hz: {errors[1]:.1%} with one zero at z = 1, {errors[3]:.0%} with three")
    assert errors[1] < 0.03
    assert errors[3] > 1.0
    still, slow = (np.linalg.norm(truth.frequency_response(np.array([f_hz]))) for f_hz in (0.01, 0.02))
    assert abs(slow / still - 2.0) < 0.01


def test_periodic_response_measures_noise_beside_it(rng):
    plant, _ = random_modal(rng, 3, 1, 1)
    signal = uq.signals.Multisine(start_hz=10, stop_hz=1500, period_samples=3500, peak_v=10.0)
    u = signal.generate(3500 * 12, RATE_HZ, 1)
    noise = 0.05
    y = plant.simulate(u[None]) + noise * rng.standard_normal((1, u.size))
    g = uq.spectra.periodic_response([uq.Record(u, y, RATE_HZ)], 3500, settle_periods=3)
    assert np.array_equal(g.f_hz, signal.lines_hz(RATE_HZ))
    error = np.abs(g.values - plant.frequency_response(g.f_hz)) ** 2
    ratio = float(np.mean(error) / np.mean(g.variance))
    print(f"squared error over the variance told: {ratio:.2f}")
    assert 0.8 < ratio < 1.25


def test_refusals(rng):
    plant, _ = random_modal(rng, 2, 1, 1)
    f = np.arange(1, 1700.0)
    with pytest.raises(uq.errors.InputError, match="contradict a rate of 1000 Hz"):
        uq.identify.Rational().identify_response(response(plant, f), 1000.0)
    with pytest.raises(uq.errors.InputError, match="too few"):
        uq.identify.Rational(order=8).identify_response(response(plant, f[:20]), RATE_HZ)
    silent = uq.Record(np.zeros((1, 7000)), np.zeros((1, 7000)), RATE_HZ)
    with pytest.raises(uq.errors.InputError, match="must excite actuator 1"):
        uq.spectra.periodic_response([silent], 3500)
    short = uq.Record(np.ones((1, 5000)) * np.arange(5000), np.zeros((1, 5000)), RATE_HZ)
    with pytest.raises(uq.errors.InputError, match="whole periods"):
        uq.spectra.periodic_response([short], 3500)


def test_a_delay_that_lines_cannot_tell_is_refused_at_once(rng):
    u = rng.standard_normal((1, 2000))
    record = uq.Record(u, u + 0.1 * rng.standard_normal((1, 2000)), 1000.0)
    lines = uq.spectra.frf(record)
    late, dead = uq.identify.Rational(delay=5000), uq.identify.WeightedRational(delay_s=100.0)
    for refused in (
        lambda: late.identify(record),
        lambda: late.identify_response(lines, 1000.0),
        lambda: dead.identify(record),
        lambda: dead.identify_response(lines),
    ):
        with pytest.raises(uq.errors.InputError, match=r"'delay(_s)?' is .* Hz apart tell delays below .*lower it"):
            refused()


def test_more_zeros_than_poles_are_refused():
    with pytest.raises(uq.errors.InputError, match="zeros_at_dc"):
        uq.identify.Rational(order=2, zeros_at_dc=3)


@pytest.mark.parametrize("pole", [0.5 + 0.2j, 0.5 + 0j])
def test_a_pole_without_a_residue_takes_no_states(pole):
    A, B, C = pole_residue.joined([pole_residue.block(pole, np.zeros((3, 2), complex), 1e-9)] * 2)
    assert (A.shape, B.shape, C.shape) == ((0, 0), (0, 2), (3, 0))


def test_spare_poles_of_an_exact_response_are_left_out_not_stumbled_over(rng):
    plant, _ = random_modal(rng, 1, 2, 2)
    f = np.linspace(2.0, 1200.0, 400)
    found = uq.identify.Rational(order=9, rank_tolerance=0.01).identify_response(response(plant, f), RATE_HZ)
    assert found.status.ok
    print(f"{len(found.model.A)} states of order 9 kept")
    assert len(found.model.A) < 9 * 2


def test_a_response_blurred_by_leakage_is_no_good_model_of_its_record(rng):
    lag = uq.StateSpace([[0.9998]], [[0.02]], [[1.0]], [[0.0]], RATE_HZ)
    for _ in range(5):
        u = rng.standard_normal((1, 12000))
        found = uq.identify.Rational(order=1, iterations=4).identify(uq.Record(u, lag.simulate(u), RATE_HZ))
        print(found.status, found.fit_percent)
        assert not found.status.ok or found.fit_percent[0] > 0.0


def test_noise_in_the_record_is_no_fault_of_the_model(rng):
    plant = uq.StateSpace([[0.9, 0.3], [-0.3, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], RATE_HZ)
    u = rng.standard_normal((1, 8000))
    y = plant.simulate(u)
    noisy = uq.Record(u, y + 0.5 * y.std() * rng.standard_normal(y.shape), RATE_HZ)
    found = uq.identify.Rational(order=2, floor=0.2).identify(noisy)
    print(found.status, found.fit_percent)
    assert found.status.word != "poor fit" or "simulated" not in found.status.sentence


def measured_with_noise(rng, plant, f, noise_share):
    G = plant.frequency_response(f)
    noise = noise_share * np.sqrt(np.mean(np.abs(G) ** 2))
    drawn = noise * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)) / np.sqrt(2)
    return uq.FrequencyResponse(f, G + drawn, variance=np.full(G.shape, noise**2))


def lean_against_full(rng, modes, channels, noise_share):
    """States found, and the error at fresh lines against that of residues of full rank at the same order."""
    plant, _ = random_modal(rng, modes, *channels)
    f = np.arange(1, 3400) * 0.5
    fit = uq.identify.Rational().identify_response(measured_with_noise(rng, plant, f, noise_share), RATE_HZ)
    held_out_before = fit.errors_by_order[fit.order]
    print(f"{fit.model.states} states of {2 * modes}, held out {held_out_before:.5f} -> {fit.error[1]:.5f}")
    assert fit.model.is_stable()
    assert fit.status.ok
    return fit.model.states / (2 * modes), fit.error[1] / held_out_before


# Precision that is not worth a state is given up: 7 of 91 plants lose by it, five of these no more than 0.11 %.
TWO_BY_TWO = pytest.param((2, 2), marks=pytest.mark.draws(false_alarm=0.1))


@pytest.mark.parametrize("channels", [TWO_BY_TWO, (4, 3), (3, 5)])
def test_a_mode_costs_two_states(first_seed, channels):
    states, error = lean_against_full(np.random.default_rng(first_seed), 6, channels, 1e-2)
    assert states <= 1.0
    assert error <= 1.0


def suspended(rng, ny, nu):
    """Three modes within 4 % of each other, heard at a dozen of some 3400 lines, and three far above."""
    first = rng.uniform(4.0, 8.0)
    modes = [(first * share, 0.05, rng.choice([0.3, 1.0, 3.0])) for share in (1.0, 1.01, 1.04)]
    modes += [(40.0, 0.08, 1.0), (65.0, 0.08, 1.0), (360.0, 0.2, 1.0)]
    A, B, C = np.zeros((12, 12)), np.zeros((12, nu)), np.zeros((ny, 12))
    for k, (f, zeta, gain) in enumerate(modes):
        p = np.exp(2 * np.pi * f / RATE_HZ * (-zeta + 1j * np.sqrt(1 - zeta**2)))
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
        B[2 * k] = gain * 2 * np.pi * f * zeta / RATE_HZ * rng.standard_normal(nu)
        C[:, 2 * k + 1] = rng.standard_normal(ny)
    return uq.StateSpace(A, B, C, np.zeros((ny, nu)), RATE_HZ)


@pytest.mark.draws(false_alarm=0.12)  # 4 of 264 plants are off by 4 to 7 %, eight are drawn
@pytest.mark.parametrize(("ny", "nu", "unit"), [(4, 4, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_no_line_pays_for_a_mode_that_leaves(ny, nu, unit, rng):
    """A root of means over all lines hardly hears what a few of them miss."""
    worst = []
    for _ in range(CLOSE):
        plant = suspended(rng, ny, nu)
        f = np.arange(1.0, 1700.0, 0.5)
        fit = uq.identify.Rational().identify_response(measured_with_noise(rng, unit * plant, f, 3e-3), RATE_HZ)
        between = f[:100] + 0.25
        T = unit * plant.frequency_response(between)
        missed = np.linalg.norm(fit.model.frequency_response(between) - T, axis=(0, 1)) / np.linalg.norm(T, axis=(0, 1))
        worst.append(missed.max())
        print(f"{fit.model.states} states of 12, worst line off by {worst[-1]:.1%}")
        assert fit.status.ok
        assert fit.model.states <= 14
    assert max(worst) < 0.04


@pytest.mark.draws(false_alarm=0.06)  # 2 of 140 plants keep more states, up to 24; four are drawn
@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize(("ny", "nu", "unit"), [(4, 4, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_no_mode_stands_for_the_noise_of_a_few_lines(ny, nu, unit, told, rng):
    """What a plant's play adds to the lines about its slow modes is noise that no variance may tell of."""
    f = np.arange(1.0, 1700.0, 0.5)
    for _ in range(CLOSE // 2):
        G = unit * suspended(rng, ny, nu).frequency_response(f)
        size = np.sqrt(np.mean(np.abs(G) ** 2, axis=(0, 1)))
        noise = np.where(f < 60.0, 0.05, 3e-3) * size
        drawn = noise * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)) / np.sqrt(2)
        variance = np.broadcast_to((noise if told else 3e-3 * size) ** 2, G.shape)
        fit = uq.identify.Rational().identify_response(uq.FrequencyResponse(f, G + drawn, variance=variance), RATE_HZ)
        missed = np.linalg.norm(fit.model.frequency_response(f) - G, axis=(0, 1)) / np.linalg.norm(G, axis=(0, 1))
        print(f"{fit.model.states} states of 12, worst line off by {missed.max():.1%}")
        assert fit.status.ok
        assert fit.model.states <= 14


@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_units_change_no_states(first_seed, size):
    rng = np.random.default_rng(first_seed)
    plant, _ = random_modal(rng, 3, 2, 3)
    f = np.arange(1, 1700.0)
    G = measured_with_noise(rng, plant, f, 1e-2)
    assert G.variance is not None
    scaled = uq.FrequencyResponse(f, size * G.values, variance=size**2 * G.variance)
    one, other = (uq.identify.Rational().identify_response(g, RATE_HZ) for g in (G, scaled))
    assert one.model.states == other.model.states
    difference = other.model.frequency_response(f) / size - one.model.frequency_response(f)
    assert np.abs(difference).max() < 1e-6 * np.abs(G.values).max()


@pytest.mark.parametrize("channels", [(1, 1), (4, 3), (3, 5)])
def test_no_channel_is_missed_for_the_unit_it_is_recorded_in(first_seed, channels):
    rng = np.random.default_rng(first_seed)
    plant, _ = random_modal(rng, 3, *channels[::-1])
    f = np.arange(1, 1700.0)
    G = measured_with_noise(rng, plant, f, 1e-2)
    assert G.variance is not None
    units = 10.0 ** rng.uniform(-3, 3, (channels[0], 1, 1)) * 10.0 ** rng.uniform(-3, 3, (1, channels[1], 1))
    other = uq.FrequencyResponse(f, units * G.values, variance=units**2 * G.variance)
    one, two = (uq.identify.Rational(order=6).identify_response(g, RATE_HZ) for g in (G, other))
    assert one.status == two.status
    assert one.model.states == two.model.states
    difference = two.model.frequency_response(f) / units - one.model.frequency_response(f)
    missed = one.model.frequency_response(f) - plant.frequency_response(f)
    print(f"apart by {np.abs(difference).max():.1e}, off the truth by {np.abs(missed).max():.1e}")
    assert np.abs(difference).max() < 1e-3 * np.abs(missed).max()


@pytest.mark.draws(false_alarm=5e-2)  # 3 of 120 plants: a mode of less than the silent sensor's noise left unseen
def test_a_silent_sensor_of_any_unit_hides_no_line_of_another(first_seed):
    """Where one line is far from the next, a mode may be missed without it as well."""
    rng = np.random.default_rng(first_seed)
    plant, _ = random_modal(rng, 3, 1, 1)
    f = np.arange(1, 1700.0)
    G = measured_with_noise(rng, plant, f, 1e-3)
    assert G.variance is not None
    noise = rng.standard_normal((3, 1, f.size)) + 1j * rng.standard_normal((3, 1, f.size))

    def missed_by(model):
        missed = np.abs(model.frequency_response(f)[:1] - plant.frequency_response(f)).max()
        return float(missed / np.abs(G.values).max())

    alone = missed_by(uq.identify.Rational(order=6).identify_response(G, RATE_HZ).model)
    for unit in (1e-6, 1.0, 1e6):
        both = uq.FrequencyResponse(
            f,
            np.concatenate([G.values, unit * noise / np.sqrt(2)]),
            variance=np.concatenate([G.variance, np.full((3, 1, f.size), unit**2)]),
        )
        fit = uq.identify.Rational(order=6).identify_response(both, RATE_HZ)
        missed = missed_by(fit.model)
        print(f"unit {unit:g}: off by {missed:.1e}, without the silent ones {alone:.1e}")
        assert fit.status.ok
        assert missed < max(0.01, 1.5 * alone)


def test_the_zero_at_dc_outlasts_the_leaving_of_modes():
    truth = uq.bench.Hexapod(unit="ground").linear_model()
    f = np.geomspace(1, 1700, 400)
    found = uq.identify.Rational(order=6, zeros_at_dc=1, delay=2).identify_response(response(truth, f), RATE_HZ).model
    still, lowest = (np.abs(found.frequency_response(np.array([f_hz]))).max() for f_hz in (1e-9, 1.0))
    print(f"{found.states} states; gain at 1e-9 Hz {still:.1e}, at 1 Hz {lowest:.1e}")
    assert still < 1e-7 * lowest


@pytest.mark.slow
@pytest.mark.parametrize(("modes", "channels"), [(15, 6), (30, 12)])
def test_drawn_truths_come_back_with_their_states(modes, channels):
    """Twenty lightly damped truths each, 6x6 of 30 and 12x12 of 60 states, at two levels of noise."""
    found = []
    for k in range(20):
        rng = np.random.default_rng(k)
        found.append(lean_against_full(rng, modes, (channels, channels), 10.0 ** -(2 + k % 2)))
    states, errors = np.array(found).T
    print(f"states over the truth's: median {np.median(states):.2f}, most {states.max():.2f}; error {errors.max():.2f}")
    assert states.max() <= 1.2
    assert errors.max() <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("channels", [(1, 1), (4, 3), (3, 5)])
def test_few_channels_come_back_with_their_states(channels):
    """Where a residue has rank one or nearly so, spare poles are what is to be left out."""
    found = [lean_against_full(np.random.default_rng(k), 8, channels, 10.0 ** -(2 + k % 2)) for k in range(12)]
    states, errors = np.array(found).T
    print(
        f"states over the truth's: most {states.max():.2f}; error: median {np.median(errors):.3f}, {errors.max():.3f}"
    )
    assert states.max() <= 1.2
    assert np.median(errors) <= 1.0
    assert errors.max() <= 1.01


@pytest.mark.slow
def test_the_last_fit_to_all_lines_brings_the_model_nearer_to_the_truth():
    f = np.arange(1, 3400) * 0.5
    told, true = [], []
    for k in range(6):
        rng = np.random.default_rng(k)
        plant, _ = random_modal(rng, 6, 3, 4)
        T = plant.frequency_response(f)
        fit = uq.identify.Rational().identify_response(measured_with_noise(rng, plant, f, 1e-2), RATE_HZ)
        size = np.sqrt(np.mean(np.abs(T) ** 2, axis=(0, 1)))
        true.append(np.sqrt(np.mean(np.abs((fit.model.frequency_response(f) - T) / size) ** 2)))
        told.append(fit.error[1])
    print(f"off the truth by {np.round(true, 5)} of the response, held-out noise {np.round(told, 5)}")
    assert max(true) < 0.0015


@pytest.mark.parametrize(("ny", "nu", "unit"), [(1, 1, 1.0), (4, 3, 1e9), (3, 5, 1e-9)])
def test_a_needle_between_two_lines_leaves_a_trial_of_fewer_modes(ny, nu, unit, rng):
    """A mode so sharp that no line tells its damping meets the noise of two lines and misses the one between them."""
    plant, poles = random_modal(rng, 4, nu, ny)
    f = np.arange(4.0, 1200.0, 4.0)
    z = np.exp(2j * np.pi * f / RATE_HZ)
    G = unit * plant.frequency_response(f)
    weight = 1 / np.sqrt(np.mean(np.abs(G) ** 2, axis=(0, 1)))
    noise = rng.standard_normal((*G.shape, 2)) @ [1.0, 1j]
    fitted, held_out = (
        rank_one.Samples(z[k::2], (G + 0.01 / weight * noise)[:, :, k::2], weight[k::2]) for k in (0, 1)
    )
    needle = z[51] * np.exp(-1e-6)
    start = np.append(poles, needle)
    b = rng.standard_normal((start.size, nu)) + 0j
    modes = rank_one.fitted_outputs(rank_one.of(start, np.zeros((ny, start.size)), b), fitted)
    none = np.zeros(held_out.z.size)
    task = fewest_modes.Thinning(fitted, held_out, 0.015, 0.003, none, none)
    plain = rank_one.refined(modes, fitted, 0)
    trial = task.tried(modes, 0)
    print(f"{held_out.error(plain):.3g} with the needle, {trial.held_out:.3g} without")
    assert trial.held_out < held_out.error(plain)
    # a slow mode of the plant may lie as sharp between two lines, and leave as well
    assert trial.modes.poles.size <= modes.poles.size - 2
    assert not np.isclose(trial.modes.poles, needle).any()
