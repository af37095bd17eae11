"""Norms at the edges: no states, no inputs in effect, integrators, needles, two hundred states; SLICOT's H2 norm."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag, solve_discrete_lyapunov

from slicot_examples import SLICOT, numbers
from ultraquiet.analyse import h2_norm, hinf_norm, l2_norm
from ultraquiet.analyse.margins import even_inputs
from ultraquiet.linalg import discretize, norms
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import sensitivity

TINY = 1e-8
PROBLEMS = Path(__file__).parents[1] / "data" / "problems"
PARALLEL = PROBLEMS / "parallel_modes.npz"


def modes(rng, count, zeta, channels=2):
    """Return a continuous system of lightly damped modes between 1 and 100 rad/s."""
    w = np.sort(rng.uniform(1, 100, count))
    A = block_diag(*[[[0, wk], [-wk, -2 * zeta * wk]] for wk in w])
    B, C = rng.standard_normal((2 * count, channels)), rng.standard_normal((channels, 2 * count))
    return StateSpace(A, B, C, np.zeros((channels, channels)))


def on_a_grid(G, f_hz):
    """Return the largest singular value over frequencies, by solving at each of them."""
    z = 2j * np.pi * f_hz if G.rate_hz is None else np.exp(2j * np.pi * f_hz / G.rate_hz)
    one = np.eye(G.states)
    return max(np.linalg.norm(G.C @ np.linalg.solve(s * one - G.A, G.B) + G.D, 2) for s in z)


def near_poles(G, across=30):
    """Return frequencies at and around every resonance, as far off as its damping, and between."""
    poles = G.poles() if G.rate_hz is None else np.log(G.poles().astype(complex)) * G.rate_hz
    spread = np.linspace(-3, 3, across)
    w = np.concatenate([np.abs(p.imag) + spread * max(-p.real, 1e-12) for p in poles])
    return np.unique(np.abs(w)) / (2 * np.pi)


def test_slicot_ab13bd():
    """The L2 norm of an unstable system; its H2 norm is infinite."""
    values = [float(v) for v in (SLICOT / "AB13BD.dat").read_text().split("\n", 1)[1].replace("C L", "").split()][4:]
    shapes = [(7, 7), (7, 2), (3, 7), (3, 2)]
    parts = np.split(np.array(values), np.cumsum([r * c for r, c in shapes])[:-1])
    G = StateSpace(*(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)))
    print(f"AB13BD: {l2_norm(G):.6g}, printed {numbers((SLICOT / 'AB13BD.res').read_text())[-1]}")
    assert abs(l2_norm(G) / 7.93948 - 1) < 1e-6
    assert h2_norm(G) == np.inf


def test_l2_norm_is_the_mean_over_frequency(rng):
    A = np.diag([0.5, -0.7, 1.4, -2.0])
    G = StateSpace(A, rng.standard_normal((4, 2)), rng.standard_normal((3, 4)), rng.standard_normal((3, 2)), 1.0)
    response = G.frequency_response(np.linspace(0, 0.5, 20_001))
    mean = np.trapezoid(np.sum(np.abs(response) ** 2, axis=(0, 1)), dx=1 / 20_000)
    assert abs(l2_norm(G) / np.sqrt(mean) - 1) < 1e-6


@pytest.mark.parametrize("rate_hz", [None, 100.0])
def test_feedthrough_alone(rng, rate_hz):
    D = rng.standard_normal((3, 2))
    G = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), D, rate_hz)
    assert abs(hinf_norm(G)[0] / np.linalg.norm(D, 2) - 1) < 1e-12
    assert h2_norm(G) == (np.inf if rate_hz is None else pytest.approx(np.linalg.norm(D)))


@pytest.mark.parametrize("rate_hz", [None, 100.0])
def test_integrators_and_unstable_systems_have_no_norm(rate_hz):
    border = 0.0 if rate_hz is None else 1.0
    for pole in (border, border + 0.1):
        G = StateSpace([[pole]], [[1.0]], [[1.0]], [[0.0]], rate_hz)
        assert hinf_norm(G) == (np.inf, 0.0)
        assert h2_norm(G) == np.inf


@pytest.mark.parametrize("rate_hz", [None, 100.0])
def test_states_without_effect(rng, rate_hz):
    """No input, no output or neither in effect: the norm of what is left, which may be nothing."""
    A = np.diag([-0.5, -0.9, -0.3]) if rate_hz is None else np.diag([0.5, -0.9, 0.3])
    for B, C in ((np.zeros((3, 1)), np.ones((1, 3))), (np.ones((3, 1)), np.zeros((1, 3)))):
        assert hinf_norm(StateSpace(A, B, C, [[0.0]], rate_hz))[0] == 0
        assert h2_norm(StateSpace(A, B, C, [[0.0]], rate_hz)) == 0
        assert hinf_norm(StateSpace(A, B, C, [[2.0]], rate_hz))[0] == 2


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_peak_between_modes_that_are_nearly_parallel_is_met(unit):
    """In modal coordinates terms of 1e3 cancel to one: the crossings read there alone left the peak of 2.18 at 1.99."""
    with np.load(PARALLEL) as held:
        G = StateSpace(held["A"], held["B"] * unit, held["C"] / unit, held["D"], 1000.0)
    peak, f_hz = hinf_norm(G)
    print(f"{peak:.9f} at {f_hz:.4f} Hz")
    assert peak == pytest.approx(on_a_grid(G, np.linspace(36.2, 36.3, 2001)), rel=1e-7)
    assert peak >= on_a_grid(G, np.linspace(0, 500, 2001)) * (1 - 1e-7)


@pytest.mark.parametrize("unit", [1e-9, 0.1, 0.5, 1.0, 10.0, 1e9])
def test_both_ends_of_a_scalar_loop_have_the_peak_of_a_grid_where_poles_repeat(unit):
    """One Schur block of states decades apart: its crossings were lost, and peaks of 1.397 told as 1.178 to 1.298."""
    with np.load(PROBLEMS / "repeated_poles.npz") as held:
        G = StateSpace(held["GA"], held["GB"] * unit, held["GC"], held["GD"] * unit, 100.0)
        K = StateSpace(held["KA"], held["KB"], held["KC"] / unit, held["KD"] / unit, 100.0)
    told = [hinf_norm(sensitivity(*even_inputs(*ends)))[0] for ends in ((G, K), (K, G))]
    told += [hinf_norm(sensitivity(*ends))[0] for ends in ((G, K), (K, G))]
    f = np.concatenate([np.linspace(0.5, 0.54, 4001), np.linspace(0.0, 50.0, 2001)])
    truth = np.abs(1 / (1 - response(G, f) * response(K, f))).max()
    print(f"{told} against {truth:.9f}")
    assert told == pytest.approx([truth] * 4, rel=1e-6)


def response(system, f):
    """The response of a system of one channel by direct solves."""
    z = np.exp(2j * np.pi * f / system.rate_hz)
    return (system.C @ np.linalg.solve(z[:, None, None] * np.eye(system.states) - system.A, system.B) + system.D)[
        :, 0, 0
    ]


def test_needles_of_damping_1e_8(rng):
    """Peaks a hundred-millionth of their frequency wide, continuous and sampled, against solves at the peaks."""
    worst = 0.0
    for _ in range(5):
        G = modes(rng, 4, TINY)
        sampled = StateSpace(*discretize.zero_order_hold(G.A, G.B, G.C, G.D, 1 / 100.0), rate_hz=100.0)
        for system in (G, sampled):
            norm, _ = hinf_norm(system)
            grid = on_a_grid(system, near_poles(system, 61))
            worst = max(worst, abs(grid / norm - 1))
            assert grid <= norm * (1 + 1e-5)
    print(f"needles of damping 1e-8: grid against norm {worst:.1e}")
    assert worst < 1e-2


def test_h2_of_needles_is_the_sum_over_modes(rng):
    """Well separated modes, each with b = c = 1 on its second state: |G|^2 = sum 1 / (4 zeta w), near enough."""
    w, zeta = np.array([1.0, 10.0, 100.0]), TINY
    A = block_diag(*[[[0, wk], [-wk, -2 * zeta * wk]] for wk in w])
    b = np.tile([0.0, 1.0], 3)
    norm = h2_norm(StateSpace(A, b[:, None], b[None], [[0.0]]))
    expected = np.sqrt(np.sum(1 / (4 * zeta * w)))
    print(f"H2 norm of needles: {norm:.10g} against {expected:.10g}")
    assert abs(norm / expected - 1) < 1e-6


def test_two_hundred_states(rng):
    G = modes(rng, 100, 1e-3, channels=6)
    sampled = StateSpace(*discretize.zero_order_hold(G.A, G.B, G.C, G.D, 1 / 100.0), rate_hz=100.0)
    for system in (G, sampled):
        norm, f_hz = hinf_norm(system)
        grid = on_a_grid(system, near_poles(system, 9)[:: 4 if system is G else 8])
        here = on_a_grid(system, np.array([f_hz]))
        print(f"200 states: norm {norm:.6g} at {f_hz:.4g} Hz, grid {grid:.6g}, there {here:.6g}")
        assert grid <= norm * (1 + 1e-6)
        assert abs(here / norm - 1) < 1e-6
    X = solve_discrete_lyapunov(sampled.A, sampled.B @ sampled.B.T)
    peer = np.sqrt(np.trace(sampled.C @ X @ sampled.C.T))
    print(f"200 states: H2 norm {h2_norm(sampled):.8g}, by SciPy's equation {peer:.8g}")
    assert abs(h2_norm(sampled) / peer - 1) < 1e-6


def test_a_pole_at_nyquist_is_no_obstacle():
    """z = -1 + 1e-15 would go to infinity in the bilinear map."""
    G = StateSpace([[-1 + 1e-12, 0], [0, 0.5]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]], rate_hz=100.0)
    norm, f_hz = hinf_norm(G)
    assert abs(norm / 1e12 - 1) < 1e-3
    assert abs(f_hz - 50) < 1e-6


@pytest.mark.parametrize("size", [1e-150, 1e-30, 1e30, 1e150])
def test_units_do_not_matter(rng, size):
    G = modes(rng, 3, 0.05)
    other = StateSpace(G.A, G.B * size, G.C, G.D)
    assert abs(hinf_norm(other)[0] / hinf_norm(G)[0] / size - 1) < 1e-6
    assert abs(h2_norm(other) / h2_norm(G) / size - 1) < 1e-6


def close_modes(rng, modes=3, rest=10):
    """Return a discrete system whose response is known to few digits: close modes, slow beside the rate, mixed up."""
    n = 2 * modes + rest
    w = 8e-4 * (1 + 0.01 * rng.standard_normal(modes))
    z = np.exp(w * (-3e-5 + 1j))
    A = block_diag(*([[p.real, p.imag], [-p.imag, p.real]] for p in z), np.diag(rng.uniform(0.1, 0.99, rest)))
    A += 0.3 * np.triu(rng.standard_normal((n, n)), 2) * (np.arange(n)[:, None] >= 2 * modes)
    left, right = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    T = left * 10 ** rng.uniform(-1.5, 1.5, n) @ right
    Ti = np.linalg.inv(T)
    return Ti @ A @ T, Ti @ (1e-5 * rng.standard_normal((n, 2))), rng.standard_normal((2, n)) @ T, np.eye(2)


def test_the_exact_response_is_asked_a_bounded_number_of_times(seed, monkeypatch):
    """It costs ten times the usual one: three hundred of it a norm made a design of four hundred norms endless."""
    asked, gain = [0], norms.refined_gain

    def counted(*args):
        asked[0] += 1
        return gain(*args)

    monkeypatch.setattr(norms, "refined_gain", counted)
    most = norms.HIGHEST + norms.RIVALS * (norms.FEW + 4 * norms.NARROWINGS)
    rng, counts = np.random.default_rng(seed), []
    for _ in range(8):
        A, B, C, D = close_modes(rng)
        asked[0] = 0
        norm, w = norms.peak_gain(A, B, C, D, True)
        counts.append(asked[0])
        near = np.exp(1j * w * (1 + np.concatenate([-np.geomspace(1e-9, 1e-3, 40), np.geomspace(1e-9, 1e-3, 40)])))
        assert max(gain(A, B, C, D, z) for z in near) <= norm * (1 + norms.DISAGREE)
    print(f"the exact response was asked {counts} times")
    assert np.median(counts) <= most  # a draw whose response has no four digits is searched as a whole
    assert max(counts) > 2, "no draw needs the exact response"


@pytest.mark.parametrize("rate_hz", [None, 100.0])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (3, 4), (5, 3)])
def test_l2_norm_has_no_units_of_states(rng, rate_hz, nu, ny):
    A, d = rng.standard_normal((6, 6)), 10.0 ** rng.uniform(-7, 7, 6)
    B, C = rng.standard_normal((6, nu)), rng.standard_normal((ny, 6))
    G = StateSpace(A, B, C, np.zeros((ny, nu)), rate_hz)
    other = StateSpace(A * d / d[:, None], B / d[:, None], C * d, G.D, rate_hz)
    print(f"{l2_norm(G):.6g}, in other units {l2_norm(other):.6g}")
    assert l2_norm(other) == pytest.approx(l2_norm(G), rel=1e-9)
    assert not G.is_stable()


def test_two_forms_that_agree_at_one_place_by_luck_are_asked_beside_it_too():
    """The response as it stands had its peak a quarter of a width off, and there the exact one's value to 1e-9."""
    rng = np.random.default_rng(2234378341)
    A, B, C, D = [close_modes(rng) for _ in range(6)][-1]
    norm, w = norms.peak_gain(A, B, C, D, True)
    beside = np.exp(1j * w * (1 + np.linspace(-5e-8, 5e-8, 41)))
    assert max(norms.refined_gain(A, B, C, D, z) for z in beside) <= norm * (1 + norms.DISAGREE)


def test_two_forms_that_agree_at_the_peak_of_a_plateau_are_asked_along_it_too():
    """Joined matrices had lost three millionths of a loop flat over five decades, and by luck nothing at its peak."""
    A, B, C, D = -np.diag([1e-3, 1.0, 1e3]), np.array([[0.0], [1.0], [0.0]]), np.array([[0.0, 3e-7, 0.0]]), np.eye(1)
    A[0, 1] = A[2, 1] = 1e-9
    C[0, 0] = C[0, 2] = 1e-9

    def exact(s):
        w = abs(s)
        return norms.refined_gain(A, B, C, D, s) + 3e-6 * np.log10(np.clip(w, 1.0, 20.0)) / (1 + (w / 200) ** 2)

    formed, place = norms.peak_gain(A, B, C, D, False)
    assert abs(exact(1j * place) / formed - 1) < norms.DISAGREE  # where the one peaks they agree
    norm, w = norms.peak_gain(A, B, C, D, False, exact=exact)
    most = max(exact(1j * x) for x in np.geomspace(1e-3, 1e3, 601))
    formed_at = f"of the matrices {formed - 1:.3e} at {place:.3g}"
    print(f"told {norm - 1:.3e} at {w:.3g} rad/s, highest {most - 1:.3e}; {formed_at}")
    assert most <= norm * (1 + norms.DISAGREE)


@pytest.mark.parametrize("rate_hz", [None, 858.0])
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_states_that_lead_nowhere_are_no_part_of_a_norm(rate_hz, unit, rng):
    """Terms of 1e3 beside the diagonal, whose round-off no pole shows: through them nothing reaches the output."""
    n = 20
    A = np.diag(rng.uniform(0.3, 0.999, n) - (rate_hz is None)) + np.triu(1e3 * rng.standard_normal((n, n)), 1)
    zeros = StateSpace(A, unit * rng.standard_normal((n, 2)), np.zeros((3, n)), np.zeros((3, 2)), rate_hz)
    assert (hinf_norm(zeros)[0], h2_norm(zeros), l2_norm(zeros)) == (0.0, 0.0, 0.0)
    one = StateSpace([[0.5 - (rate_hz is None)]], [[1.0, 0.0]], [[unit], [0.0], [0.0]], np.zeros((3, 2)), rate_hz)
    both = one + zeros
    for norm in (lambda G: hinf_norm(G)[0], h2_norm, l2_norm):
        assert norm(both) == pytest.approx(norm(one), rel=1e-12)
