"""The units of a plant's own where some of its responses are zero: a dead channel, axes that do not see each other."""

import numpy as np
import pytest

from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design import BandAttenuation, LoopShaping, Lqg, MixedSensitivity
from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace

RATE_HZ = 1000.0
FURTHEST = 1e3  # between scales of channels whose gains lie within ten of each other
LOUDEST_DB = 25.0


def plant_of(*modes, damping=0.02):
    """Return a plant of modes, each a frequency in Hz, what every output hears of it and how every input moves it."""
    A, B, C = np.zeros((2 * len(modes), 2 * len(modes))), [], []
    for k, (hz, outputs, inputs) in enumerate(modes):
        pole = np.exp(2 * np.pi * hz / RATE_HZ * (-damping + 1j))
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, -pole.imag], [pole.imag, pole.real]]
        B += [np.zeros(len(inputs)), np.array(inputs)]
        C += [np.array(outputs), np.zeros(len(outputs))]
    return StateSpace(A, np.array(B), np.array(C).T, np.zeros((len(C[0]), len(B[0]))), RATE_HZ)


PLANTS = {
    "dead sensor": plant_of((20.0, [1, 2, 0], [3, 1]), (60.0, [1, -1, 0], [-2, 1])),
    "four dead sensors": plant_of((20.0, [1, 2, 0, 0, 0, 0], [3, 1]), (60.0, [1, -1, 0, 0, 0, 0], [-2, 1])),
    "three dead actuators": plant_of((20.0, [1, 2], [3, 1, 0, 0, 0]), (60.0, [1, -1], [-2, 1, 0, 0, 0])),
    "two sensors on one axis": plant_of((20.0, [1, 3, 0], [1, 0]), (60.0, [0, 0, 1], [0, 1])),
}


@pytest.mark.parametrize("name", PLANTS)
def test_scales_of_alike_channels_stay_near_each_other_where_responses_are_zero(name):
    even = even_plant(PLANTS[name])
    both = np.concatenate([even.outputs, even.inputs])
    assert both.max() < FURTHEST * both.min(), (even.outputs, even.inputs)


@pytest.mark.parametrize("design", [Lqg, MixedSensitivity, BandAttenuation, LoopShaping])
@pytest.mark.parametrize("name", PLANTS)
def test_no_default_listens_to_what_is_dead(name, design):
    """A law of scales that had drifted apart had rounding errors in the place of zeros, and amplified by 400 dB."""
    plant = PLANTS[name]
    result = design().design(plant)
    assert result.status.ok, result.status
    assert result.peak_sensitivity_db < LOUDEST_DB
    law = result.controller
    assert law is not None
    K = np.abs(law.D + law.C @ np.linalg.solve(np.exp(0.1j) * np.eye(law.states) - law.A, law.B))
    heard, moved = plant.C.any(axis=1), plant.B.any(axis=0)
    assert K[:, ~heard].max(initial=0.0) < 1e-9 * K.max()
    assert K[~moved].max(initial=0.0) < 1e-9 * K.max()


def axes(coupling, wide):
    """Two axes of one mode each, 1 and 2 channels at one end: `coupling` of each is heard on the other."""
    act = np.array([[1.0, coupling], [coupling, 1.0]])
    sense = np.array([[1.0, coupling], [0.9, -coupling], [coupling, 1.0]])
    A = np.zeros((4, 4))
    for k, f in enumerate((20.0, 33.0)):
        pole = np.exp((-0.02 + 1j) * 2 * np.pi * f / 1000.0)
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
    B, C = np.zeros((4, 2)), np.zeros((3, 4))
    B[1::2], C[:, ::2] = 0.1 * act, sense
    matrices = (A.T, C.T, B.T) if wide else (A, B, C)
    return StateSpace(*matrices, np.zeros((2, 3) if wide else (3, 2)), 1000.0)


def in_units(plant, y, u):
    return StateSpace(plant.A, plant.B * u, plant.C * y[:, None], plant.D * u * y[:, None], plant.rate_hz)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("coupling", [1e-6, 1e-4, 1e-2])
def test_couplings_stay_small_in_even_units_whatever_the_units(rng, coupling, wide):
    """Equal sums of rows and columns would make a coupling as large as the axes, scales apart by its inverse."""
    plant = axes(coupling, wide)
    G = np.abs(even_plant(plant).plant.frequency_response(np.array([20.0, 33.0]))).max(axis=2)
    strongest = np.sort(G.ravel())[-3:]
    print(G.round(7))
    assert strongest.min() > 0.5 * strongest.max()
    assert np.sort(G.ravel())[:3].max() < 5 * coupling * strongest.max()
    y, u = (10.0 ** rng.uniform(-9, 9, count) for count in plant.D.shape)
    other = np.abs(even_plant(in_units(plant, y, u)).plant.frequency_response(np.array([20.0, 33.0]))).max(axis=2)
    assert np.allclose(other, G, rtol=1e-9)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("design", [Lqg, MixedSensitivity, BandAttenuation])
@pytest.mark.parametrize("coupling", [1e-4, 1e-2])
def test_no_default_relies_on_a_coupling(design, coupling, wide):
    """Were ok at 64 dB of peak of S, and fell to an error of 1e-4 in one entry of G: now of 2 % in all of them."""
    plant = axes(coupling, wide)
    result = design().design(plant)
    print(
        f"{result.status.word}, {result.peak_sensitivity_db:.1f} dB of peak, {result.details['attenuation_rms_db']:.1f}"
    )
    assert result.status.ok
    assert result.peak_sensitivity_db < 10
    assert result.details["attenuation_rms_db"] > 15
    law = result.controller
    f = np.geomspace(1.0, 499.0, 2000)
    G, K = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (plant, law))
    # (I - (G + dG) K) is singular for no dG of that size: K S, whatever stands between them, is less than its inverse
    KS = K @ np.linalg.inv(np.eye(G.shape[1]) - G @ K)
    size = 0.02 * np.abs(G).max(axis=(1, 2))
    assert (np.linalg.norm(KS, 2, axis=(1, 2)) * size).max() < 1


def moving(damping, drift, rate_hz):
    """Return a mode at 5 Hz and an integrator beside it, `drift` of the mode in size, that moves a state unheard."""
    w = 2 * np.pi * 5.0
    A = np.zeros((4, 4))
    A[:2, :2] = [[-damping * w, w], [-w, -damping * w]]
    A[2, 3] = w
    M = A, np.array([[0.0], [w], [0.0], [w]]), np.array([[1.0, 0.0, 0.0, drift]]), np.zeros((1, 1))
    return StateSpace(*(discretize.zero_order_hold(*M, 1 / rate_hz) if rate_hz else M), rate_hz)


@pytest.mark.parametrize("drift", [0.1, 100.0])
@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_a_plants_own_band_is_the_same_at_any_rate_beside_a_pole_on_the_boundary(damping, drift):
    """One bench of 4.9 to 5.1 Hz, sampled at 100 Hz to 100 kHz, was told bands of 0.0005-5.8 to 0.5-316 Hz."""
    bands = [even_plant(moving(damping, drift, rate_hz)).band_hz for rate_hz in (None, 100.0, 1e3, 1e4, 1e5)]
    print(bands)
    # the edges are lines of the grid
    assert np.allclose(bands, bands[0], rtol=0.05)


def test_an_integrator_that_is_hardly_heard_leaves_the_band_of_a_mode_as_it_is():
    plants = [moving(1e-3, 0.1, 1000.0)]
    plants.append(StateSpace(plants[0].A[:2, :2], plants[0].B[:2], plants[0].C[:, :2], plants[0].D, 1000.0))
    assert np.allclose(*(even_plant(plant).band_hz for plant in plants), rtol=2e-3)
