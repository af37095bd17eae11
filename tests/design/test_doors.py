"""Every verb takes systems of python-control, and refuses what is no system in a sentence."""

import control
import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.design import Lqg, MixedSensitivity, synthesize_hinf
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain

HUGE = StateSpace([[0.5]], [[1e200]], [[1.0]], [[0.0]], 100.0)
DOORS = {
    "hinf_norm": uq.analyse.hinf_norm,
    "h2_norm": uq.analyse.h2_norm,
    "MixedSensitivity": lambda G: MixedSensitivity().design(G),
    "Lqg": lambda G: Lqg().design(G),
    "LeadLag": lambda G: uq.design.LeadLag(gain=-0.1).design(G),
    "synthesize_hinf": lambda G: synthesize_hinf(G, 1, 1),
    "Balanced": lambda G: uq.reduce.Balanced(states=1).reduce(G),
    "best_flat_attenuation": lambda G: uq.limits.best_flat_attenuation(G, band_hz=(1.0, 5.0), peak_db=6.0),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("value", [None, (1, 2), np.eye(2), 1e300, "plant", HUGE], ids=lambda v: type(v).__name__)
def test_what_is_no_system_is_refused_in_a_sentence(door, value):
    with pytest.raises(InputError, match=f"{door}: '"):
        DOORS[door](value)


def test_systems_of_python_control_come_through():
    G = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 100.0)
    theirs = G.to_control()
    assert uq.analyse.hinf_norm(theirs) == uq.analyse.hinf_norm(G)
    assert uq.analyse.hinf_norm(control.tf([2.0], [1.0, 1.0]))[0] == pytest.approx(2.0)
    result = MixedSensitivity().design(theirs)
    assert result.status.ok
    assert result.achieved == MixedSensitivity().design(G).achieved
    P = uq.design.four_block(G, gain([[1.0]], 100.0), gain([[1.0]], 100.0), np.eye(1), np.eye(1))
    assert synthesize_hinf(P.to_control(), 1, 1).achieved == pytest.approx(synthesize_hinf(P, 1, 1).achieved)
