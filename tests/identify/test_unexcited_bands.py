"""A record that excites a part of all frequencies: what the model holds in the others, and what that costs."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.files import LongRecord, LongWriter
from ultraquiet.identify.subspace.fit import Scaled
from ultraquiet.identify.subspace.unexcited import silent_bands, topped_up

RATE_HZ, STOP_HZ = 2000.0, 500.0


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


@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
def test_a_model_of_too_many_states_invents_nothing_where_nothing_was_asked(seed, unit):
    plant = flexible()
    record = recorded(plant, 3000, 0.03, seed)
    scaled = uq.Record(unit * record.inputs, record.outputs / unit, rate_hz=RATE_HZ)
    model = uq.identify.Subspace(order=20, horizon=20).identify(scaled).model
    model = uq.StateSpace(model.A, unit * model.B, unit * model.C, unit**2 * model.D, RATE_HZ)
    inside = off(model, plant, np.geomspace(10.0, 0.98 * STOP_HZ, 60))
    beyond = off(model, plant, np.linspace(1.1 * STOP_HZ, 990.0, 60))
    size = float(np.sqrt(np.mean(beyond**2)))
    print(f"unit {unit:g}: {np.median(inside):.2%} off inside, {size:.2f} times the plant beyond")
    assert np.median(inside) < 0.02
    assert size < 1.0  # no worse than to say nothing; left to the others' needs it is tens and hundreds of times


def test_a_record_on_disk_has_the_same_silent_bands(seed, tmp_path):
    """Of one stretch: the plant beyond the band is not exceeded (unheard, it is a hundred times and more)."""
    plant = flexible()
    record = recorded(plant, 3000, 0.03, seed)
    path = tmp_path / "record.h5"
    with LongWriter(path, record.rate_hz, record.actuators, record.sensors) as file:
        file.append(record.inputs, record.outputs)
    beyond_hz = np.linspace(1.1 * STOP_HZ, 990.0, 60)
    for where, each in (("memory", record), ("disk", LongRecord(path))):
        model = uq.identify.Subspace(order=20, horizon=20).identify(each).state_space()
        inside = np.median(off(model, plant, np.geomspace(10.0, 0.98 * STOP_HZ, 60)))
        beyond = float(np.sqrt(np.mean(off(model, plant, beyond_hz) ** 2)))
        print(f"{where}: {inside:.2%} off inside, {beyond:.2f} times the plant beyond")
        assert inside < 0.02
        assert beyond < 1.0


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
