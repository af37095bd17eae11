"""A record that excites a part of all frequencies: what the model holds in the others, and what that costs."""

import numpy as np
import pytest
from test_streaming import stored

import ultraquiet as uq
from ultraquiet.identify.subspace import unexcited
from ultraquiet.identify.subspace.fit import Scaled
from ultraquiet.identify.subspace.unexcited import silent_bands, topped_up

RATE_HZ, STOP_HZ = 2000.0, 500.0
INSIDE_HZ, BEYOND_HZ = np.geomspace(10.0, 0.98 * STOP_HZ, 60), np.linspace(1.1 * STOP_HZ, 990.0, 60)


def flexible(channels=2):
    """Modes beside a direct part that goes on beyond the band, seen by sensors of one pole."""
    rng = np.random.default_rng(7)
    w, zeta = 2 * np.pi * np.array([22.0, 65.0, 180.0, 310.0]), 0.02
    turns = w / RATE_HZ
    A = np.zeros((9, 9))
    for k, turn in enumerate(turns):
        r = np.exp(-zeta * turn)
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = r * np.array(
            [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
        )
    A[8, 8] = 0.3
    B, C = rng.standard_normal((9, channels)), rng.standard_normal((channels, 9))
    return uq.StateSpace(A, 0.1 * B, C, 0.5 * np.eye(channels), RATE_HZ)


def recorded(plant, samples, noise, seed):
    nu = plant.D.shape[1]
    signal = uq.signals.BandLimitedNoise(start_hz=2.0, stop_hz=STOP_HZ, peak_v=1.0)
    u = np.stack([signal.generate(samples=samples, rate_hz=RATE_HZ, seed=nu * seed + j) for j in range(nu)])
    y = plant.simulate(u)
    return uq.Record(u, y + noise * y.std() * np.random.default_rng(seed).standard_normal(y.shape), rate_hz=RATE_HZ)


def off(model, plant, f_hz):
    G, M = (np.moveaxis(s.frequency_response(f_hz), 2, 0) for s in (plant, model))
    return np.linalg.norm(G - M, 2, axis=(1, 2)) / np.linalg.norm(G, 2, axis=(1, 2))


def found_in(record):
    return uq.identify.Subspace(order=20, horizon=20).identify(record).state_space()


def sizes(model, plant):
    """How far a model is off inside the band, in the middle, and beyond it (RMS), by the plant's own size."""
    inside, beyond = (off(model, plant, f_hz) for f_hz in (INSIDE_HZ, BEYOND_HZ))
    return float(np.median(inside)), float(np.sqrt(np.mean(beyond**2)))


@pytest.mark.slow
@pytest.mark.draws(false_alarm=5e-2)  # 1.5 % of sets of 700 such records; of 1021 one has a sharp mode there
def test_a_model_of_too_many_states_is_no_further_off_than_none_where_nothing_was_asked(seed):
    """In the mean square over records, no worse than to say nothing; of a single record no method can promise it.

    An estimate that is drawn towards zero as its prior is has a mean square error no larger than that of zero, over all
    it may be drawn from: 700 records were off by 0.24 to 2.39 times the plant, 0.87 in all, 21 % of them by more than
    the plant. One of 1021 was off by 4.9, `not converged`: a mode of no damping stood on one of the lines looked at.
    """
    plant = flexible()
    found = np.array([sizes(found_in(recorded(plant, 3000, 0.03, 100 * seed + k)), plant) for k in range(32)])
    size = float(np.sqrt(np.mean(found[:, 1] ** 2)))
    print(f"{found[:, 0].max():.2%} off inside, {size:.2f} times the plant beyond, at most {found[:, 1].max():.2f}")
    assert found[:, 0].max() < 0.02
    assert size < 1.0


@pytest.mark.draws(false_alarm=9e-4)  # three of twenty such ratios, drawn 200 000 times
def test_a_model_of_too_many_states_invents_nothing_where_nothing_was_asked(seed, monkeypatch):
    """Left to the others' needs it invents fifty times as much in the middle of twenty records, 1.6 to 384 times."""
    plant, ratios = flexible(), []
    for k in range(3):
        record = recorded(plant, 3000, 0.03, 100 * seed + k)
        heard = sizes(found_in(record), plant)
        with monkeypatch.context() as unheard:
            unheard.setattr(unexcited, "silent_bands", lambda u: [])
            left = sizes(found_in(record), plant)
        print(f"{heard[0]:.2%} off inside, {heard[1]:.2f} times the plant beyond, left to itself {left[1]:.1f}")
        assert heard[0] < 0.02
        ratios.append(left[1] / heard[1])
    assert np.exp(np.mean(np.log(ratios))) > 3.0


@pytest.mark.parametrize("unit", [1e9, 1e-9])
def test_units_of_a_record_change_nothing_beyond_its_band(seed, unit):
    plant = flexible()
    record = recorded(plant, 3000, 0.03, seed)
    scaled = uq.Record(unit * record.inputs, record.outputs / unit, rate_hz=RATE_HZ)
    model, there = found_in(record), found_in(scaled)
    there = uq.StateSpace(there.A, unit * there.B, unit * there.C, unit**2 * there.D, RATE_HZ)
    for f_hz in (INSIDE_HZ, BEYOND_HZ):
        apart = off(there, model, f_hz).max()
        print(f"unit {unit:g}: {apart:.1e} of the model apart")
        assert apart < 1e-6


def test_a_record_on_disk_has_the_same_silent_bands(seed, tmp_path):
    """The model of samples in single precision is that in memory (where its bands are unheard, a hundred times off)."""
    plant = flexible()
    record = recorded(plant, 3000, 0.03, seed)
    both = record, stored(tmp_path, record, "float32")
    found = [uq.identify.Subspace(order=20, horizon=20).identify(each) for each in both]
    memory, disk = (sizes(each.state_space(), plant) for each in found)
    assert found[0].status.word == found[1].status.word
    assert found[0].details["spare_modes"] == found[1].details["spare_modes"]
    print(f"memory and disk: {memory[0]:.2%} and {disk[0]:.2%} off inside, {memory[1]:.3f} and {disk[1]:.3f} beyond")
    assert disk == pytest.approx(memory, rel=0.02)


@pytest.mark.parametrize(("drawn", "unit"), [(21, 1.0), (31, 1e9)])
def test_modes_are_spare_on_disk_that_are_spare_in_memory(drawn, unit, tmp_path):
    """Noise that tops up the inputs tells no mode from another: what the record holds itself decides."""
    drawn = recorded(flexible(), 3000, 0.03, drawn)
    record = uq.Record(drawn.inputs / unit, unit * drawn.outputs, drawn.rate_hz)
    method = uq.identify.Subspace(order=20, horizon=20)
    spare = [method.identify(each).details["spare_modes"] for each in (record, stored(tmp_path, record, "float32"))]
    assert spare[0] == spare[1] > 0


def test_without_noise_the_plant_is_found_as_before():
    plant = flexible()
    model = uq.identify.Subspace(order=9, horizon=20, refine=True).identify(recorded(plant, 3000, 0.0, 1)).model
    assert off(model, plant, np.geomspace(10.0, 990.0, 60)).max() < 1e-6


def test_bands_are_those_of_all_inputs_and_lines_between_sines_are_none():
    n, rng = 2048, np.random.default_rng(1)
    spectrum = np.zeros((2, n // 2 + 1), dtype=complex)
    for k, (low, high, apart) in enumerate(((8, 400, 4), (4, 300, 4))):
        lines = np.arange(low, high, apart)
        spectrum[k, lines] = np.exp(2j * np.pi * rng.random(lines.size))
    u = np.fft.irfft(spectrum, n, axis=1)
    ((first, last),) = silent_bands(u)
    assert 390 < first < 405
    assert last == n // 2 + 1
    data = Scaled.of(uq.Record(u, u + 0.01 * rng.standard_normal(u.shape), rate_hz=1.0))
    added = np.abs(np.fft.rfft(topped_up(data, [(first, last)]).u - data.u, axis=1))
    assert added[:, :first].max() < 1e-9 * added[:, first:-1].min()
    white = uq.Record(rng.standard_normal((2, n)), rng.standard_normal((2, n)), rate_hz=1.0)
    assert silent_bands(white.inputs) == []
    assert topped_up(Scaled.of(white), []).u is not None


@pytest.mark.gate("2-predictor-subspace", "4-subspace")
@pytest.mark.parametrize("method", [uq.identify.Subspace(), uq.identify.PredictorSubspace()], ids=lambda m: m.name)
@pytest.mark.parametrize("tones", [2, 4])
def test_a_few_tones_are_met_by_many_models_and_none_of_them_is_ok(method, tones, rng):
    """Of two to four tones a model was ok in most records, and off by most of the plant between them."""
    plant, record = of_tones(tones, 1, 1.0, rng)
    found = method.identify(record)
    print(
        f"order {found.details['order']}, off by {off(found.state_space(), plant, INSIDE_HZ).max():.2f}, {found.status}"
    )
    assert found.status.word in {"unknown in part", "not white", "not converged"}


@pytest.mark.parametrize("tones", [3, 6])
def test_nor_is_a_response_that_the_prior_alone_holds_up(tones, rng):
    plant, record = of_tones(tones, 1, 1.0, rng)
    found = uq.identify.ImpulseResponse().identify(record)
    print(f"off by {off(found.model.state_space(), plant, INSIDE_HZ).max():.2f}, {found.status}")
    assert found.status.word in {"unknown in part", "not white"}


@pytest.mark.gate("impulse-units0", "arx-regularised-units1")
@pytest.mark.parametrize("units", [(1.0, 1.0), (1e6, 1e-6)])
@pytest.mark.parametrize("method", [uq.identify.RegularisedArx(), uq.identify.ImpulseResponse()], ids=lambda m: m.name)
def test_two_inputs_of_three_tones_are_a_guess_in_any_units(method, units, rng):
    """Of one input an ARX model of thirty lags was ok in all of fifteen such records, and knew 60 to 80 % of itself."""
    t, f_hz = np.arange(2000), np.geomspace(3.0, 40.0, 6).reshape(2, 3)
    u = np.sin(2 * np.pi * (f_hz[:, :, None] * t / 100.0 + rng.random((2, 3, 1)))).sum(axis=1)
    plant = uq.StateSpace([[1.5, -0.8], [1.0, 0.0]], [[1.0, 0.3], [0.0, 0.7]], [[1.0, 0.5]], [[0.0, 0.0]], 100.0)
    y = plant.simulate(u)
    y += 0.1 * y.std() * rng.standard_normal(y.shape)
    found = method.identify(uq.Record(np.array(units)[:, None] * u, y, rate_hz=100.0))
    print(found.status)
    assert found.status.word == "unknown in part"


def test_neither_is_one_of_a_record_on_disk(rng, tmp_path):
    _, record = of_tones(3, 1, 1.0, rng)
    found = uq.identify.Subspace(order=9).identify(stored(tmp_path, record))
    assert found.status.word in {"unknown in part", "not white", "not converged"}
    _, record = of_tones(30, 1, 1.0, rng)
    assert uq.identify.Subspace(order=9).identify(stored(tmp_path, record)).status.word != "unknown in part"


@pytest.mark.draws(false_alarm=0.05)  # of 200 plants 7 are found with too few modes or one too many, which is said
@pytest.mark.parametrize("units", [1.0, 1e6])
def test_many_tones_tell_a_plant(units, rng):
    plant, record = of_tones(30, 2, units, rng)
    found = uq.identify.Subspace().identify(record)
    missed = off(found.state_space(), plant, INSIDE_HZ).max()
    print(f"order {found.details['order']}, off by {missed:.2f}, {found.status}")
    assert found.status.ok
    assert missed < 0.5


def of_tones(tones, channels, units, rng):
    """Return a plant and a record of it, so many tones of one size at every input, none at two."""
    plant = flexible(channels)
    plant = uq.StateSpace(plant.A, plant.B, units * plant.C, units * plant.D, RATE_HZ)
    f_hz = np.geomspace(12.0, 480.0, tones * channels).reshape(tones, channels).T
    u = np.sin(2 * np.pi * (f_hz[:, :, None] * np.arange(3000) / RATE_HZ + rng.random(f_hz.shape)[:, :, None])).sum(
        axis=1
    )
    y = plant.simulate(u)
    return plant, uq.Record(u, y + 0.01 * y.std() * rng.standard_normal(y.shape), RATE_HZ)
