"""Lightly damped modes far below the sampling rate, in noise: found whatever the method, or the verdict is not ok."""

import numpy as np
import pytest
from scipy.signal import lfilter
from test_missing_modes import modal, noisy
from test_subspace import fit_percent, modes_found
from truths import modal_truth

import ultraquiet as uq
from ultraquiet.identify.subspace import fit
from ultraquiet.identify.subspace.one_step import other_starts

METHODS = {
    "subspace": lambda n: uq.identify.Subspace(order=n, refine=True),
    "predictor": lambda n: uq.identify.PredictorSubspace(order=n),
}
RATE_HZ = 3500.0
SHAPES = [((1, 1), 4, (1.0, 1.0)), ((4, 3), 8, (1e3, 1e-6)), ((3, 5), 8, (1e-6, 1e9))]


def modes_carried(plant, record, clean):
    """How many modes a record tells from its noise: without each the squares rise by log n for each of its numbers."""
    ny, nu = plant.D.shape
    noise = np.mean((record.outputs - clean) ** 2, axis=1)
    count = 0
    for k in range(plant.states // 2):
        rows = slice(2 * k, 2 * k + 2)
        alone = uq.StateSpace(plant.A[rows, rows], plant.B[rows], plant.C[:, rows], plant.D, plant.rate_hz)
        squares = np.sum(alone.simulate(record.inputs) ** 2, axis=1)
        count += np.sum(squares / noise) > 2 * (ny + nu) * np.log(record.samples)
    return int(count)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("name", "order"), [("subspace", None), ("predictor", None), ("predictor", 30)])
def test_fifteen_modes_at_ten_decibels_in_nineteen_of_twenty(name, order):
    """6 x 6, 8 to 350 Hz at 3.5 kHz, 8000 samples, draws of their own."""
    found, told = 0, 0
    for k in range(20):
        plant, record, clean = modal_truth(np.random.default_rng([3, k]), samples=8000, snr_db=10.0)
        result = METHODS[name](order).identify(record)
        near = modes_found(plant, result.model)
        share = fit_percent(clean, result.state_space().simulate(record.inputs))
        found, told = found + (near == 15), told + (near < 15 and not result.status.ok)
        print(
            f"draw {k}: {near} of 15 modes, order {result.details['order']}, fit {share.min():.1f} %, {result.status}"
        )
    print(f"{name}, order {order or 'auto'}: all modes in {found} of 20, told in {told} of the others")
    assert found >= 19
    assert found + told == 20


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("name", METHODS)
def test_other_channels_and_units(name, given):
    """All modes that the record tells from noise, in other units; faint ones may be left out."""
    missed = []
    for shape, modes, units in SHAPES:
        for k in range(8):
            rng = np.random.default_rng([13, k])
            plant, record, clean = modal_truth(rng, 8000, 10.0, shape, modes, units)
            result = METHODS[name](2 * modes if given else None).identify(record)
            near, least = modes_found(plant, result.model), modes_carried(plant, record, clean)
            if near < least and result.status.ok:
                missed.append(f"{shape}, draw {k}: {near} of {least} modes that show, of {modes}, {result.status}")
    print(f"{name}, {'order given' if given else 'automatic'}: missed in {len(missed)} of 24", *missed, sep="\n")
    assert len(missed) <= 1


# A mode just above what its record tells is missing in 3 of 200 plants, and no test of the verdict hears it.
@pytest.mark.gate("units1")
@pytest.mark.draws(false_alarm=0.04)
@pytest.mark.parametrize("units", [(1.0, 1.0), (1e6, 1e-9)])
def test_a_predictor_finds_modes_longer_than_any_past(rng, units):
    """White noise at the outputs: the predictor's memory is the plant's, thousands of samples here."""
    plant, record, clean = modal_truth(rng, 4000, 10.0, (3, 2), 4, units)
    result = uq.identify.PredictorSubspace(order=8).identify(record)
    share = fit_percent(clean, result.state_space().simulate(record.inputs))
    print(f"\n{modes_found(plant, result.model)} of 4 modes, fit {share.min():.1f} %, {result.status}")
    assert modes_found(plant, result.model) >= modes_carried(plant, record, clean) or not result.status.ok
    assert share.min() > 94.0


def coloured(rng, ny, n):
    """Return noise 0.3 e(t - 1) + e(t) with a pole at 0.8 in each channel, and its innovations."""
    e = rng.standard_normal((ny, n))
    return np.asarray(lfilter([1.0, 0.3], [1.0, -0.8], e, axis=1)), e


def test_noise_has_states_of_its_own(rng):
    noise, e = coloured(rng, 2, 6000)
    model = other_starts.noise_model(noise)
    assert model is not None
    left = model.errors(np.zeros((0, noise.shape[1])), noise)
    print(f"\n{len(model.A)} states of 2, error over the innovations {np.var(left) / np.var(e):.3f}")
    assert len(model.A) == 2
    assert np.var(left) == pytest.approx(np.var(e), rel=0.02)


def test_white_noise_has_none(rng):
    assert other_starts.noise_model(rng.standard_normal((3, 4000))) is None


def test_a_plant_beside_its_noise_is_both(rng):
    plant, record, _ = modal_truth(rng, 3000, 10.0, (2, 3), 3)
    at_rest = np.zeros((6, 2)), np.zeros(6), np.zeros(2)
    system = fit.System(plant.A, plant.B, plant.C, plant.D, *at_rest)
    noise, e = coloured(rng, 2, 3000)
    pole = 0.8 * np.eye(2)
    colour = fit.System(pole, np.zeros((2, 0)), np.eye(2), np.zeros((2, 0)), 1.1 * np.eye(2), np.zeros(2), np.zeros(2))
    joined = other_starts.beside(system, colour)
    assert joined.errors(record.inputs, plant.simulate(record.inputs) + noise) == pytest.approx(e, abs=1e-9)


@pytest.mark.slow
def test_slow_modes_in_coloured_noise(rng):
    plant = modal(rng, [12.0, 150.0, 400.0], 0.02, 3, 2)
    record, clean = noisy(rng, plant, 5000, 40.0)
    noise = coloured(rng, 3, 5000)[0]
    size = 10 ** (-10 / 20) * clean.std(axis=1, keepdims=True) / noise.std(axis=1, keepdims=True)
    record = uq.Record(record.inputs, clean + size * noise, RATE_HZ)
    result = uq.identify.PredictorSubspace(order=9).identify(record)
    ahead = 100 * result.loss / np.var(size * noise, axis=1)
    print(f"\n{modes_found(plant, result.model)} of 3 modes, error {ahead.round(1)} % of the noise, {result.status}")
    assert modes_found(plant, result.model) == 3 or not result.status.ok
    assert np.all(ahead < 30.0)  # of the innovations: 1 / (1 + 1.1^2 / (1 - 0.64)) of the noise is 23 %
