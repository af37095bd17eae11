"""What a law promised its loop, before and after a reduction: lost decibels are said, the order follows from them."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.analyse import disk_margin, peak_sensitivity
from ultraquiet.design import LoopShaping
from ultraquiet.reduce import Balanced, ClosedLoopWeighted, Promise, held
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append

RATE_HZ, BAND_HZ, TONES_HZ = 1000.0, (10.0, 60.0), (20.0, 45.0)


def isolator(gains, corners_hz, turn):
    """Geophones above their corner with one sample of delay, as loud in each of `turn`'s directions as its gain."""
    n = len(gains)
    w = 2 * np.pi * np.asarray(corners_hz)
    A = block_diag(*[[[0.0, 1.0], [-v * v, -0.4 * v]] for v in w])
    B, C = np.zeros((2 * n, n)), np.zeros((n, 2 * n))
    B[1::2], C[:, ::2], C[:, 1::2] = (
        np.eye(n),
        np.diag(-np.asarray(gains) * w**2),
        np.diag(-0.4 * np.asarray(gains) * w),
    )
    A, B, C, D, _ = cont2discrete((A, B, C, np.diag(gains)), 1 / RATE_HZ)
    A = np.block([[A, B], [np.zeros((n, 3 * n))]])
    B = np.vstack([np.zeros((2 * n, n)), np.eye(n)])
    return StateSpace(A, B @ turn.T, turn @ np.hstack([C, D]), np.zeros((n, n)), RATE_HZ)


@pytest.fixture(scope="module")
def tones():
    """A plant whose three directions differ by 6 dB, and one scalar law with two tones on each of its channels."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    plant = isolator((1.0, 1.5, 2.0), (6.0, 6.5, 7.0), turn)
    middle = isolator((1.5,), (6.5,), np.eye(1))
    design = uq.design.BandAttenuation(band_hz=BAND_HZ, tones_hz=TONES_HZ, tone_height=40.0).design(middle)
    one = design.controller
    law = append(one, one, one)
    stated = Provenance("BandAttenuation", {"band_hz": BAND_HZ, "tones_hz": TONES_HZ}, parents=(plant.hash,))
    return plant, StateSpace(law.A, law.B, law.C, law.D, RATE_HZ, provenance=stated), design.weights


def reduction_db(plant, law, f_hz):
    """Reduction of the worst direction at frequencies, from the two responses alone."""
    G, K = (each.frequency_response(np.asarray(f_hz)).transpose(2, 0, 1) for each in (plant, law))
    return -20 * np.log10(np.linalg.norm(np.linalg.inv(np.eye(len(plant.D)) - G @ K), 2, axis=(1, 2)))


def control_gain(plant, law, f_hz):
    """Largest singular value of K S at frequencies."""
    G, K = (each.frequency_response(f_hz).transpose(2, 0, 1) for each in (plant, law))
    return np.linalg.norm(K @ np.linalg.inv(np.eye(len(plant.D)) - G @ K), 2, axis=(1, 2))


def test_a_reduction_that_costs_the_tones_decibels_says_so(tones):
    plant, law, weights = tones
    full, lines = reduction_db(plant, law, TONES_HZ), np.linspace(*BAND_HZ, 2000)
    lost = {}
    for states in (law.states, 36, 24):
        small = ClosedLoopWeighted(states=states).reduce(law, plant, weights)
        left = reduction_db(plant, small.controller, TONES_HZ)
        lost[states] = float((full - left).max())
        print(f"{states} states, tones {np.round(full, 1)} -> {np.round(left, 1)} dB; {small.status}")
        assert list(small.before.tones_db.values()) == pytest.approx(full, abs=1e-6)
        assert list(small.after.tones_db.values()) == pytest.approx(left, abs=1e-6)
        assert small.after.band_db == pytest.approx(reduction_db(plant, small.controller, lines).min(), abs=0.05)
        assert small.after.peak_db == pytest.approx(peak_sensitivity(plant, small.controller)[0])
        gain = np.max(control_gain(plant, small.controller, np.geomspace(0.01, RATE_HZ / 2, 4000)))
        assert 10 ** (small.after.control_db / 20) == pytest.approx(gain, rel=0.02)
        for end in ("input", "output"):
            assert small.after.disk[end] == pytest.approx(disk_margin(plant, small.controller, end))
        for k, tone in enumerate(TONES_HZ):
            fall = f"at {tone:g} Hz falls from {full[k]:.1f} to {left[k]:.1f} dB"
            told = any(fall in phrase for phrase in small.broken)
            assert told == (full[k] - left[k] > 0.5)
        assert small.status.word == ("loss" if small.broken else "ok")
        assert all(phrase in small.status.sentence for phrase in small.broken)
    assert lost[law.states] == pytest.approx(0.0, abs=1e-6)
    assert lost[24] > 2.7  # what this is about: stable, and decibels poorer


def test_without_a_number_of_states_the_fewest_that_keep_the_promise_are_taken(tones):
    plant, law, weights = tones
    chosen = ClosedLoopWeighted().reduce(law, plant, weights)
    n = chosen.controller.states
    print(f"{law.states} -> {n} states: {chosen.status}")
    assert chosen.status.ok
    assert n < law.states
    assert not chosen.broken
    fewer = ClosedLoopWeighted(states=n - 3, steps=0).reduce(law, plant, weights)
    assert fewer.status.word == "loss"


@pytest.mark.parametrize("method", [ClosedLoopWeighted(states=2), Balanced(states=3)])
def test_what_a_law_did_is_to_be_kept_wherever_it_is_from(method):
    """As designed, made by hand of the same numbers, and with a plant whose last digits are others."""
    plant = two_by_two()
    law = LoopShaping().design(plant).controller
    by_hand = StateSpace(law.A, law.B, law.C, law.D, law.rate_hz)
    near = StateSpace(plant.A, plant.B * (1 + 1e-7), plant.C, plant.D, plant.rate_hz)
    for which, at in ((law, plant), (by_hand, plant), (law, near)):
        small = method.reduce(which, at)
        print(small.status)
        assert small.status.word == "loss"
        assert small.after.rms_db < small.before.rms_db - 3.0
    kept = ClosedLoopWeighted().reduce(by_hand, plant)
    print(kept.status)
    assert kept.status.ok
    assert kept.controller.states < law.states


def two_by_two():
    """Two lightly damped modes, each heard at both sensors and moved from both actuators, at 200 Hz."""
    A, B, C = np.zeros((4, 4)), np.zeros((4, 2)), np.zeros((2, 4))
    for k, (f_hz, b, c) in enumerate(((7.0, [1.0, 0.4], [1.0, 0.3]), (19.0, [-0.5, 1.0], [-0.2, 1.0]))):
        p = np.exp(2 * np.pi * f_hz / 200.0 * (-0.01 + 1j))
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
        B[2 * k + 1], C[:, 2 * k] = 0.1 * np.array(b), c
    return StateSpace(A, B, C, np.zeros((2, 2)), 200.0)


@pytest.mark.slow
def test_a_coarser_promise_takes_fewer_states(tones):
    plant, law, weights = tones
    fine, coarse = (ClosedLoopWeighted(loss_db=db).reduce(law, plant, weights) for db in (0.5, 6.0))
    print(f"{fine.controller.states} states for 0.5 dB, {coarse.controller.states} for 6 dB")
    assert coarse.controller.states < fine.controller.states
    assert not coarse.broken


@pytest.mark.slow
def test_every_method_of_reduction_is_judged_by_the_same_promise(tones):
    plant, law, weights = tones
    small = Balanced(states=24).reduce(law, plant, weights)
    assert small.status.word in ("loss", "unstable")
    nothing_stated = StateSpace(law.A, law.B, law.C, law.D, RATE_HZ)
    again = Balanced(states=24).reduce(nothing_stated, plant, weights)
    assert again.status.word in ("loss", "unstable")
    judged = held(again, nothing_stated, plant, Promise(BAND_HZ, TONES_HZ))
    assert judged.broken == small.broken


@pytest.mark.parametrize("rate_hz", [None, 1000.0])
def test_what_is_promised_has_no_unit(rate_hz):
    """A wide plant, 2 x 3, in continuous and in discrete time: the same figures in any unit of its commands."""
    poles = np.array([-60.0, -90.0, -300.0])
    A = np.diag(poles if rate_hz is None else np.exp(poles / rate_hz))
    B, C = np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.3], [0.5, 0.0, 1.0]]), np.array([[9.0, 1.0, 0.0], [0.0, 9.0, 4.0]])
    drive = 300.0 * np.ones((3, 2)) if rate_hz is None else 1e-2 * np.ones((3, 2))
    found = []
    for unit in (1.0, 1e9, 1e-9):
        plant = StateSpace(A, unit * B, C, np.zeros((2, 3)), rate_hz)
        law = StateSpace(0.9 * A, drive, np.diag([-0.3, -0.2, -0.1]) / unit, np.zeros((3, 2)), rate_hz)
        small = held(Balanced(states=1).reduce(law, plant), law, plant, Promise(band_hz=(1.0, 5.0), tones_hz=(2.0,)))
        found.append([(d.peak_db, d.band_db, d.tones_db[2.0], *d.disk.values()) for d in (small.before, small.after)])
    print(np.array(found).round(3))
    assert np.all(np.isfinite(found))
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=1e-6, atol=1e-9)


def test_settings_that_promise_nothing_are_refused():
    for settings in ({"loss_db": 0.0}, {"band_hz": (60.0, 10.0)}, {"tones_hz": (-1.0,)}):
        with pytest.raises(InputError, match="ClosedLoopWeighted"):
            ClosedLoopWeighted(**settings)
