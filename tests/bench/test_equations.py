"""The paper's eqs. (2)-(10) against the equations of motion they come from."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.bench.hexapod.physics import equations as eq
from ultraquiet.bench.hexapod.physics.sensors import Geophone, strut_voltage
from ultraquiet.bench.hexapod.physics.strut import Stack


@pytest.fixture
def stack(rng):
    return Stack(*(np.array([0.062, 11.7, 5.5e6, 8.0, 1.8e-6, 6e-6, 100.0]) * rng.uniform(0.5, 2.0, 7)))


@pytest.fixture
def geophone(rng):
    return Geophone.at(rng.uniform(8, 16), rng.uniform(0.4, 0.8), 100.0)


def value(fraction, s):
    return np.polyval(fraction[0], s) / np.polyval(fraction[1], s)


def test_eq_9_solves_eqs_5_to_8(stack):
    """Unknown X, V_t and q at one s, V_RC = (R_M s + 1/C_M) q, F_ext = 0."""
    for f_hz in (1.0, 30.0, 700.0, 1500.0, 9000.0):
        s = 2j * np.pi * f_hz
        rows = [
            [0, 1, stack.R_M * s + 1 / stack.C_M],  # (5): V_in = V_RC + V_t
            [-stack.n, -stack.C, 1],  # (6): q = n x + C V_t
            [stack.m_p * s**2 + stack.b_p * s + stack.k_p, -stack.n, 0],  # (7), (8)
        ]
        x = np.linalg.solve(np.array(rows), [1.0, 0.0, 0.0])[0]
        assert value(stack.displacement(), s) == pytest.approx(x, rel=1e-9)


def test_eq_4_solves_eqs_2_and_3(geophone):
    for f_hz in (1.0, 12.0, 100.0):
        s = 2j * np.pi * f_hz
        z = -geophone.m_g * s**2 / (geophone.m_g * s**2 + geophone.b_g * s + geophone.k_g)
        assert value(geophone.voltage(), s) == pytest.approx(geophone.K * s * z, rel=1e-12)


def test_eq_10_has_order_five_and_a_triple_zero_at_dc(stack, geophone):
    num, den = strut_voltage(stack, geophone)
    zeros, poles = np.roots(num), np.roots(den)
    assert poles.size == 5
    assert np.count_nonzero(zeros == 0) == zeros.size == 3
    # No pole is cancelled, and all are stable: the order is really five.
    assert np.abs(poles).min() > 1.0
    assert poles.real.max() < 0
    s = 2j * np.pi * 40.0
    assert value((num, den), s) == pytest.approx(value(stack.displacement(), s) * value(geophone.voltage(), s))


def test_geophone_reads_velocity_above_and_jerk_below_its_suspension():
    g = Geophone.at(12.0, 0.65, 100.0)
    high, low = 2j * np.pi * 600.0, 2j * np.pi * 0.3
    assert abs(value(g.voltage(), high) / high) == pytest.approx(100.0, rel=1e-3)
    jerk = 100.0 / (2 * np.pi * 12.0) ** 2
    assert abs(value(g.voltage(), low) / low**3) == pytest.approx(jerk, rel=1e-3)


def test_the_motion_of_eq_10_obeys_eqs_2_to_8_one_by_one(stack, geophone):
    """The phasors that (4) and (9) give, put into every equation they were derived from."""
    s = 2j * np.pi * np.array([1.0, 30.0, 700.0, 1500.0, 9000.0])
    V_in = np.full(s.size, 25.0 + 0j)
    x = value(stack.displacement(), s) * V_in
    V_out = value(strut_voltage(stack, geophone), s) * V_in
    z = V_out / (geophone.K * s)
    F_t = eq.stack_force(s**2 * x, s * x, x, stack.m_p, stack.b_p, stack.k_p)  # (7), no outer force
    V_t = F_t / stack.n
    q = eq.charge(x, V_t, stack.n, stack.C)
    V_RC = eq.circuit_voltage(s * q, q, stack.R_M, stack.C_M)
    pairs = {
        "(2)": (eq.coil_force(s**2 * z, s * z, z, geophone.m_g, geophone.b_g, geophone.k_g), -geophone.m_g * s**2 * x),
        "(3)": (eq.coil_voltage(s * z, geophone.K), V_out),
        "(5)": (eq.input_voltage(V_RC, V_t), V_in),
        "(6)": (q, stack.n * x + stack.C * V_t),
        "(8)": (eq.transformer_force(V_t, stack.n), F_t),
    }
    for name, (left, right) in pairs.items():
        off = np.abs(left - right).max() / np.abs(right).max()
        print(f"eq. {name} holds to {off:.1e}")
        assert off < 1e-9


def test_the_series_circuit_of_eq_9_depends_on_rate():
    """The paper calls its hysteresis rate-independent; the circuit's loss angle is not."""
    stack = Stack(0.062, 11.7, 5.5e6, 8.0, 1.8e-6, 6e-6, 100.0)
    lag = -np.degrees(np.angle(value(stack.displacement(), 2j * np.pi * np.array([1.0, 50.0]))))
    print(f"lag of X behind V_in: {lag[0]:.3f} degrees at 1 Hz, {lag[1]:.2f} at 50 Hz")
    assert lag[1] == pytest.approx(50.0 * lag[0], rel=0.05)
    assert lag[1] > 1.0


def test_parameters_must_be_positive():
    with pytest.raises(InputError, match="'C_M' must be above zero"):
        Stack(1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0)
    with pytest.raises(InputError, match="'K' must be above zero"):
        Geophone(1.0, 1.0, 1.0, -1.0)
