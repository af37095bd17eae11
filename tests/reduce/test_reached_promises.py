"""Reductions of laws for more sensors than actuators, and of laws that promise an RMS: what is lost is told."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.reduce import Balanced, ClosedLoopWeighted, Promise, held
from ultraquiet.values import StateSpace

RATE_HZ, BAND_HZ = 1000.0, (5.0, 40.0)


def struts(ny, nu, modes_hz=(15.0, 35.0, 80.0), seed=1):
    """Return modes damped by 1 %, seen by `ny` sensors and moved by `nu` actuators."""
    rng, n = np.random.default_rng(seed), 2 * len(modes_hz)
    A, B, C = np.zeros((n, n)), np.zeros((n, nu)), np.zeros((ny, n))
    for k, f in enumerate(modes_hz):
        z = np.exp(2 * np.pi * f / RATE_HZ * (-0.01 + 1j))
        part = slice(2 * k, 2 * k + 2)
        A[part, part] = [[z.real, z.imag], [-z.imag, z.real]]
        B[part], C[:, part] = np.sqrt(1 - abs(z)) * rng.standard_normal((2, nu)), rng.standard_normal((ny, 2))
    return StateSpace(A, B, C, np.zeros((ny, nu)), RATE_HZ)


def in_reach(plant, law, f_hz):
    """Return by how much the loudest direction that actuators reach gets quieter, dB, over frequencies."""
    G, K = (each.frequency_response(f_hz).transpose(2, 0, 1) for each in (plant, law))
    S = np.linalg.inv(np.eye(len(plant.D)) - G @ K)
    basis = np.linalg.svd(G, full_matrices=False)[0]
    return -20 * np.log10(np.linalg.norm(S @ basis, 2, axis=(1, 2)).max())


def rms_below(plant, law, f_hz):
    """Return by how much the RMS of S G is below that of G over a fine grid, dB, all channels alike."""
    G, K = (each.frequency_response(f_hz).transpose(2, 0, 1) for each in (plant, law))
    closed = np.linalg.solve(np.eye(len(plant.D)) - G @ K, G)
    return -10 * np.log10(np.sum(np.abs(closed) ** 2) / np.sum(np.abs(G) ** 2))


@pytest.mark.parametrize("shape", [(4, 3), (3, 1)])
def test_directions_are_those_that_actuators_reach(shape):
    plant = struts(*shape)
    law = uq.design.MixedSensitivity(band_hz=BAND_HZ).design(plant).controller
    before = held(Balanced(states=law.states).reduce(law, plant), law, plant, Promise(BAND_HZ)).before
    truth = in_reach(plant, law, np.geomspace(*BAND_HZ, 2000))
    print(f"{before.band_db:.2f} dB over the band; on a fine grid {truth:.2f}")
    assert before.band_db == pytest.approx(truth, abs=0.1)
    assert not np.isclose(before.band_db, 0.0, atol=1e-6)  # what no actuator reaches stays as it is, 0 dB


@pytest.mark.slow
def test_a_lost_rms_is_told():
    plant = struts(4, 3, np.geomspace(8.0, 120.0, 6))
    result = uq.design.Lqg().design(plant)
    law, fine = result.controller, np.linspace(1.0, 400.0, 40000)
    assert result.details["attenuation_rms_db"] > 6
    lost = {}
    for states in (5, 6, 9):
        small = Balanced(states=states).reduce(law, plant)
        if small.after is None or small.status.word == "unstable":
            continue
        lost[states] = rms_below(plant, law, fine) - rms_below(plant, small.controller, fine)
        told = small.before.rms_db - small.after.rms_db
        print(f"{states} states: {lost[states]:.1f} dB of the RMS lost, {told:.1f} said; {small.status}")
        assert told == pytest.approx(lost[states], abs=2.0)  # in units of its own, over its own band
        assert ("RMS" in small.status.sentence) == (told > 0.5)
    assert max(lost.values()) > 1.5


def test_the_fewest_states_keep_the_rms_too():
    plant = struts(4, 3)
    law = uq.design.Lqg().design(plant).controller
    small = ClosedLoopWeighted().reduce(law, plant)
    assert small.status.ok
    assert small.after.rms_db > small.before.rms_db - 0.5
