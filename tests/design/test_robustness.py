"""The verdict on a design: ok needs a stated disk margin at both ends, less is fragile and says where."""

import re

import numpy as np
import pytest
from ordinary_plants import ordinary

from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import methods
from ultraquiet.analyse import disk_margin, disk_ranges, peak_sensitivity
from ultraquiet.design import BandAttenuation, Lqg, MixedSensitivity
from ultraquiet.design.loop_analysis import analyse_loop
from ultraquiet.testing import problems
from ultraquiet.values import Channel, StateSpace

RATE = 2000.0
DRAWS = 20  # at most, until a plant shows what a test is about
RESONANT = StateSpace(
    [[0.98, 0.19], [-0.19, 0.98]], [[0.1], [0.0]], [[1.0, 0.3]], [[0.0]], RATE, ["coil"], ["geophone"]
)
CHEAP = {"control_weight": 1e-10, "sensor_noise": 1e-8, "disturbance": 1.0, "disturbance_at": "input", "band_hz": None}


def crossed(plant):
    """Return a plant of two channels that answers 10 to 1 in its directions, its actuators and sensors named."""
    turn = np.array([[1.0, 0.9], [0.9, 1.0]])
    A = np.kron(np.eye(2), plant.A)
    return StateSpace(
        A,
        np.kron(np.eye(2), plant.B),
        np.kron(turn, plant.C),
        np.zeros((2, 2)),
        RATE,
        ["left", "right"],
        ["top", "side"],
    )


def test_a_stable_loop_with_less_than_the_default_margin_is_fragile_and_keeps_its_controller():
    plant = crossed(RESONANT)
    result = Lqg(**CHEAP, disk_margin=1.2).design(plant)
    assert result.status.word == "fragile"
    assert result.controller is not None
    assert not result.status.ok
    ends = {side: disk_margin(plant, result.controller, side) for side in ("input", "output")}
    weaker = min(ends, key=ends.get)
    assert f"at the plant's {weaker}" in result.status.sentence
    change = result.margins[weaker].least_change
    wire = (plant.actuators if weaker == "input" else plant.sensors)[change.channel].name
    assert f"{'actuator' if weaker == 'input' else 'sensor'} '{wire}'" in result.status.sentence
    assert f"{20 * np.log10(disk_ranges(ends[weaker])[1]):.2g} dB" in result.status.sentence
    assert "1.2 is asked" in result.status.sentence


@pytest.mark.parametrize("asked", [0.0, 0.1, 0.5, 1.0, 2.0])
def test_the_word_follows_the_setting(asked):
    result = Lqg(**CHEAP, disk_margin=asked).design(RESONANT)
    kept = min(result.margins[side].disk_all for side in ("input", "output"))
    assert result.status.word == ("ok" if kept >= asked else "fragile")
    assert (
        f"{result.margins['input'].disk_all:.2g} at the plant's input" in result.status.sentence or not result.status.ok
    )


@pytest.mark.parametrize("name", sorted(methods("design")))
def test_every_design_takes_the_margin_and_refuses_one_that_is_none(name):
    method = methods("design")[name]
    assert method().disk_margin == 0.2
    assert method(disk_margin=0.3).disk_margin == 0.3
    with pytest.raises(InputError, match="disk_margin"):
        method(disk_margin=-0.1)


def test_a_law_that_is_unstable_by_itself_is_said_to_be():
    plant = StateSpace([[0.9, 1.0], [0.0, 1.05]], [[0.0], [1.0]], [[1.0, -0.2]], [[0.0]], RATE)
    numbers = {"control_weight": 1e-3, "sensor_noise": 1e-3, "disturbance": 1.0, "disturbance_at": "input"}
    result = Lqg(**numbers, disk_margin=0.0).design(plant)
    assert result.status.ok
    own = "unstable by itself" in result.status.sentence
    assert own == (not result.controller.is_stable())
    assert own


def largest_over(plant, law, band_hz):
    """Return the largest singular value of S U over the band in dB, and what of each sensor G does not reach."""
    f = np.unique(np.concatenate([np.geomspace(*band_hz, 4000), np.linspace(*band_hz, 4000)]))
    G, K = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (plant, law))
    S = np.linalg.inv(np.eye(G.shape[1]) - G @ K)
    U = np.linalg.qr(G)[0] if G.shape[1] > G.shape[2] else np.eye(G.shape[1])
    return 20 * np.log10(np.linalg.norm(S @ U, 2, axis=(1, 2)).max()), 1 - (np.abs(U) ** 2).sum(axis=2)


def in_millimetres(plant):
    """Return the plant with sensors that share a unit: their readings are then compared as they are."""
    sensors = [Channel(c.name, "mm") for c in plant.sensors]
    return StateSpace(plant.A, plant.B, plant.C, plant.D, plant.rate_hz, plant.actuators, sensors)


@pytest.mark.gate("Lqg", "MixedSensitivity")
@pytest.mark.parametrize("design", [Lqg, MixedSensitivity, BandAttenuation])
def test_a_verdict_says_what_becomes_of_the_worst_direction_and_what_is_out_of_reach(seed, design):
    rng = np.random.default_rng(seed)
    for _ in range(DRAWS):
        plant = in_millimetres(ordinary(rng, (4, 3), modes=4))
        result = design().design(plant)
        band_hz = result.details["band_hz"]
        louder_db, _ = largest_over(plant, result.controller, band_hz)
        if louder_db >= 3:  # a plant on which the worst direction gets quieter tests nothing
            break
    else:
        pytest.fail(f"{design.__name__}: on none of {DRAWS} plants does the worst direction get 3 dB louder")
    said = re.search(r"worst direction of S gets louder by ([\d.]+) dB, at ([\d.]+) Hz", result.status.sentence)
    assert said, result.status.sentence
    print(f"{design.__name__}: said {said[1]} dB, {louder_db:.2f} dB on a grid")
    assert float(said[1]) == pytest.approx(louder_db, abs=0.2)
    assert "The actuators reach 3 of 4 directions of the sensors" in result.status.sentence
    lines = np.geomspace(*band_hz, 60)
    out_of_reach = np.mean([largest_over(plant, result.controller, (f, f))[1][0] for f in lines], axis=0)
    assert f"most of it sensor {plant.sensors[int(np.argmax(out_of_reach))].name!r}" in result.status.sentence
    assert f"{said[0]}" in analyse_loop(plant, result.controller, band_hz).status.sentence


def test_sensors_of_several_units_are_said_to_be_weighed(seed):
    """In units of unknown size a reading that is a thousand times another says nothing of a direction."""
    plant = in_millimetres(ordinary(np.random.default_rng(seed), (2, 3), modes=4))
    own = Lqg().design(plant).status.sentence
    assert "worst direction of S gets" in own
    sensors = [Channel("gap", "mm"), Channel("force", "N")]
    other = StateSpace(plant.A, plant.B, plant.C, plant.D, plant.rate_hz, plant.actuators, sensors)
    assert "worst direction of S, each sensor weighed by its own scale, gets" in Lqg().design(other).status.sentence


def test_actuators_that_reach_all_directions_leave_none_out(seed):
    result = Lqg().design(ordinary(np.random.default_rng(seed), (2, 3), modes=4))
    assert "worst direction of S" in result.status.sentence
    assert "directions of the sensors" not in result.status.sentence


def test_actuators_that_reach_nothing_are_said_to():
    G = StateSpace([[0.5]], [[0.0]], [[1.0]], [[0.0]], RATE)
    law = StateSpace([[0.5]], [[1.0]], [[0.1]], [[0.0]], RATE)
    assert "no actuator reaches any sensor" in analyse_loop(G, law, (1.0, 100.0)).status.sentence


def test_a_plant_without_damping_has_directions_at_its_own_frequency_too():
    plant = StateSpace([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], [[0.0, 1.0]], [[0.0]])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-1.0]])
    found = analyse_loop(plant, law, (0.01, 1.0))
    assert found.status.ok
    assert "The actuators reach" not in found.status.sentence


def test_the_peak_of_s_is_one_number_whatever_units_the_actuators_have():
    """Sensors of one unit are compared in it: a coil in amperes beside a stack in volts changes none of their gains."""
    plant = problems.damped_plant(seed=3)
    units = [Channel("coil", "A"), Channel("stack", "V")]
    mixed = StateSpace(plant.A, plant.B * [1.0, 7.0], plant.C, plant.D, plant.rate_hz, units, plant.sensors)
    law = Lqg().design(mixed).controller
    peak_db, f_hz = peak_sensitivity(mixed, law)
    found = analyse_loop(mixed, law)
    assert found.even
    assert np.isclose(found.peaks["S"].gain_db, peak_db, atol=1e-3)
    assert np.isclose(found.peaks["S"].f_hz, f_hz, rtol=1e-2)


@pytest.mark.parametrize("rate_hz", [3500.0, 1e-3])
def test_where_a_loop_is_loudest_is_said_in_its_own_digits(rate_hz):
    plant = StateSpace([[0.9995]], [[0.0005]], [[1.0]], [[0.0]], rate_hz)
    for verdict in (Lqg().design(plant), analyse_loop(plant, StateSpace([[0.5]], [[0.1]], [[-1.0]], [[0.0]], rate_hz))):
        said = re.search(r"at most ([\d.]+) dB, at (\S+) Hz;", verdict.status.sentence)
        print(verdict.status)
        peaks = getattr(verdict, "details", None) or {"peak_sensitivity_hz": verdict.peaks["S"].f_hz}
        assert said
        assert float(said[2]) == pytest.approx(peaks["peak_sensitivity_hz"], rel=1e-3)
