"""Values: shapes checked, never guessed; nothing in them can be changed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ultraquiet as uq
from ultraquiet._base.errors import InputError


def random_system(rng, n=6, nu=2, ny=3, rate_hz=100.0):
    A = rng.standard_normal((n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    return uq.StateSpace(
        A, rng.standard_normal((n, nu)), rng.standard_normal((ny, n)), rng.standard_normal((ny, nu)), rate_hz
    )


def test_record_refuses_nan_and_names_the_sample():
    y = np.zeros((2, 10))
    y[1, 3] = np.nan
    with pytest.raises(InputError, match=r"'outputs' has 1 NaN or infinite values, the first at index \(1, 3\)"):
        uq.Record(np.zeros((1, 10)), y, 10.0)


@pytest.mark.parametrize(
    ("inputs", "outputs", "rate_hz", "words"),
    [
        (np.zeros((1, 10)), np.zeros((1, 9)), 10.0, "10 samples but outputs have 9"),
        (np.zeros((1, 0)), np.zeros((1, 0)), 10.0, "no samples"),
        (np.zeros((1, 2, 3)), np.zeros((1, 3)), 10.0, "dimensions"),
        (np.zeros((1, 3)), np.zeros((1, 3)), 0.0, "above zero"),
        (np.zeros((1, 3)), np.zeros((1, 3)), np.nan, "finite"),
        ([["a"]], [[1.0]], 1.0, "real array"),
    ],
)
def test_record_refuses(inputs, outputs, rate_hz, words):
    with pytest.raises(InputError, match=words):
        uq.Record(inputs, outputs, rate_hz)


def test_record_is_a_copy_that_cannot_be_changed():
    u = np.zeros((1, 5))
    record = uq.Record(u, u, 10.0)
    u[0, 0] = 7.0
    assert record.inputs[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record.inputs[0, 0] = 1.0


def test_record_parts_and_picks(rng):
    record = uq.Record(rng.standard_normal((2, 20)), rng.standard_normal((3, 20)), 10.0, ["a", "b"], ["x", "y", "z"])
    part = record.part(5, 15).pick(inputs=[1], outputs=[2, 0])
    assert part.samples == 10
    assert [c.name for c in part.sensors] == ["z", "x"]
    assert np.array_equal(part.outputs, record.outputs[[2, 0], 5:15])
    assert part.hash != record.hash


def test_state_space_refuses_shapes():
    with pytest.raises(InputError, match="do not fit"):
        uq.StateSpace(np.eye(2), np.ones((3, 1)), np.ones((1, 2)), [[0.0]])
    with pytest.raises(InputError, match="NaN"):
        uq.StateSpace([[np.nan]], [[1.0]], [[1.0]], [[0.0]])


@pytest.mark.parametrize("rate_hz", [None, 100.0])
def test_frequency_response_against_direct_solution(rng, rate_hz):
    system = random_system(rng, rate_hz=rate_hz)
    f = np.linspace(0, 50, 41)
    s = 2j * np.pi * f
    z = s if rate_hz is None else np.exp(s / rate_hz)
    plain = np.stack([system.C @ np.linalg.solve(p * np.eye(6) - system.A, system.B) + system.D for p in z], axis=2)
    error = np.abs(system.frequency_response(f) - plain).max() / np.abs(plain).max()
    print(f"frequency response against dense solves: {error:.1e}")
    assert error < 1e-10


def test_static_gain_has_a_response_and_no_poles():
    gain = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[1.0, 2.0]], 10.0)
    assert gain.frequency_response([1.0, 2.0])[0, 1].tolist() == [2.0, 2.0]
    assert gain.poles().size == 0
    assert gain.is_stable()
    assert gain.simulate(np.ones((2, 3))).tolist() == [[3.0, 3.0, 3.0]]


def test_control_round_trip(rng):
    pytest.importorskip("control")
    system = random_system(rng)
    back = uq.StateSpace.from_control(system.to_control())
    assert np.array_equal(back.A, system.A)
    assert back.rate_hz == pytest.approx(system.rate_hz)


def test_stepped_controller_is_simulation(rng):
    from ultraquiet.values import Controller, SteppedController

    law = random_system(rng)
    stepped = SteppedController(law)
    assert isinstance(stepped, Controller)
    y = rng.standard_normal((2, 30))
    assert np.allclose(np.stack([stepped.step(v) for v in y.T], axis=1), law.simulate(y), atol=1e-12)


roots_inside = st.lists(
    st.tuples(st.floats(0.3, 0.97), st.floats(0.05, 3.0)), min_size=1, max_size=3, unique_by=lambda r: round(r[1], 1)
)


@given(
    roots_inside, st.lists(st.floats(-2, 2).filter(lambda v: abs(v) > 0.05), min_size=1, max_size=6), st.integers(0, 3)
)
def test_sections_realise_the_polynomials(pairs, b, delay):
    poles = [r * np.exp(1j * w) for r, w in pairs]
    a = np.poly([*poles, *np.conj(poles)]).real
    model = uq.PolynomialModel([np.r_[np.zeros(delay), b]], [a], rate_hz=1.0)
    f = np.linspace(0, 0.5, 17)
    direct, realised = model.frequency_response(f), model.state_space().frequency_response(f)
    # Roots of nearly equal pairs are good to the square root of the machine precision at best.
    assert np.abs(direct - realised).max() <= 1e-5 * np.abs(direct).max()


def test_printed_equations_evaluate_as_published():
    """Eqs. (11) and (12) as printed, against values computed elsewhere (tests/data/README.md)."""
    import json
    import re
    from pathlib import Path

    held = json.loads((Path(__file__).parents[1] / "data" / "suite_equations.json").read_text())

    def polynomial(factors):
        total = np.ones(1)
        for factor in factors:
            quadratic = re.fullmatch(r"z\^2([+-][\d.]+)z([+-][\d.]+)", factor)
            part = [1.0, *map(float, quadratic.groups())] if quadratic else [1.0, -float(factor)]
            total = np.convolve(total, part)
        return total

    worst = 0.0
    for name in ("f21", "f22"):
        num = held[name]["gain"] * polynomial(held[name]["zeros"])
        den = polynomial(held[name]["poles"])
        b = np.concatenate([np.zeros(len(den) - len(num)), num])
        model = uq.PolynomialModel([b], [den], rate_hz=held["rate_hz"])
        for row in held["frequency_response"]:
            g = model.frequency_response([row["f_hz"]])[0, 0, 0]
            phase = (np.degrees(np.angle(g)) - row[f"{name}_deg"] + 180) % 360 - 180
            worst = max(worst, abs(20 * np.log10(abs(g)) - row[f"{name}_db"]), abs(phase) / 100)
    print(f"eqs. (11)-(12) against the reference: worst {worst:.1e} dB (or hundredths of a degree)")
    assert worst < 1.1e-3


@pytest.mark.parametrize("rate_hz", [3500.0, 1000.0 / 3.0, 44_100.0, None])
def test_a_rate_survives_python_control(rate_hz):
    G = uq.StateSpace([[-0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=rate_hz)
    assert uq.StateSpace.from_control(G.to_control()).rate_hz == rate_hz


def test_every_model_has_a_state_space():
    G = uq.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    assert G.state_space() is G


@pytest.mark.parametrize("wrong", [[[1j]], [[1.0, 2.0], [1.0]], [["a"]]])
def test_a_record_of_something_else_is_refused(wrong):
    with pytest.raises(uq.errors.InputError, match="inputs"):
        uq.Record(wrong, [[1.0]], 10.0)


def test_a_channel_that_is_not_there_is_named():
    with pytest.raises(uq.errors.InputError, match="no index 7"):
        uq.Record(np.ones((2, 5)), np.ones((1, 5)), 10.0).pick([7])


def test_descriptor_systems(rng):
    """E of full rank gives E^-1 A, E^-1 B; an algebraic equation 0 = x1 - x2 + u makes a direct term."""
    A, B, C, D = (rng.standard_normal(s) for s in ((4, 4), (4, 2), (3, 4), (3, 2)))
    E = rng.standard_normal((4, 4))
    f = [0.0, 0.1, 3.0]
    for scale in (1.0, 1e9, 1e-9):
        G = uq.StateSpace.from_descriptor(E * scale, A * scale, B * scale, C, D)
        plain = uq.StateSpace(np.linalg.solve(E, A), np.linalg.solve(E, B), C, D)
        np.testing.assert_allclose(G.frequency_response(f), plain.frequency_response(f), rtol=1e-9)
    G = uq.StateSpace.from_descriptor([[1, 0], [0, 0]], [[-1, 0], [1, -1]], [[1], [1]], [[0, 1]], [[0]])
    assert G.states == 1
    np.testing.assert_allclose(G.D, [[1.0]])
    np.testing.assert_allclose(G.A, [[-1.0]])
    with pytest.raises(InputError, match="index above one"):
        uq.StateSpace.from_descriptor([[1, 0], [0, 0]], [[0, 1], [1, 0]], [[0], [1]], [[0, 1]], [[0]])
    with pytest.raises(InputError, match="shape"):
        uq.StateSpace.from_descriptor([[1]], [[0, 1], [1, 0]], [[0], [1]], [[0, 1]], [[0]])


@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (3, 4), (5, 3)])
def test_algebraic_variables_and_equations_have_no_units(rng, nu, ny):
    A, B, C = rng.standard_normal((6, 6)), rng.standard_normal((6, nu)), rng.standard_normal((ny, 6))
    E = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    E[:4, :4] += 0.3 * rng.standard_normal((4, 4))
    plain = uq.StateSpace.from_descriptor(E, A, B, C, np.zeros((ny, nu)))
    assert plain.states == 4
    f = [0.0, 0.1, 3.0]
    for _ in range(5):
        x, e = np.ones(6), np.ones(6)
        x[4:], e[4:] = 10.0 ** rng.uniform(-12, 12, 2), 10.0 ** rng.uniform(-12, 12, 2)
        M = (E * x * e[:, None], A * x * e[:, None], B * e[:, None], C * x)
        other = uq.StateSpace.from_descriptor(*M, np.zeros((ny, nu)))
        np.testing.assert_allclose(other.frequency_response(f), plain.frequency_response(f), rtol=1e-7)


@pytest.mark.parametrize("newtons", [1.0, 1e-6, 1e-12])
def test_a_force_between_a_spring_and_a_mass_has_any_unit(newtons):
    """m v' = f, 0 = -k x - c v - f + u: stiff, so that the force is a small term of its own equation."""
    k, c, m = 1e7, 1e2, 1.0
    A = [[0, 1, 0], [0, 0, newtons / m], [-k, -c, -newtons]]
    G = uq.StateSpace.from_descriptor(np.diag([1, 1, 0]), A, [[0], [0], [1]], [[1, 0, 0]], [[0]])
    np.testing.assert_allclose(np.poly(G.poles()), [1.0, c / m, k / m], rtol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_an_index_above_one_is_refused_in_any_unit(unit):
    with pytest.raises(InputError, match="index above one"):
        uq.StateSpace.from_descriptor([[1, 0], [0, 0]], [[0, unit], [1, 0]], [[0], [1]], [[0, unit]], [[0]])


def test_channels_of_a_record_are_picked_by_name_or_index():
    record = uq.Record(np.zeros((2, 4)), np.arange(4.0), 10.0, actuators=["left", "right"])
    assert record.pick(["right"]).actuators == record.pick(1).actuators == record.pick([-1]).actuators
    for wrong in (["x"], "x", [0.5], [True]):
        with pytest.raises(uq.errors.InputError, match=r"Record.pick: there is no (channel|index) .*; there are left"):
            record.pick(wrong)
    with pytest.raises(uq.errors.InputError, match=r"Record.part: 'start' must be a whole number, got 0.5"):
        record.part(0.5, 3)
