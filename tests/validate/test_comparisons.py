"""Fits and agreements against definitions written out by hand."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet._base.errors import InputError

MODEL = uq.PolynomialModel([[0, 0.4, 0.2]], [[1, -1.5, 0.8]], 100.0, c=[1, 0.4], d=[1, -0.7])


@pytest.fixture
def record(rng):
    u, e = rng.standard_normal((2, 2000))
    y = lfilter(MODEL.b[0], MODEL.f[0], u) + lfilter(MODEL.c, MODEL.d, 0.2 * e)
    return uq.Record(u, y, 100.0)


def test_simulated_fit_is_the_definition(record):
    y = record.outputs[0]
    out = lfilter(MODEL.b[0], MODEL.f[0], record.inputs[0])
    fit = 100 * (1 - np.linalg.norm(y - out) / np.linalg.norm(y - y.mean()))
    found = uq.validate.compare(MODEL, record, initial="rest", offset=False)
    assert found.fit_percent[0] == pytest.approx(fit, abs=1e-9)
    same = uq.validate.compare(MODEL.state_space(), record, initial="rest", offset=False)
    assert same.fit_percent[0] == pytest.approx(fit, abs=1e-6)


def test_a_cut_record_needs_its_initial_state(record):
    cut = record.part(701)
    rest, estimated = (uq.validate.compare(MODEL, cut, initial=i).fit_percent[0] for i in ("rest", "estimate"))
    system = uq.validate.compare(MODEL.state_space(), cut).fit_percent[0]
    print(f"\nfrom the middle: at rest {rest:.3f} %, state estimated {estimated:.3f} %, by state space {system:.3f} %")
    assert estimated > rest
    assert system == pytest.approx(estimated, abs=0.05)


def test_k_step_predictions_run_from_innovations_to_simulation(record):
    fits = [uq.validate.compare(MODEL, record, steps=k).fit_percent[0] for k in (1, 2, 5, 200)]
    simulated = uq.validate.compare(MODEL, record).fit_percent[0]
    print(f"\n1, 2, 5, 200 steps: {np.round(fits, 2)} %, simulated {simulated:.2f} %")
    assert np.all(np.diff(fits) <= 0.05)
    assert fits[-1] == pytest.approx(simulated, abs=0.5)
    e = record.outputs[0] - uq.validate.predicted(MODEL, record, 1)[0]
    assert e == pytest.approx(uq.validate.innovations(MODEL, record)[0], abs=1e-12)


def test_two_step_prediction_by_hand(rng):
    # y = e / (1 - 0.7 q^-1): the best prediction two steps ahead is 0.49 y(t - 2).
    model = uq.PolynomialModel([[0.0, 0.0]], [[1.0]], 1.0, d=[1, -0.7])
    y = lfilter([1.0], [1, -0.7], rng.standard_normal(500))
    out = uq.validate.predicted(model, uq.Record(rng.standard_normal(500), y - y.mean(), 1.0), 2)[0]
    assert out[20:] == pytest.approx(0.49 * (y - y.mean())[18:-2], abs=0.06)


def test_the_clipped_sine_is_judged_clipped(seed):
    # Figure 10 of the paper: 60 Hz, 25 V, cut at +-10 V.
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    volts = 25 * np.sin(2 * np.pi * 60 * np.arange(1400) / bench.rate_hz)
    inputs = np.zeros((6, 1400))
    inputs[1] = volts
    record = bench.run(inputs).pick([1], [1])
    noise = uq.signals.BandLimitedNoise(stop_hz=250, peak_v=25)
    inputs = np.zeros((6, 4096))
    inputs[1] = noise.generate(samples=4096, rate_hz=bench.rate_hz, seed=seed)
    model = uq.identify.BoxJenkins(order=5).identify(bench.run(inputs).pick([1], [1])).model
    aware = uq.validate.compare(model, record)
    blind = uq.validate.compare(model, record, clip=False)
    print(
        f"\n60 Hz sine: {aware.clipped[0]} of 1400 samples clipped, fit {aware.fit_percent[0]:.1f} % with the model's "
        f"output cut alike, {blind.fit_percent[0]:.1f} % without"
    )
    assert aware.clipped[0] > 0
    assert aware.fit_percent[0] > blind.fit_percent[0]
    assert aware.fit_percent[0] > 85


def test_bode_agreement():
    louder = uq.PolynomialModel([2 * MODEL.b[0]], MODEL.f, 100.0)
    later = uq.PolynomialModel([np.concatenate([[0.0], MODEL.b[0]])], MODEL.f, 100.0)
    assert uq.validate.bode_agreement(MODEL, louder, (1, 40)).worst_gain_db[0, 0] == pytest.approx(6.0206, abs=1e-4)
    shift = uq.validate.bode_agreement(MODEL, later, (1, 40))
    assert shift.worst_phase_deg[0, 0] == pytest.approx(360 * 40 / 100, abs=1e-6)
    assert shift.worst_gain_db[0, 0] == pytest.approx(0.0, abs=1e-9)
    f_hz = np.array([0.5, 5.0, 10.0, 45.0])
    measured = uq.FrequencyResponse(f_hz, MODEL.frequency_response(f_hz))
    found = uq.validate.bode_agreement(measured, louder, (1, 40))
    assert found.f_hz.tolist() == [5.0, 10.0]
    with pytest.raises(InputError, match=r"band must run upwards"):
        uq.validate.bode_agreement(MODEL, louder, (40, 1))
    with pytest.raises(InputError, match=r"no line at some"):
        uq.validate.bode_agreement(measured, louder, f_hz=[7.0])


def test_a_line_is_found_whichever_way_its_frequency_was_rounded(rng):
    lines, mixed = np.arange(1, 301), rng.permutation(300)
    G = rng.standard_normal((3, 5, 300)) + 1j * rng.standard_normal((3, 5, 300))
    one = uq.FrequencyResponse(lines * (3500.0 / 600), G)
    other = uq.FrequencyResponse(lines * 3500.0 / 600, 2.0 * G)
    shuffled = uq.FrequencyResponse(other.f_hz[mixed], 2.0 * G[:, :, mixed])
    assert (one.f_hz < other.f_hz).any()
    for first, second in ((one, other), (other, one), (one, shuffled)):
        found = uq.validate.bode_agreement(first, second)
        assert np.allclose(np.abs(found.gain_db), 20.0 * np.log10(2.0))
        assert np.abs(found.phase_deg).max() < 1e-6
    for nominal, seen, radius in ((one, other, 1.0), (other, one, 0.5)):
        assert np.allclose(uq.validate.from_spread(nominal, [seen], kind="entry").radius, radius)
    apart = uq.FrequencyResponse(one.f_hz * (1.0 + 1e-6), G)
    with pytest.raises(InputError, match="no line at some of the 300 frequencies"):
        uq.validate.bode_agreement(one, apart)


def test_an_unstable_model_fits_nothing(record):
    wild = uq.PolynomialModel(MODEL.b, [[1.0, -1.1]], 100.0)
    assert uq.validate.compare(wild, record).fit_percent[0] == -np.inf
    assert uq.validate.compare(wild.state_space(), record).fit_percent[0] == -np.inf


def slow_record(rng, size=1.0):
    """A first-order plant that outlasts its record, with a constant at its output and a state to begin with."""
    plant = uq.StateSpace([[0.995]], [[0.005 * size]], [[1.0]], [[0.0]], rate_hz=1.0)
    u = 5 + rng.standard_normal((1, 400))
    return plant, uq.Record(u, plant.simulate(u) + size * (3 + 2 * 0.995 ** np.arange(400)), 1.0)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_constant_and_initial_state_are_fitted_together(rng, size):
    plant, record = slow_record(rng, size)
    assert uq.validate.compare(plant, record).fit_percent[0] > 99.99
    ny, noisy = 1, np.array([[0.3]])
    model = uq.InnovationForm(plant.A, plant.B, plant.C, plant.D, noisy, np.eye(ny), 1.0)
    assert np.abs(uq.validate.innovations(model, record)).max() < 1e-7 * size


def test_outputs_in_unequal_units_share_their_state_fairly(rng):
    A, C = np.array([[0.99, 0.1], [0.0, 0.98]]), np.array([[1.0, 0.3], [0.2, 1.0], [0.5, -1.0]])
    u, e = rng.standard_normal((1, 500)), rng.standard_normal((3, 500))
    fits = []
    for unit in (1.0, 1e9):
        plant = uq.StateSpace(A, [[0.1], [0.1]], np.diag([1, unit, 1]) @ C, np.zeros((3, 1)), 10.0)
        y = plant.simulate(u, np.array([3.0, -2.0])) + np.diag([1, unit, 1]) @ (7 + 0.3 * e)
        fits.append(uq.validate.compare(plant, uq.Record(u, y, 10.0)).fit_percent)
    assert fits[0] == pytest.approx(fits[1], abs=1e-6)


@pytest.mark.parametrize("poles", [(1.0,), (1.0, 1.0), (1.0, 0.9)])
def test_an_integrator_is_simulated(rng, poles):
    u = rng.standard_normal(300)
    f = np.poly(poles)
    y = lfilter([0.0, 0.1], f, u) + 4 + (0.02 * np.arange(300) if poles[1:] == (1.0,) else 0.0)
    model, record = uq.PolynomialModel([[0.0, 0.1]], [f], 1.0), uq.Record(u, y, 1.0)
    assert uq.validate.compare(model, record).fit_percent[0] > 99.99
    assert uq.validate.compare(model.state_space(), record).fit_percent[0] > 99.99


@pytest.mark.parametrize(("ny", "nu", "unit"), [(4, 3, 1e9), (3, 5, 1e-9)])
def test_a_record_with_its_channels_in_another_order_is_no_poor_fit(ny, nu, unit, rng):
    A, B, C = np.diag([0.9, -0.5]), rng.standard_normal((2, nu)), unit * rng.standard_normal((ny, 2))
    forces, speeds = [f"force {k}" for k in range(nu)], [f"speed {k}" for k in range(ny)]
    model = uq.StateSpace(A, B, C, np.zeros((ny, nu)), 100.0, forces, speeds)
    u = rng.standard_normal((nu, 300))
    record = uq.Record(u, model.simulate(u), 100.0, forces, speeds)
    for swapped in (record.pick(inputs=forces[::-1]), record.pick(outputs=speeds[::-1])):
        with pytest.raises(InputError, match=r"of the record and \d of the model; bring the record's into"):
            uq.validate.compare(model, swapped)
        found = uq.validate.compare(model, swapped.pick(forces, speeds))
        assert uq.validate.verdict(model, found).ok
    # channels that were only numbered may be any
    numbered = uq.StateSpace(A, B, C, np.zeros((ny, nu)), 100.0)
    assert uq.validate.verdict(numbered, uq.validate.compare(numbered, record)).ok


@pytest.mark.parametrize("kind", ["state space", "polynomials"])
def test_a_record_with_its_sides_exchanged_or_in_other_units_is_not_judged(kind, rng):
    coil, acc = uq.Channel("coil", "N"), uq.Channel("acc", "m/s^2")
    u = rng.standard_normal((1, 400))
    y = lfilter([0.0, 0.5], [1.0, -0.7], u) + 0.01 * rng.standard_normal((1, 400))
    record = uq.Record(u, y, 100.0, [coil], [acc])
    if kind == "polynomials":
        model = uq.identify.Arx(order=1).identify(record).model
    else:
        model = uq.StateSpace([[0.7]], [[1.0]], [[0.5]], [[0.0]], 100.0, [coil], [acc])
    uq.validate.compare(model, record)

    def wired(inputs, outputs):
        return uq.Record(u, y, 100.0, [inputs], [outputs])

    said = (
        "'coil' is an input of the model, which goes from coil to acc, and an output of the record, from acc to coil;"
    )
    with pytest.raises(InputError, match=said):
        uq.validate.compare(model, uq.Record(y, u, 100.0, [acc], [coil]))
    with pytest.raises(InputError, match=r"'acc' is an output of the model.* an input of the record"):
        uq.validate.compare(model, wired(acc, uq.Channel("place", "um")))
    with pytest.raises(
        InputError, match="output 1 is 'acc' in m/s\\^2 of the model and 'acc' in mm/s\\^2 of the record"
    ):
        uq.validate.compare(model, wired(coil, uq.Channel("acc", "mm/s^2")))
    # other names, other spellings and units that nobody stated contradict nothing, nor does a name on both sides
    for fine in (
        wired(uq.Channel("push", "N"), uq.Channel("acc", "m/s²")),
        wired(uq.Channel("coil"), uq.Channel("acc")),
    ):
        uq.validate.compare(model, fine)
    uq.validate.compare(uq.StateSpace([[0.7]], [[1.0]], [[0.5]], [[0.0]], 100.0, ["z"], ["z"]), wired("z", "z"))
