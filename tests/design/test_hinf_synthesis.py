"""H-infinity synthesis: known optima, reported against achieved, units, refusals."""

import numpy as np
import pytest
from named_plants import array_like, array_problem, bbmx, closed_poles

from slicot_examples import printed, slicot
from ultraquiet._base.errors import InputError
from ultraquiet.analyse import hinf_norm
from ultraquiet.design import output_shaping, synthesize_hinf
from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append, gain, lft


def agreement(result):
    return abs(result.gamma / result.achieved - 1)


def test_benner_byers_mehrmann_xu_problem():
    """Optimum sqrt(0.65); python-control reports 0.0062."""
    result = synthesize_hinf(bbmx(), measurements=1, controls=1)
    print(f"BBMX: gamma {result.gamma:.7f}, achieved {result.achieved:.7f}, truth {np.sqrt(0.65):.7f}")
    assert result.status.ok
    assert abs(result.gamma - np.sqrt(0.65)) < 1e-4
    assert agreement(result) < 1e-3
    assert abs(hinf_norm(lft(bbmx(), result.controller))[0] - result.achieved) < 1e-6


def test_a_level_below_the_optimum_is_refused_and_gives_no_controller():
    for share in (0.71, 0.9, 0.99, 0.999):
        result = synthesize_hinf(bbmx(), 1, 1, gamma=share * np.sqrt(0.65))
        assert not result.status.ok
        assert result.controller is None


@pytest.mark.parametrize(("corners", "gamma"), [((0.25, 0.25), 2.80), ((0.25, 25.0), 2.92), ((25.0, 0.25), 6.73)])
def test_skogestad_and_postlethwaite_example_3_8(corners, gamma):
    """G = [1, 1; 1 + 2 s, 2] / (0.2 s^2 + 1.2 s + 1), W1 = (s / 1.5 + w) / (s + 1e-4 w), W2 = I."""
    A = np.kron(np.eye(2), [[0.0, 1.0], [-5.0, -6.0]])
    B = np.kron(np.eye(2), [[0.0], [1.0]])
    C = np.array([[5.0, 0, 5, 0], [5, 10, 10, 0]])
    plant = StateSpace(A, B, C, np.zeros((2, 2)))
    weights = append(*(StateSpace([[-1e-4 * w]], [[1.0]], [[w - 1e-4 * w / 1.5]], [[1 / 1.5]]) for w in corners))
    result = synthesize_hinf(output_shaping(plant, weights, gain(np.eye(2))), 2, 2)
    print(f"S&P 3.8, corners {corners}: gamma {result.gamma:.4f}")
    assert result.status.ok
    # printed to two decimals from a bisection of finite width: ours may be a little lower, being achieved, not higher
    assert gamma * 0.998 < result.gamma < gamma + 0.005
    assert agreement(result) < 1e-3


def test_slicot_sb10fd_central_controller():
    P, ny, nu, (gamma, _) = slicot("SB10FD")
    result = synthesize_hinf(P, ny, nu, gamma=gamma)
    assert result.status.ok
    np.testing.assert_allclose(result.controller.D, printed("SB10FD", "The controller matrix DK is", (2, 2)), atol=6e-5)
    real = printed("SB10FD", "The real parts of the closed-loop system poles are", (1, 12))
    imag = printed("SB10FD", "The imaginary parts of the closed-loop system poles are", (1, 12))
    ours, theirs = (np.sort_complex(p.ravel()) for p in (result.closed_loop_poles, real + 1j * imag))
    np.testing.assert_allclose(ours, theirs, rtol=1e-4)


def test_slicot_sb10dd_discrete_level():
    """The example's level 111.294 is feasible, one below the smallest is not."""
    P, ny, nu, (gamma, _) = slicot("SB10DD", rate_hz=1.0)
    at, free = synthesize_hinf(P, ny, nu, gamma=gamma), synthesize_hinf(P, ny, nu)
    print(f"SB10DD: smallest level {free.details['optimum']}")
    assert at.status.ok
    assert free.details["optimum"][1] <= gamma
    assert not synthesize_hinf(P, ny, nu, gamma=0.999 * free.details["optimum"][0]).status.ok


def random_problem(rng, n):
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 0.3 * np.eye(n)
    return StateSpace(A, rng.standard_normal((n, 5)), rng.standard_normal((5, n)), rng.standard_normal((5, 5)))


# Where no equation of the sampled problem can be solved near its optimum, the search stops as much above it, and its
# verdict says that it is not decided: by 1.4e-3 in 1 of 147 runs.
@pytest.mark.draws(false_alarm=0.02)
def test_reported_equals_achieved_and_time_does_not_matter(rng):
    """Random plants, stable or not, all direct terms full: continuous and discrete by the bilinear map."""
    worst, apart, solved = 0.0, 0.0, 0
    for _ in range(12):
        P = random_problem(rng, int(rng.integers(2, 12)))
        result = synthesize_hinf(P, 2, 2)
        sampled = StateSpace(*discretize.bilinear_to_discrete(P.A, P.B, P.C, P.D), rate_hz=10.0)
        other = synthesize_hinf(sampled, 2, 2)
        assert result.status.ok, result.status
        assert other.status.ok, other.status
        worst = max(worst, agreement(result), agreement(other))
        apart = max(apart, abs(other.gamma / result.gamma - 1))
        for one, another in ((result, other), (other, result)):  # what one calls out of reach is not reached by another
            assert one.details["optimum"][0] <= another.gamma * (1 + 1e-6)
        assert result.achieved <= result.details["bound"] * (1 + 1e-3)
        solved += 1
    print(f"{solved} random problems: reported against achieved {worst:.1e}, continuous against discrete {apart:.1e}")
    assert worst < 1e-3
    assert apart < 1e-3


def test_no_controller_found_by_chance_does_better(rng):
    """The optimum is a floor: static output feedbacks drawn at random never get below it."""
    P = random_problem(rng, 4)
    floor = synthesize_hinf(P, 2, 2).details["optimum"][0]
    for _ in range(300):
        assert hinf_norm(lft(P, gain(rng.standard_normal((2, 2)))))[0] > floor * (1 - 1e-6)


@pytest.mark.gate("S/KS")
@pytest.mark.parametrize("form", ["S/KS", "four-block"])
def test_units_and_coordinates_do_not_move_gamma(seed, form):
    """66 states and 18 of the weights: modal, against [q; q'] with inputs x 1e3 and outputs x 1e-6."""
    found = []
    for raw in (False, True):
        P = array_problem(form, array_like(np.random.default_rng(seed), 27, raw), raw)
        result = synthesize_hinf(P, 6, 6)
        assert result.status.ok, result.status
        assert agreement(result) < 1e-3
        assert np.abs(closed_poles(P, result.controller, 6, 6)).max() < 1
        found.append(result)
    one, other = found
    print(f"{form}: gamma {one.gamma:.6f} and {other.gamma:.6f}, achieved {one.achieved:.6f} and {other.achieved:.6f}")
    assert P.states == 84
    assert abs(other.gamma / one.gamma - 1) < 5e-3


def test_sizes_are_checked():
    with pytest.raises(InputError, match="measurements"):
        synthesize_hinf(bbmx(), 3, 1)


@pytest.mark.slow
def test_198_states(rng):
    """180 plant and 18 weight states, none of them in the second opinion unless asked."""
    P = array_problem("four-block", array_like(rng, 84))
    assert P.states == 198
    result = synthesize_hinf(P, 6, 6)
    print(f"198 states: gamma {result.gamma:.5f}, {agreement(result):.1e}, {result.details['probes']} levels tried")
    assert result.status.ok, result.status
    assert agreement(result) < 1e-3
    assert np.abs(closed_poles(P, result.controller, 6, 6)).max() < 1
    assert "second_opinion" not in result.details
