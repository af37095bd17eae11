"""Laws for plants of many modes that matter alike: too few states lose the loop at once and keep it in small steps."""

import re

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.reduce import ClosedLoopWeighted
from ultraquiet.reduce.candidates import Candidates
from ultraquiet.reduce.certificate import judging_plant
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback

RATE_HZ = 3500.0


def modes_in_all_channels(rng, pairs, channels):
    """Lightly damped modes, evenly over the logarithm of frequency and about as loud, each in every channel."""
    f_hz, zeta = np.exp(rng.uniform(np.log(5.0), np.log(1000.0), pairs)), rng.uniform(0.005, 0.02, pairs)
    poles = np.exp(2 * np.pi * f_hz * (-zeta + 1j * np.sqrt(1 - zeta**2)) / RATE_HZ)
    A = np.zeros((2 * pairs, 2 * pairs))
    for k, p in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    size = np.repeat(np.sqrt(1 - np.abs(poles)), 2)
    B = size[:, None] * rng.standard_normal((2 * pairs, channels))
    C = rng.standard_normal((channels, 2 * pairs)) * size
    return StateSpace(A, B, C, np.zeros((channels, channels)), rate_hz=RATE_HZ)


def designed(rng, pairs, channels):
    plant = modes_in_all_channels(rng, pairs, channels)
    return plant, uq.design.MixedSensitivity().design(plant).controller


@pytest.mark.slow
def test_states_leave_in_steps_where_a_projection_loses_the_loop(rng):
    """Counted over laws cut to 60 % of their states: loops kept by some projection, and by steps."""
    at_once = in_steps = laws = 0
    for _ in range(5):
        plant, law = designed(rng, 14, 5)
        if law is None:
            continue
        tried, few = Candidates(judging_plant(plant, None), law, "perturbation", "peak"), round(0.6 * law.states)
        stepped = tried.in_steps(few)
        laws += 1
        at_once += bool(np.isfinite(tried.projected(few).cost))
        in_steps += bool(np.isfinite(stepped.cost))
        if np.isfinite(stepped.cost):
            assert stepped.system.states == few
            assert feedback(plant, stepped.system).is_stable()
    print(f"of {laws} laws cut to 60 %, {at_once} keep their loop by a projection, {in_steps} in steps")
    assert laws > 2
    assert in_steps >= at_once


@pytest.mark.gate("True")
@pytest.mark.parametrize("bare", [False, True])
def test_too_few_states_say_how_many_are_enough(rng, bare):
    plant, law = designed(rng, 12, 3)
    if bare:  # without the word of its design
        law = StateSpace(law.A, law.B, law.C, law.D, law.rate_hz)
    few = ClosedLoopWeighted(states=8, steps=0).reduce(law, plant)
    enough = few.details["enough"]
    print(few.status)
    assert few.status.word in ("unstable", "loss")
    assert re.search(rf"\b{enough} states keep all that was promised", few.status.sentence)
    kept = ClosedLoopWeighted(states=enough).reduce(law, plant)
    assert kept.status.ok, kept.status
    assert "enough" not in kept.details


@pytest.mark.slow
def test_a_law_of_many_channels_keeps_its_loop_at_three_fifths_of_its_states(rng):
    """The benchmark `many_channels` at three quarters of its size: modes that matter alike, none to be spared."""
    plant, law = designed(rng, 90, 18)
    few = ClosedLoopWeighted(states=108).reduce(law, plant)
    print(few.status)
    assert few.controller.states == 108
    assert feedback(plant, few.controller).is_stable()
    assert few.status.word == "loss"
    enough = ClosedLoopWeighted(states=few.details["enough"]).reduce(law, plant)
    print(enough.status)
    assert enough.status.ok
