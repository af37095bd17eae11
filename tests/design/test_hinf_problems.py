"""H-infinity problems that a search by equations alone gets wrong: levels are what verified controllers give."""

from pathlib import Path

import numpy as np
import pytest

from ultraquiet.analyse import hinf_norm
from ultraquiet.design import BandAttenuation, four_block, output_shaping, synthesize_hinf
from ultraquiet.design.hinf import riccati
from ultraquiet.design.hinf.gamma_search import UNDECIDED
from ultraquiet.design.hinf.mixed_sensitivity import MixedSensitivity
from ultraquiet.design.hinf.problem.hidden import without_hidden
from ultraquiet.design.hinf.problem.units import even_problem
from ultraquiet.design.hinf.problem.verified import Verifier
from ultraquiet.design.hinf.verification import verify_level
from ultraquiet.linalg.equations import continuous_riccati
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain, lft

PROBLEMS = Path(__file__).parents[1] / "data" / "problems"


def compleib(name, noise=0.0):
    """Return P, ny and nu of a COMPleib problem; `noise` times as many disturbances as measurements are added to y."""
    z = np.load(PROBLEMS / f"{name}.npz")
    ny, nu = z["C"].shape[0], z["B"].shape[1]
    extra = ny if noise else 0
    n, p = z["A"].shape[0], z["C1"].shape[0]
    B = np.hstack([z["B1"], np.zeros((n, extra)), z["B"]])
    top = np.hstack([z["D11"], np.zeros((p, extra)), z["D12"]])
    low = np.hstack([z["D21"], noise * np.eye(ny, extra), np.zeros((ny, nu))])
    return StateSpace(z["A"], B, np.vstack([z["C1"], z["C"]]), np.vstack([top, low])), ny, nu


def in_units(P, ny, nu, rng, decades):
    """Return the problem with states, controls and measurements each in units drawn up to 10^decades either way."""
    x, u, y = (10 ** rng.uniform(-decades, decades, k) for k in (P.states, nu, ny))
    u, y = np.concatenate([np.ones(P.B.shape[1] - nu), u]), np.concatenate([np.ones(P.C.shape[0] - ny), y])
    return StateSpace(P.A * x / x[:, None], P.B / x[:, None] * u, P.C * x * y[:, None], P.D * u * y[:, None], P.rate_hz)


OPTIMA = {"ac14": (100.0, 0.0), "rea3": (74.2513, 1e-2)}


@pytest.mark.parametrize("name", OPTIMA)
@pytest.mark.parametrize("margin", [1.00003, 1.01, 1.1])
def test_the_optimum_whatever_the_margin(name, margin):
    optimum, noise = OPTIMA[name]
    P, ny, nu = compleib(name, noise)
    result = synthesize_hinf(P, ny, nu, margin=margin, second_opinion=False)
    print(f"{name}, margin {margin}: {result.achieved:.5f}")
    assert result.status.ok, result.status
    assert optimum * (1 - 1e-6) < result.achieved < optimum * margin * 1.001
    assert hinf_norm(lft(P, result.controller))[0] == pytest.approx(result.achieved, rel=1e-6)


@pytest.mark.parametrize("name", OPTIMA)
def test_all_units_of_a_problem_give_one_answer(name):
    P, ny, nu = compleib(name, OPTIMA[name][1])
    plain = synthesize_hinf(P, ny, nu, second_opinion=False)
    for decades in (9, 12):
        other = synthesize_hinf(
            in_units(P, ny, nu, np.random.default_rng(decades), decades), ny, nu, second_opinion=False
        )
        print(f"{name}, units of 1e+-{decades}: {other.achieved / plain.achieved - 1:.1e}")
        assert other.achieved == pytest.approx(plain.achieved, rel=1e-6)


def test_an_equation_without_a_cost_is_solved_at_every_level():
    """Its Hamiltonian falls apart and what balances it has no end: scales of 2^28 left no digit of Y at most levels."""
    P, ny, nu = compleib("ac14")
    problem = even_problem(P, ny, nu)
    route = Verifier(P, problem, without_hidden(problem.plant)[0], ny, nu)
    for level in (100.0001, 100.001, 100.004, 100.05, 101.0, 105.0, 110.0, 150.0, 200.0, 400.0):
        A, G, Q = riccati.equation(route.plant, level * problem.level, "Y")
        assert not np.any(Q)
        found = continuous_riccati(A, G, Q)
        print(f"level {level}: residual {found.residual:.1e}, margin {found.margin:.2e}")
        assert found.accepted


def test_a_level_too_high_is_not_agreed_with():
    """The second opinion is asked of 176, where the optimum is 100: it finds a controller below."""
    P, ny, nu = compleib("ac14")
    opinion = verify_level(P, ny, nu, 176.0)
    assert not opinion.agrees
    assert opinion.below
    assert opinion.norm < 101


def two_by_two(rng):
    """Return a problem of twelve states that matter; in one of twenty the controls undo all that disturbances do."""
    A, B, C = rng.standard_normal((12, 12)) - 3 * np.eye(12), rng.standard_normal((12, 4)), rng.standard_normal((4, 12))
    return StateSpace(A, B, C, rng.standard_normal((4, 4)))


def counts_as_zero(result, P):
    return result.achieved < 1e-6 * np.linalg.norm(P.D, 2)


def test_an_optimum_of_zero_is_not_refused_for_its_round_off():
    """1.0e-10 reported and 1.4e-10 achieved, where 4e-8 counts as zero, were called apart."""
    P = two_by_two(np.random.default_rng(1131))
    result = synthesize_hinf(P, 2, 2)
    print(f"reported {result.gamma:.2e}, achieved {result.achieved:.2e}")
    assert result.status.ok, result.status
    assert counts_as_zero(result, P)


# Hidden couplings are of 1e-15 and of round-off, which slow or unstable poles enlarge: in 7 of 596 draws not all twenty
# were below 1e-13 of the largest Hankel value, at most 2.4 % of all at 97.5 %.
@pytest.mark.draws(false_alarm=0.03)
def test_hidden_states_are_left_out_with_a_word(rng):
    """Twelve states that matter and twenty that inputs or outputs do not reach, mixed."""
    P = two_by_two(rng)
    A, B, C, D = P.A, P.B, P.C, P.D
    plain = synthesize_hinf(P, 2, 2)
    unseen, idle = -np.diag(rng.uniform(0.1, 9, 10)), -np.diag(rng.uniform(0.1, 9, 10))
    link = rng.standard_normal((10, 12))
    A = np.block(
        [
            [A, np.zeros((12, 10)), rng.standard_normal((12, 10))],
            [link, unseen, np.zeros((10, 10))],
            [np.zeros((10, 22)), idle],
        ]
    )
    B = np.vstack([B, rng.standard_normal((10, 4)), 1e-15 * rng.standard_normal((10, 4))])
    C = np.hstack([C, 1e-15 * rng.standard_normal((4, 10)), rng.standard_normal((4, 10))])
    Q = np.linalg.qr(rng.standard_normal((32, 32)))[0]
    result = synthesize_hinf(StateSpace(Q.T @ A @ Q, Q.T @ B, C @ Q, D), 2, 2)
    assert result.status.ok, result.status
    assert result.details["hidden"] == 20
    assert "20 states" in result.status.sentence
    if counts_as_zero(plain, P):
        assert counts_as_zero(result, P)
        return
    # both searches hold the same optimum, each as closely as it closed: wider where the sign of X or Y is round-off
    below, reached = zip(*(r.details["optimum"] for r in (plain, result)), strict=True)
    width = max(np.divide(reached, below)) - 1
    print(f"apart by {result.achieved / plain.achieved - 1:.1e}, brackets {width:.1e} wide")
    assert max(below) <= min(reached)
    assert width <= UNDECIDED
    assert result.achieved == pytest.approx(plain.achieved, rel=width)


def test_a_singular_problem_completed_with_small_weights():
    """REA3 as it is: D21 = 0. What completes it is a weight in place of the noise that was added to y above."""
    P, ny, nu = compleib("rea3")
    plain = synthesize_hinf(P, ny, nu)
    assert not plain.status.ok
    assert "regularise=True" in plain.status.sentence
    for Q in (P, in_units(P, ny, nu, np.random.default_rng(1), 9)):
        result = synthesize_hinf(Q, ny, nu, regularise=True)
        cost = result.details["regularised"]
        print(f"REA3: {result.achieved:.4f}, weight {cost['weight']:.0e}, cost {cost['cost']:.1e}")
        assert result.status.ok, result.status
        assert cost["cost"] <= 1e-3
        assert "weight" in result.status.sentence
        assert 74.2 < result.achieved < 74.2513 * 1.001
        assert hinf_norm(lft(Q, result.controller))[0] == pytest.approx(result.achieved, rel=1e-6)


def test_zeros_on_the_boundary_are_mended_by_small_weights():
    """Two integrators whose position is not weighted at high frequency: min |S| under K S free of charge is one."""
    G = StateSpace([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    P = output_shaping(G, gain([[1.0]]), gain([[0.1]]))
    result = synthesize_hinf(P, 1, 1, regularise=True)
    assert result.status.ok, result.status
    assert 1 <= result.achieved < 1.002


def test_what_no_weight_mends_is_refused():
    P = StateSpace([[1.0]], [[1.0, 0.0]], [[1.0], [1.0]], [[0.0, 1.0], [1.0, 0.0]])
    result = synthesize_hinf(P, 1, 1, regularise=True)
    assert result.status.word == "refused"
    assert "B2" in result.status.sentence


@pytest.mark.slow
@pytest.mark.parametrize("margin", [1.01, 1.05])
def test_four_block_on_an_identified_hexapod(margin):
    """By the packaged study's numbers the optimum lies between 1.67 and 1.68; 192 states with the weights'."""
    z = np.load(PROBLEMS / "four_block_plant.npz")
    G = StateSpace(z["A"], z["B"], z["C"], z["D"], 3500.0)
    numbers = {"height": 12.0, "control_limit": 1000.0, "disturbance": 0.3, "noise": 1.0}
    design = MixedSensitivity("four-block", band_hz=(9.0, 108.0), margin=margin, **numbers)
    P = design.generalised(G, design.weights(G))
    result = synthesize_hinf(P, 6, 6, margin=margin)
    low, high = result.details["optimum"]
    print(f"four-block, margin {margin}: {result.achieved:.4f}, the smallest level between {low:.4f} and {high:.4f}")
    assert result.status.ok, result.status
    assert 1.67 < low < high < 1.68
    assert result.achieved < 1.68 * margin * 1.001


@pytest.mark.parametrize(("gain_per_s", "pole"), [(1.0, 0.0), (1.0, 1e-16), (1.0, 1e-12), (1e3, 1e-7), (1e12, 1.0)])
def test_a_lag_slow_beside_its_gain_is_solved_as_an_integrator_is(gain_per_s, pole):
    """The optimum of the four-block problem of k / (s + p) is sqrt(1 + X Z) of its two equations."""
    lag = StateSpace([[-pole]], [[1.0]], [[gain_per_s]], [[0.0]])
    one = gain([[1.0]])
    X = np.hypot(pole, gain_per_s) - pole
    best = np.sqrt(1 + (X / gain_per_s) ** 2)
    result = synthesize_hinf(four_block(lag, one, one, one.D, one.D), 1, 1)
    assert result.status.ok
    assert result.achieved == pytest.approx(best, rel=1e-4)
    low, high = result.details["optimum"]
    assert low <= best * (1 + 1e-6)
    assert high >= best * (1 - 1e-6)
    assert high <= low * (1 + 1e-4)


@pytest.mark.parametrize("off", [-(2.0**-53), 2.0**-52, -1e-12, -1e-9])
def test_integrators_to_rounding_are_designed_for_as_integrators(off):
    def plant(pole):
        return StateSpace(pole * np.eye(2), [[0.1, 0.0], [0.02, 0.1]], np.eye(2), np.zeros((2, 2)), 10.0)

    exact, near = (MixedSensitivity().design(plant(pole)) for pole in (1.0, 1.0 + off))
    assert exact.status.ok
    assert near.status.word == exact.status.word
    assert near.gamma == pytest.approx(exact.gamma, rel=1e-5)


@pytest.mark.parametrize("faster", [1283.5, 1e5, 1e-4])
def test_another_unit_of_time_gives_the_same_law(faster):
    A = np.array([[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, -0.01, 3], [0, 0, -3, -0.01]])
    B = np.array([[0.0], [0.17], [0.28], [-0.92]])
    C = np.array([[0.84, 0.0, 0.62, -0.79], [0.21, 0.0, 1.0, 0.34], [0.89, 0.0, -0.62, -0.4]])
    given, other = (BandAttenuation().design(StateSpace(t * A, t * B, C, np.zeros((3, 1)))) for t in (1.0, faster))
    assert given.status.ok
    assert other.status.word == given.status.word
    assert other.gamma == pytest.approx(given.gamma, rel=1e-5)
    assert other.controller.poles().max().real == pytest.approx(faster * given.controller.poles().max().real, rel=1e-3)
