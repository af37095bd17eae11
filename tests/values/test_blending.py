"""Blending matrices: laws and plants seen through them are the same loop, in any units, of any shape."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ultraquiet import analyse
from ultraquiet._base.errors import InputError
from ultraquiet.values import Blending, Channel, FrequencyResponse, Record, StateSpace
from ultraquiet.values.blended.matrices import actuator_matrix, rank, rigid_body, sensor_matrix
from ultraquiet.values.interconnect import feedback

SHAPES = [(1, 1, 1, 1), (4, 3, 2, 3), (3, 5, 3, 2)]  # sensors, actuators, sensor modes, actuator modes
UNITS = [1.0, 1e9, 1e-9]


def wires(prefix, count, unit, limit=np.inf):
    return [Channel(f"{prefix} {k + 1}", unit, -limit, limit) for k in range(count)]


def drawn(rng, shape, unit=1.0):
    """A blending and a plant whose readings are in units so many times smaller, commands larger."""
    ny, nu, my, mu = shape
    n = 5
    A = rng.standard_normal((n, n))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((n, nu)), unit * rng.standard_normal((ny, n))
    plant = StateSpace(A, B, C, np.zeros((ny, nu)), 2000.0, wires("force", nu, "N"), wires("acc", ny, "m/s^2"))
    Ts, Ta = rng.standard_normal((my, ny)), rng.standard_normal((nu, mu)) / unit
    return Blending(Ts, Ta, plant.sensors, plant.actuators), plant


def drawn_law(rng, blending):
    my, mu = len(blending.sensor_modes), len(blending.actuator_modes)
    B, C = rng.standard_normal((2, my)), 0.01 * rng.standard_normal((mu, 2))
    return StateSpace(0.5 * np.eye(2), B, C, 0.01 * rng.standard_normal((mu, my)), 2000.0)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_loop_in_modes_is_the_loop_on_the_bench(shape, unit, rng):
    blending, plant = drawn(rng, shape, unit)
    law = drawn_law(rng, blending)
    mapped = blending.law(law)
    assert mapped.states == law.states
    assert [c.name for c in mapped.sensors] == [c.name for c in plant.actuators]
    f = np.linspace(0.0, 1000.0, 31)
    modal = feedback(blending.plant(plant), law).frequency_response(f)
    outer = feedback(plant, mapped)
    seen = np.einsum("ij,jkf,kl->ilf", blending.sensor_matrix, outer.frequency_response(f), blending.actuator_matrix)
    assert np.abs(seen - modal).max() < 1e-10 * np.abs(modal).max()
    response = FrequencyResponse(f, plant.frequency_response(f), np.ones((*plant.D.shape, f.size)))
    mapped_response = blending.response(response)
    assert np.allclose(mapped_response.values, blending.plant(plant).frequency_response(f), rtol=1e-10, atol=0)
    assert mapped_response.coherence is None
    loops = [np.sort(np.abs(s.poles())) for s in (feedback(blending.plant(plant), law), outer)]
    assert np.allclose(*loops, atol=1e-8)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_records_are_mapped_and_those_driven_otherwise_refused(shape, unit, rng):
    blending, plant = drawn(rng, shape, unit)
    v = unit * rng.standard_normal((len(blending.actuator_modes), 60))
    u = blending.actuator_matrix @ v
    record = Record(u, plant.simulate(u), 2000.0, plant.actuators, plant.sensors)
    modal = blending.record(record)
    assert np.allclose(modal.inputs, v, rtol=1e-9, atol=1e-12 * unit)
    assert np.allclose(modal.outputs, blending.plant(plant).simulate(v), rtol=1e-9, atol=1e-9 * unit)
    assert [c.unit for c in modal.sensors] == ["m/s^2"] * len(blending.sensor_modes)
    alone = blending.actuator_matrix @ (v * (np.arange(len(v)) == 0)[:, None])
    rest = blending.record(Record(alone, record.outputs, 2000.0, plant.actuators, plant.sensors)).inputs[1:]
    assert not rest.any()
    if len(plant.actuators) > len(blending.actuator_modes):
        loose = Record(rng.standard_normal(u.shape), record.outputs, 2000.0, plant.actuators, plant.sensors)
        with pytest.raises(InputError, match="drive the bench through the"):
            blending.record(loose)


@pytest.mark.parametrize("unit", UNITS)
def test_combinations_within_the_modes_limits_stay_within_the_actuators(unit, rng):
    Ta = rng.standard_normal((4, 3)) * [[1.0], [unit], [1.0], [1 / unit]]
    actuators = [
        Channel(str(k), "V", -rng.uniform(1, 9) * s, rng.uniform(1, 9) * s)
        for k, s in enumerate((1, unit, 1, 1 / unit))
    ]
    modes = Blending(np.eye(1), Ta, ["y"], actuators).actuator_modes
    corners = np.array(np.meshgrid(*[(c.low, c.high) for c in modes])).reshape(3, -1)
    u = Ta @ corners
    for row, wire in zip(u, actuators, strict=True):
        assert wire.low * (1 + 1e-12) <= row.min()
        assert row.max() <= wire.high * (1 + 1e-12)
    nearest = [max(row.max() / w.high, row.min() / w.low) for row, w in zip(u, actuators, strict=True)]
    assert max(nearest) == pytest.approx(1.0)  # nothing is given away for the worst one


def test_a_mode_that_is_one_actuator_keeps_its_range():
    modes = Blending(
        np.eye(2), np.diag([2.0, -1.0]), ["a", "b"], [Channel("p", "V", 0, 150), Channel("q", "V", -15, 150)]
    )
    assert [(c.low, c.high) for c in modes.actuator_modes] == [(0.0, 75.0), (-150.0, 15.0)]


def test_readings_have_the_range_that_sensors_can_reach():
    modes = Blending([[1.0, -2.0], [1.0, 0.0]], [[1.0]], wires("a", 2, "V", 10.0), ["u"]).sensor_modes
    assert [(c.low, c.high) for c in modes] == [(-30.0, 30.0), (-10.0, 10.0)]


def test_noise_goes_through_the_matrix(rng):
    T = rng.standard_normal((2, 4))
    blending = Blending(T, [[1.0]], list("abcd"), ["u"])
    assert np.allclose(blending.noise(0.04 * np.eye(4)), 0.04 * T @ T.T)


@pytest.mark.parametrize("length", UNITS)
def test_rigid_body_modes_are_read_and_driven(length, rng):
    """Eight sensors, one dead; in millimetres or light years the same motion comes back."""
    p, d = length * rng.standard_normal((8, 3)), rng.standard_normal((8, 3))
    H = rigid_body(p, d)
    motion = rng.standard_normal(6) * [1, 1, 1, 1 / length, 1 / length, 1 / length]
    for dead in ((), (3,)):
        Ts, Ta = sensor_matrix(H, left_out=dead), actuator_matrix(H, left_out=dead)
        readings = H @ motion
        readings[list(dead)] = 1e6
        assert np.allclose(Ts @ readings, motion, rtol=1e-9, atol=0)
        wanted = rng.standard_normal(6) * [1, 1, 1, length, length, length]
        assert np.allclose(H.T @ (Ta @ wanted), wanted, rtol=1e-9, atol=0)
        assert not Ts[:, list(dead)].any()
        assert not Ta[list(dead)].any()


def test_a_noisier_sensor_counts_for_less():
    T = sensor_matrix([[1.0], [1.0]], noise=[1.0, 2.0])
    assert np.allclose(T, [[0.8, 0.2]])


def test_a_dead_sensor_leaves_the_modes_as_they_were(rng):
    H = rng.standard_normal((20, 6))
    blending = Blending(sensor_matrix(H), np.eye(4), wires("acc", 20, "m/s^2"), list("abcd"))
    less = blending.without(sensors=["acc 7"])
    assert not less.sensor_matrix[:, 6].any()
    assert np.allclose(less.sensor_matrix, sensor_matrix(H, left_out=[6]), atol=1e-12)
    fewer = Blending(np.eye(1), actuator_matrix(H[:5, :3]), ["y"], list("abcde")).without(actuators=["b"])
    assert np.allclose(fewer.actuator_matrix, actuator_matrix(H[:5, :3], left_out=[1]), atol=1e-12)
    with pytest.raises(InputError, match="5 sensors tell 5 of 6 modes apart"):
        blending.without(sensors=[f"acc {k}" for k in range(1, 16)])
    with pytest.raises(InputError, match="no sensor 'acc 21'"):
        blending.without(sensors=["acc 21"])


@given(st.integers(1, 5), st.integers(1, 5), st.integers(0, 10**6))
def test_rank_hangs_on_no_unit(rows, columns, draw):
    rng = np.random.default_rng(draw)
    matrix = rng.standard_normal((rows, 1)) @ rng.standard_normal((1, columns))
    scaled = 10.0 ** rng.uniform(-9, 9, (rows, 1)) * matrix * 10.0 ** rng.uniform(-9, 9, columns)
    assert rank(scaled) == 1
    full = np.eye(rows, columns) + 0.1 * rng.uniform(-1, 1, (rows, columns)) / 5
    assert rank(10.0 ** rng.uniform(-9, 9, (rows, 1)) * full) == min(rows, columns)


@pytest.mark.parametrize("unit", UNITS)
def test_what_is_left_out_hangs_on_no_unit_where_units_are_mixed(unit, rng):
    T = rng.standard_normal((2, 5))
    mixed = [Channel(f"s {k}", "V" if k < 3 else "m/s^2") for k in range(5)]
    modes = [Channel("p", "m"), Channel("q", "m")]
    scale = np.array([1, 1, 1, unit, unit])
    plain, scaled = (Blending(t, [[1.0]], mixed, ["u"], modes).without(["s 1"]).sensor_matrix for t in (T, T * scale))
    assert np.allclose(scaled, plain * scale, rtol=1e-9, atol=0)


def test_mixed_units_take_a_word():
    mixed = [Channel("acc", "m/s^2"), Channel("geo", "m/s")]
    with pytest.raises(InputError, match=r"'heave' is blended from m/s\^2 and m/s"):
        Blending([[1.0, 2.0]], [[1.0]], mixed, ["u"], ["heave"])
    said = Blending([[1.0, 2.0]], [[1.0]], mixed, ["u"], [Channel("heave", "m/s^2")])
    assert "its matrix must hold the conversion to m/s^2" in said.sentences[0]
    assert Blending(np.eye(2), [[1.0]], mixed, ["u"]).sentences == ()


BAD = [
    (lambda: Blending(np.ones((2, 2)), [[1.0]], ["a", "b"], ["u"]), "of 2 modes has rank 1"),
    (lambda: Blending(np.eye(2), [[1.0, 2.0]], ["a", "b"], ["u"]), "of 2 modes has rank 1"),
    (lambda: Blending(np.eye(2), [[1.0]], ["a", "b", "c"], ["u"]), r"must be \(modes, sensors\)"),
    (lambda: Blending(np.eye(2), [[1.0]], ["a", "b"], ["u", "v"]), r"must be \(actuators, modes\)"),
    (lambda: Blending(np.eye(2), [[1.0]], ["a", "b"], ["u"], ["x"]), "1 names were given for 2"),
    (lambda: Blending(np.eye(2), [[1.0]], ["a", "b"], ["u"], ["x", "x"]), "two sensor modes are called 'x'"),
    (lambda: Blending([[np.nan]], [[1.0]], ["a"], ["u"]), "NaN"),
    (
        lambda: Blending(
            [[1.0]], np.array([[1.0, 1.0], [1.0, -1.0]]), ["a"], [Channel("p", "V", 0, 150), Channel("q", "V")]
        ),
        "actuator 'p', whose limits 0 to 150 V do not hold zero",
    ),
    (lambda: sensor_matrix(np.ones((3, 2))), "3 sensors tell 1 of 2 modes apart"),
    (lambda: actuator_matrix(np.ones((4, 6))), "4 actuators tell 1 of 6 modes apart"),
    (lambda: rigid_body([[0, 0, 0]], [[0, 0, 0]]), "direction 1 has length zero"),
    (
        lambda: Blending(np.eye(2), [[1.0]], ["a", "b"], ["u"]).check(
            "x", [Channel("u")], [Channel("b"), Channel("a")]
        ),
        "another order",
    ),
]


@pytest.mark.parametrize("case", BAD, ids=[c[1] for c in BAD])
def test_bad_input_is_refused(case):
    call, words = case
    with pytest.raises(InputError, match=words):
        call()


def test_sensors_in_one_plane_do_not_pass_for_three_dimensions():
    """Directions computed with cosines hold 6e-17 where zero is meant; that is no motion that could be read."""
    angle = np.arange(6) * np.pi / 3
    p = np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], axis=1)
    d = np.tile([np.cos(np.pi / 2), 0.0, 1.0], (6, 1))
    assert rank(rigid_body(p, d)) == 3
    with pytest.raises(InputError, match="6 sensors tell 3 of 6"):
        sensor_matrix(rigid_body(p, d))


def test_a_decoupled_plant_keeps_its_norm(rng):
    _, plant = drawn(rng, (3, 3, 3, 3))
    same = Blending(np.eye(3), np.eye(3), plant.sensors, plant.actuators)
    assert analyse.hinf_norm(same.plant(plant))[0] == pytest.approx(analyse.hinf_norm(plant)[0], rel=1e-12)
