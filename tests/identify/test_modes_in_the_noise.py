"""Modes of the plant that a noise model could take for its own: they are the plant's, or the verdict is not ok."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import lfilter
from test_subspace import fit_percent

import ultraquiet as uq
from ultraquiet.linalg.portmanteau import noise_modes

RATE_HZ = 1000.0
CLOSE_HZ = (60.0, 60.6, 150.0)  # two of them closer together than the first steps of a search tell


def sharp(rng, sensors, actuators, units):
    """Three modes of damping 0.002 in a tenth of white noise: the record and what it would be without noise."""
    blocks = []
    for f in CLOSE_HZ:
        p = np.exp(2 * np.pi * f / RATE_HZ * (-0.002 + 1j))
        blocks.append(np.array([[p.real, p.imag], [-p.imag, p.real]]))
    B, C = rng.standard_normal((6, actuators)), rng.standard_normal((sensors, 6))
    plant = uq.StateSpace(block_diag(*blocks), B, C, np.zeros((sensors, actuators)), RATE_HZ)
    clean = plant.simulate(u := rng.standard_normal((actuators, 8000)))
    noise = 0.1 * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    return uq.Record(u * units[0], (clean + noise) * units[1], RATE_HZ), clean * units[1]


@pytest.mark.draws(false_alarm=0.03)  # 5 of 504 are ok without: one of one output's 252, four of three outputs' 252
@pytest.mark.parametrize(("shape", "units"), [((1, 1), (1.0, 1.0)), ((1, 1), (1e6, 1e-9)), ((3, 1), (1e-3, 1e4))])
def test_the_plant_has_its_modes_or_the_verdict_says_so(rng, shape, units):
    record, clean = sharp(rng, *shape, units)
    result = uq.identify.BoxJenkins(order=6).identify(record)
    shown = fit_percent(clean, result.state_space().simulate(record.inputs)).min()
    print(f"{shape}: {shown:.2f} % of what is without noise, {result.status}")
    assert shown > 97.0 or not result.status.ok


@pytest.mark.parametrize("seed_of_both", [835627132, 1018])
def test_two_modes_that_the_noise_took_at_once_come_back(seed_of_both):
    """Of both the noise model held the pair that is 1 % apart, with a white residual: ok at a fit below nothing."""
    record, clean = sharp(np.random.default_rng(seed_of_both), 3, 1, (1.0, 1.0))
    result = uq.identify.BoxJenkins(order=6).identify(record)
    shown = fit_percent(clean, result.state_space().simulate(record.inputs)).min()
    print(f"{shown:.2f} % of what is without noise, {result.status}")
    assert result.status.ok
    assert shown > 97.0


@pytest.mark.draws(false_alarm=1e-3)  # a verdict at the level of a thousandth
@pytest.mark.parametrize("damping", [0.999, 0.995])
def test_a_resonance_of_the_noise_stays_there(rng, damping):
    """No word against a right plant under noise that rings louder than all else that is not the plant's."""
    u, turn = rng.standard_normal(4000), 2 * np.pi * 100.0 / RATE_HZ
    y = lfilter([0.0, 1.0], [1.0, -1.2, 0.8], u)
    ringing = lfilter([1.0], [1.0, -2 * damping * np.cos(turn), damping**2], rng.standard_normal(u.size))
    y = y + 0.3 * y.std() * (ringing / ringing.std() + 0.4 * rng.standard_normal(u.size))
    result = uq.identify.BoxJenkins(order=2).identify(uq.Record(u[None], y[None], RATE_HZ))
    model = result.model.rows[0][0]
    loudest = noise_modes(model.c, model.d)[0]
    print(f"{result.status}; the noise rings at {np.angle(loudest) * RATE_HZ / (2 * np.pi):.1f} Hz of 100")
    assert result.status.ok
    assert np.angle(loudest) == pytest.approx(turn, rel=0.05)
    assert np.roots(model.f[0]) == pytest.approx(np.roots([1.0, -1.2, 0.8]), abs=0.05)
