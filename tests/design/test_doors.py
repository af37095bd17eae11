"""Every verb takes systems of python-control, and refuses what is no system in a sentence."""

import control
import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.design import Lqg, MixedSensitivity, synthesize_hinf
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain

PLANT = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 100.0)
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
    "waterbed_peak": lambda G: uq.limits.waterbed_peak(G, (10.0, 20.0), 20.0),
    "PeakBounded": lambda G: uq.design.PeakBounded().design(G),
    "poles": uq.analyse.poles,
    "zeros": uq.analyse.zeros,
    "peak_sensitivity": lambda G: uq.analyse.peak_sensitivity(PLANT, G),
    "loop_margins": lambda G: uq.analyse.loop_margins(G, PLANT),
    "disk_margin": lambda G: uq.analyse.disk_margin(PLANT, G),
    "disk_margins": lambda G: uq.analyse.disk_margins(G, PLANT),
    "gang_of_four": lambda G: uq.analyse.gang_of_four(PLANT, G),
    "gang_of_six": lambda G: uq.analyse.gang_of_six(G, PLANT),
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


NO_SYSTEMS = [2.0, "output", [1.0], True, np.eye(2)]
NO_NUMBERS = ["abc", (1,), [1, 2, 3], 3 + 4j, np.complex128(3 + 4j), float("nan")]
NO_TONES = [None, float("nan"), "abc", (20.0, None), 3 + 4j, [[1.0, 2.0], [3.0]]]
AGAINST_TONES = ("BandAttenuation", "LoopShaping", "MixedSensitivity", "PeakBounded", "Resonators", "YoulaKucera")
MISTAKES = [
    *(("Lqg", name, value) for name in ("output_weight", "input_weight") for value in NO_SYSTEMS),
    *(("Lqg", "control_hz", value) for value in (*NO_NUMBERS, 0, -1)),
    *(("Modal", "zeta", value) for value in ("abc", (None,), float("nan"), 3 + 4j, np.eye(2))),
    *(("BandAttenuation", "peak_db", value) for value in NO_NUMBERS),
    *((method, "tones_hz", value) for method in AGAINST_TONES for value in NO_TONES),
    ("Lqg", "estimator", np.eye(2)),
    ("MixedSensitivity", "form", np.eye(2)),
    ("BandAttenuation", "structure", np.eye(2)),
    ("LoopShaping", "pre", 3 + 4j),
    ("MixedSensitivity", "performance", (1.0, 3 + 4j, 2.0)),
]


@pytest.mark.parametrize(("method", "name", "value"), MISTAKES)
def test_a_setting_of_another_kind_is_refused_by_method_and_name(method, name, value):
    with pytest.raises(InputError, match=rf"^{method}: .*'{name}'") as caught:
        getattr(uq.design, method)(**{name: value}).design(PLANT)
    assert "\n" not in str(caught.value)


def test_an_array_is_no_law_to_put_resonators_around():
    with pytest.raises(InputError, match="Resonators: 'around' must be a StateSpace or the name of a method"):
        uq.design.Resonators(tones_hz=(15.0,), around=np.eye(2)).design(PLANT)


def test_one_tone_by_itself_is_taken_as_one():
    assert uq.design.BandAttenuation(tones_hz=20.0) == uq.design.BandAttenuation(tones_hz=(20.0,))
    assert uq.design.Resonators(tones_hz=20.0).design(PLANT).status.ok


def test_what_a_method_cannot_do_is_said_of_the_method_and_its_setting():
    deaf = StateSpace([[0.9]], [[0.0]], [[1.0]], [[0.0]], 1000.0)
    with pytest.raises(InputError, match="YoulaKucera: the plant has no gain at 15 Hz"):
        uq.design.YoulaKucera(tones_hz=(15.0,), limit=1.0).design(deaf)
    assert "the plant has no gain" in uq.design.YoulaKucera(basis="fir", limit=1.0).design(deaf).status.sentence
    falling = StateSpace([[1.05]], [[0.1]], [[1.0]], [[0.0]], 100.0)
    assert "only complex pairs" in uq.design.Modal().design(falling).status.sentence
    with pytest.raises(InputError, match=r"a low-pass corner of 2 Hz \('leak_hz'\) lies at or above Nyquist, 1 Hz"):
        uq.design.Skyhook().design(StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 2.0))
