"""D-K synthesis: a textbook column, bounds recomputed on the finished loop, plants of the family drawn, refusals."""

import numpy as np
import pytest
from scipy.optimize import minimize

from ultraquiet._base.errors import InputError
from ultraquiet.analyse import hinf_norm, mu_bounds
from ultraquiet.design import MuSynthesis
from ultraquiet.design.mu import dk_iteration
from ultraquiet.linalg import magnitude_fit
from ultraquiet.linalg.magnitude_fit import fit_near
from ultraquiet.testing import problems
from ultraquiet.values import StateSpace
from ultraquiet.values.generalised import uncertain
from ultraquiet.values.interconnect import append, gain, lft, sensitivity, series

# Skogestad and Postlethwaite 2005, section 8.12.4: a distillation column, minutes as the unit of time, w_I =
# (s + 0.2) / (0.5 s + 1), w_P = (s / 2 + 0.05) / s, the integrator moved to 1e-6. The book's D-K iteration ends at
# 1.019 and quotes 0.974, the least that Lundstroem found; nobody proved it the least there is, and on processors where
# rounding turns the iteration another way it ends at 0.952, which `mu_by_hand` confirms.
COLUMN = StateSpace(-np.eye(2) / 75, np.eye(2) / 75, [[0.878, -0.864], [1.082, -1.096]], np.zeros((2, 2)))
W_INPUT = StateSpace([[-2.0]], [[1.0]], [[-3.6]], [[2.0]])
W_PERFORMANCE = StateSpace([[-1e-6]], [[1.0]], [[0.05]], [[0.5]])
BEST_KNOWN, BOOK = 0.974, 1.019
SETTINGS = {"on_inputs": W_INPUT, "performance": W_PERFORMANCE, "control_limit": None, "margin": 1.005}


def column_loop(controller):
    """Return the loop that the errors and the performance see, and its blocks."""
    P = uncertain(COLUMN, append(W_INPUT, W_INPUT), None, append(W_PERFORMANCE, W_PERFORMANCE))
    return lft(P, controller), (1, 1, 2)


def mu_by_hand(controller, w):
    """Return mu at w, rad/min, from the formula: least largest singular value over scalings of the two errors.

    N = [w_I K S G, w_I K S; w_P S G, w_P S] with S = (I - G K)^-1. For three full blocks the bound is mu itself.
    """
    s, eye = 1j * w, np.eye(2)
    G = np.array([[0.878, -0.864], [1.082, -1.096]]) / (75 * s + 1)
    K = controller.C @ np.linalg.solve(s * np.eye(controller.A.shape[0]) - controller.A, controller.B) + controller.D
    S = np.linalg.inv(eye - G @ K)
    w_I, w_P = (s + 0.2) / (0.5 * s + 1), (s / 2 + 0.05) / (s + 1e-6)
    N = np.block([[w_I * K @ S @ G, w_I * K @ S], [w_P * S @ G, w_P * S]])

    def scaled(logs):
        d = np.exp([*logs, 0, 0])
        return np.linalg.norm(d[:, None] * N / d, 2)

    starts = ([-4.0, -4.0], [0.0, 0.0], [-8.0, -8.0])
    accuracy = {"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000}
    return min(minimize(scaled, start, method="Nelder-Mead", options=accuracy).fun for start in starts)


def judged(result):
    """Print and check the promises of a result on the column; return mu's peak on a grid of the test's own."""
    loop, blocks = column_loop(result.controller)
    bounds = mu_bounds(loop, blocks, np.geomspace(1e-6, 10, 400))
    first, *_, last = result.details["mu"]
    print(f"{result.status}\nmu by iteration {np.round(result.details['mu'], 3)}; on the test's grid", end=" ")
    print(f"{bounds.upper.max():.4f}, lower bound {bounds.lower.max():.4f}; best known {BEST_KNOWN}, book's D-K {BOOK}")
    assert result.status.ok
    assert loop.is_stable()
    assert result.details["mu_peak"] == pytest.approx(min(result.details["mu"]), rel=1e-3)
    assert bounds.upper.max() <= result.details["mu_peak"] * (1 + 1e-3)
    peak = result.details["mu_peak"]
    lines = 2 * np.pi * np.append(np.geomspace(1e-6, 10, 30), result.details["mu_peak_hz"])
    assert max(mu_by_hand(result.controller, w) for w in lines) == pytest.approx(peak, rel=1e-4)
    assert abs(result.gamma / result.achieved - 1) < 1e-3
    assert last > 0
    return bounds.upper.max(), first


@pytest.mark.slow
def test_column_beats_plain_h_infinity():
    peak, first = judged(MuSynthesis(**SETTINGS, iterations=4).design(COLUMN))
    assert peak < 1.12
    assert first > 4 * peak


@pytest.mark.slow
def test_column_reaches_the_books_iteration():
    # last digits decide which way the search goes: it was below the book's figure after 16 iterations or after 18
    peak, _ = judged(MuSynthesis(**SETTINGS, iterations=24, scaling_order=6).design(COLUMN))
    assert peak <= BOOK


@pytest.mark.slow
def test_every_drawn_plant_keeps_what_mu_promises(rng):
    """Errors scaled to 1 / mu: stable loops whose weighted sensitivity stays below mu, for every draw."""
    plant = problems.damped_plant(3)
    design = MuSynthesis(on_inputs=(0.1, 100.0, 1.5), on_outputs=0.1, height=1.5, order=2, iterations=2)
    result = design.design(plant)
    print(result.status)
    assert result.status.ok
    weights, mu = result.details["weights"], result.details["mu_peak"]
    assert result.details["robust_stability"] < 1
    worst = 0.0
    for _ in range(30):
        errors = []
        for name in ("on_inputs", "on_outputs"):
            parts = []
            for _ in range(2):
                a, sign = rng.uniform(-0.99, 0.99), rng.choice([-1.0, 1.0])
                b = np.sqrt(1 - a * a)
                parts.append(StateSpace([[a]], [[b]], [[sign * b / mu]], [[-sign * a / mu]], plant.rate_hz))
            E = series(weights[name], append(*parts))
            errors.append(StateSpace(E.A, E.B, E.C, E.D + np.eye(2), E.rate_hz))
        off = series(series(errors[0], plant), errors[1])
        S = sensitivity(off, result.controller)
        assert S.is_stable()
        worst = max(worst, hinf_norm(series(S, weights["performance"]))[0])
    print(f"mu {mu:.3f}; worst weighted sensitivity of 30 plants {worst:.3f}")
    assert worst <= mu * (1 + 1e-6)


@pytest.mark.slow
def test_discrete_scalings_are_fitted_and_lower_mu():
    plant = problems.damped_plant(0)
    result = MuSynthesis(on_inputs=(0.3, 60.0, 3.0), height=1.5, order=2, iterations=3).design(plant)
    print(f"{result.status}\nmu by iteration {np.round(result.details['mu'], 3)}, {result.details['scaling_orders']}")
    assert result.details["mu_peak"] <= result.details["mu"][0] * (1 + 1e-6)
    assert result.controller.rate_hz == plant.rate_hz
    assert np.all(result.details["mu_lower"] <= result.details["mu_upper"] * (1 + 1e-9))


def test_too_much_uncertainty_is_owned_up_to():
    shaky = StateSpace([[1.2]], [[1.0]], [[1.0]], [[0.0]], 100.0)
    result = MuSynthesis(on_inputs=3.0, performance=0.1, iterations=1).design(shaky)
    print(result.status)
    assert result.status.word == "not robust"
    assert result.details["robust_stability"] >= 1


def test_mistakes_name_the_block():
    plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 1000.0)
    with pytest.raises(InputError, match="the weight 'on_inputs' has a pole on the unit circle"):
        MuSynthesis(on_inputs=StateSpace([[1.0]], [[1.0]], [[1.0]], [[1.0]], 1000.0)).design(plant)
    with pytest.raises(InputError, match="the weight 'on_outputs' is in continuous time"):
        MuSynthesis(on_outputs=gain([[0.1]])).design(plant)
    with pytest.raises(InputError, match="'iterations'"):
        MuSynthesis(iterations=0)
    hidden = StateSpace(np.diag([1.1, 0.5]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]], 1000.0)
    refused = MuSynthesis().design(hidden)
    print(refused.status)
    assert refused.controller is None
    assert not refused.status.ok


def test_fit_near_finds_a_filter_again(rng):
    w = np.geomspace(0.1, 100, 80)
    zeta, corner, pole = rng.uniform(0.3, 0.9), rng.uniform(1, 10), rng.uniform(0.5, 50)
    truth = np.abs((corner**2 - w**2 + 2j * zeta * corner * w) / (1j * w + pole) ** 2)
    W = fit_near(w, truth, 2, np.ones(80))
    s = 1j * w[:, None]
    found = np.abs(W.gain * np.prod(s - W.zeros, axis=1) / np.prod(s - W.poles, axis=1))
    error = np.abs(np.log(found / truth)).max()
    print(f"second-order filter found again to {error:.1e}")
    assert error < 0.02
    assert np.all(W.poles.real < 0)
    assert np.all(W.zeros.real < 0)


@pytest.mark.slow
def test_each_loop_is_fitted_once_and_idle_gains_end_the_search(monkeypatch):
    """A lag that turns its sign every sample: nothing is quiet at any gain, and nine gains were iterated for it."""
    fitted, tried = [], []
    every, attempt = dk_iteration.fitted_of_every_order, MuSynthesis._attempt
    monkeypatch.setattr(dk_iteration, "fitted_of_every_order", lambda *a: fitted.append(a[1]) or every(*a))
    monkeypatch.setattr(MuSynthesis, "_attempt", lambda self, even, g: tried.append(g) or attempt(self, even, g))
    plant = StateSpace([[1.5, -0.6], [1.0, 0.0]], [[1.0], [0.0]], [[0.2, -0.6]], [[1.0]], 100.0)
    result = MuSynthesis().design(plant)
    print(f"{result.status.word} at gain {result.details['gain']:g} of {tried}; {len(fitted)} fits")
    assert result.status.word == "short"
    assert result.details["gain"] == tried[-2]  # of laws that do nothing, rounding does not say which
    assert len(tried) <= 4
    assert len({id(bounds) for bounds in fitted}) == len(fitted)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_slopes_of_a_gain_are_those_of_its_differences(rng, order):
    x, p, step = np.geomspace(0.01, 50.0, 40), rng.uniform(-1, 1, 1 + 2 * order), 1e-6
    slopes = magnitude_fit._slopes(p, x, order)
    for k, turn in enumerate(step * np.eye(p.size)):
        ahead, behind = (magnitude_fit._log_gain(p + sign * turn, x, order) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, k], (ahead - behind) / (2 * step), atol=1e-8)


def test_what_is_set_to_nothing_is_not_taken_for_absent():
    lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], 100.0)
    with pytest.raises(InputError, match=r"^MuSynthesis: the weight 'on_inputs' must be .* above zero.*, got 0"):
        MuSynthesis(on_inputs=0, height=3.0).design(lag)
    with pytest.raises(InputError, match=r"^MuSynthesis: 'roll_off_hz' .* 'control_limit'"):
        MuSynthesis(roll_off_hz=20.0)
