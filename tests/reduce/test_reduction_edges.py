"""Reductions of controllers that have nothing to give, or are not what they should be; budgets and certificates."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError, RateError
from ultraquiet.analyse import h2_norm, hinf_norm
from ultraquiet.linalg.balance import balancing_by, gramian_factors
from ultraquiet.linalg.cost import largest_order, multiply_adds
from ultraquiet.linalg.discretize import bilinear_to_discrete
from ultraquiet.reduce import Balanced, ClosedLoopWeighted, CoprimeFactors, FrequencyWeighted, HankelNorm
from ultraquiet.reduce.certificate import judging_plant
from ultraquiet.testing import problems
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append, feedback, gain, lft, parallel, series

METHODS = [Balanced, HankelNorm, FrequencyWeighted, CoprimeFactors, ClosedLoopWeighted]
every_method = pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)


@pytest.fixture
def loop(seed):
    plant = problems.damped_plant(seed)
    return plant, problems.observer_law(plant)


def random_stable(rng, n, nu, ny, rate_hz=None):
    A = rng.standard_normal((n, n))
    if rate_hz is None:
        A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.1, 1.0)) * np.eye(n)
    else:
        A *= rng.uniform(0.5, 0.95) / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(
        A, rng.standard_normal((n, nu)), rng.standard_normal((ny, n)), rng.standard_normal((ny, nu)), rate_hz
    )


def of_hankel_values(rng, values, nu, ny, rate_hz=None):
    """A stable system of given Hankel values, all different: every balanced one is so made, here in other axes."""
    n = len(values)
    B, C = rng.standard_normal((n, nu)), rng.standard_normal((ny, n))
    size = np.sqrt(values) * rng.uniform(0.5, 2.0, n)
    B *= (size / np.linalg.norm(B, axis=1))[:, None]
    C *= size / np.linalg.norm(C, axis=0)
    # off the diagonal of A P + P A' + B B' = 0 and A' P + P A + C' C = 0, P the diagonal of the values
    column, row = values[:, None], values[None, :]
    A = (row * (B @ B.T) - column * (C.T @ C)) / np.where(column == row, 1.0, column**2 - row**2)
    A[np.diag_indices(n)] = -np.sum(B * B, axis=1) / (2 * values)
    G = (A, B, C, rng.standard_normal((ny, nu)))
    A, B, C, D = G if rate_hz is None else bilinear_to_discrete(*G)
    turn, scale = np.linalg.qr(rng.standard_normal((n, n)))[0], 10 ** rng.uniform(-1, 1, n)
    T, inverse = turn * scale, (turn / scale).T
    return StateSpace(inverse @ A @ T, inverse @ B, C @ T, D, rate_hz)


def difference(first, second):
    return parallel(first, StateSpace(second.A, second.B, -second.C, -second.D, second.rate_hz))


@every_method
def test_no_more_states_are_kept_than_asked_for_and_all_of_them_are_the_controller(method, loop):
    plant, law = loop
    for states in (0, law.states - 1, law.states, law.states + 5):
        small = method(states=states).reduce(law, plant)
        assert small.controller.states <= states
        assert small.details["certificate"]["multiply_adds"] == multiply_adds(small.controller.states, 2, 2)
        stable = feedback(plant, small.controller).is_stable()
        assert (small.status.word != "unstable") == stable
        assert small.status.ok == (stable and not small.broken)
        if states >= law.states:
            assert small.status.ok
            assert problems.distance(law, small.controller) < 1e-6 * problems.distance(law)
            assert abs(small.loss) < 1e-6


@every_method
def test_a_gain_without_states_stays_what_it_is(method, loop):
    plant, _ = loop
    law = gain(-1e-3 * np.eye(2), plant.rate_hz)
    small = method(states=3).reduce(law, plant)
    np.testing.assert_allclose(small.controller.D, law.D, atol=1e-15)
    assert small.controller.states == 0
    assert small.status.ok


@every_method
def test_a_law_of_another_rate_or_size_is_refused(method, loop):
    plant, law = loop
    with pytest.raises(RateError, match="sampled"):
        method(states=2).reduce(StateSpace(law.A, law.B, law.C, law.D, rate_hz=1.0), plant)
    with pytest.raises(InputError, match="2 x 2"):
        method(states=2).reduce(StateSpace(law.A, law.B[:, :1], law.C, law.D[:, :1], law.rate_hz), plant)


@every_method
def test_states_that_do_nothing_are_dropped_without_loss(method, loop, rng):
    plant, law = loop
    n = law.states
    idle = 0.5 * np.eye(3)
    # neither driven nor read, driven only, read only
    A = np.block([[law.A, np.zeros((n, 3))], [np.zeros((3, n)), idle]])
    B = np.vstack([law.B, np.zeros((1, 2)), rng.standard_normal((1, 2)), np.zeros((1, 2))])
    C = np.hstack([law.C, np.zeros((2, 2)), rng.standard_normal((2, 1))])
    T = rng.standard_normal((n + 3, n + 3))
    same = StateSpace(np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, law.D, law.rate_hz)
    small = method(states=n).reduce(same, plant)
    off = problems.distance(law, small.controller) / problems.distance(law)
    print(f"{method.__name__}: {off:.1e}")
    assert off < 1e-5


@every_method
def test_an_unstable_law_is_reduced_beside_its_unstable_pole(method):
    """The plant and law of SLICOT's SB16AD: both unstable, the loop stable."""
    plant = StateSpace([[-1.0, 0, 4], [0, 2, 0], [0, 0, -3]], np.ones((3, 1)), np.ones((1, 3)), [[0.0]])
    A = [[-26.4, 6.4023, 4.3868], [32.0, 0, 0], [0, 8.0, 0]]
    law = StateSpace(A, [[-16.0], [0], [0]], [[9.2994, 1.1624, 0.109]], [[0.0]])
    assert feedback(plant, law).is_stable()
    assert not law.is_stable()
    small = method(states=2).reduce(law, plant)
    print(f"{method.__name__}: {small.status}")
    assert small.controller.states == 2
    assert not small.controller.is_stable()
    # plain balancing, which does not see the loop, loses it here; SLICOT's example is there to show that
    stable = feedback(plant, small.controller).is_stable()
    assert (small.status.word != "unstable") == stable
    assert small.status.ok == (stable and not small.broken)
    assert stable or method is Balanced


def test_an_unstable_loop_gives_no_weights(loop):
    plant = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)
    law = StateSpace([[0.1]], [[1.0]], [[5.0]], [[0.0]], rate_hz=1.0)
    for method in (FrequencyWeighted(states=0), ClosedLoopWeighted(states=0)):
        with pytest.raises(InputError, match="unstable"):
            method.reduce(law, plant)
    assert Balanced(states=1).reduce(law, plant).status.word == "unstable"


def test_weights_that_do_not_fit_are_refused(loop):
    _, law = loop
    for weights in (
        {"input": gain(np.eye(3), law.rate_hz)},
        {"output": StateSpace([[2.0]], np.ones((1, 2)), np.ones((2, 1)), np.eye(2), law.rate_hz)},
        {"output": gain(np.eye(2), None)},
    ):
        with pytest.raises(InputError, match="weight"):
            FrequencyWeighted(states=2).reduce(law, weights=weights)


def test_settings_that_contradict_are_refused(loop):
    plant, law = loop
    with pytest.raises(InputError, match="'states' or 'budget'"):
        ClosedLoopWeighted(states=3, budget=100)
    with pytest.raises(InputError, match="direct term"):
        ClosedLoopWeighted(budget=3).reduce(law, plant)
    with pytest.raises(InputError, match="plant"):
        ClosedLoopWeighted(states=3).reduce(law)


@pytest.mark.parametrize("rate_hz", [None, 10.0])
def test_hankel_norm_of_the_error_is_the_first_value_left_out(rate_hz, rng):
    for _ in range(10):
        n, nu, ny = (int(rng.integers(low, high)) for low, high in ((3, 12), (1, 4), (1, 4)))
        values = np.cumprod(rng.uniform(0.15, 0.9, n))  # the smallest some 1e-8 of the largest, far above round-off
        G = of_hankel_values(rng, values, nu, ny, rate_hz)
        for states in range(n):
            found = HankelNorm(states=states).reduce(G)
            assert found.controller.is_stable()
            assert found.controller.states == states
            np.testing.assert_allclose(found.hankel, values, rtol=0, atol=1e-8 * values[0])
            error = difference(G, found.controller)
            R, L = gramian_factors(error.A, error.B, error.C, rate_hz is not None)
            norm = float(balancing_by(R, L, 1)[2][0])
            assert abs(norm - values[states]) < 1e-7 * values[0]
            assert hinf_norm(error)[0] <= found.details["bound"] * (1 + 1e-6) + 1e-10 * values[0]


def test_hankel_values_that_are_equal_go_together():
    """Two copies of one lag have one Hankel value: both stay or leave, and the optimum has it as its norm."""
    lag = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    found = HankelNorm(states=1).reduce(append(lag, lag))
    assert found.controller.states == 0
    assert abs(hinf_norm(difference(append(lag, lag), found.controller))[0] - 0.5) < 1e-6


def test_budget_takes_the_largest_order_that_fits(loop):
    plant, law = loop
    budget = multiply_adds(4, 2, 2) + 5
    small = ClosedLoopWeighted(budget=budget).reduce(law, plant)
    assert small.controller.states == largest_order(budget, 2, 2) == 4
    assert small.details["certificate"]["multiply_adds"] <= budget
    assert ClosedLoopWeighted(budget=1400).reduce(law, plant).controller.states == law.states


@pytest.fixture(scope="module")
def heave():
    plant = uq.design.common_mode(uq.bench.Hexapod(unit="ground").linear_model())
    return plant, uq.design.BandAttenuation(band_hz=(9.0, 108.0), height=12.0).design(plant)


def test_budget_and_loss_together(heave):
    plant, result = heave
    weights = result.details["weights"]
    free = ClosedLoopWeighted(loss=0.05).reduce(result.controller, plant, weights)
    enough = multiply_adds(free.controller.states, 1, 1)
    held = ClosedLoopWeighted(loss=0.05, budget=enough).reduce(result.controller, plant, weights)
    assert held.status.ok
    assert held.controller.states <= free.controller.states
    short = ClosedLoopWeighted(loss=1e-4, budget=multiply_adds(6, 1, 1)).reduce(result.controller, plant, weights)
    print(f"{free.status}\n{held.status}\n{short.status}")
    assert not short.status.ok
    assert "budget" in short.status.sentence or "multiply-adds" in short.status.sentence


@pytest.mark.slow
def test_tuning_pays_where_projections_cost_too_much(heave):
    plant, result = heave
    weights = result.details["weights"]
    P = judging_plant(plant, weights)
    before = hinf_norm(lft(P, result.controller))[0]
    for states in (9,):
        plain = ClosedLoopWeighted(states=states, loss=1e-3, steps=0).reduce(result.controller, plant, weights)
        tuned = ClosedLoopWeighted(states=states, loss=1e-3).reduce(result.controller, plant, weights)
        again = hinf_norm(lft(P, tuned.controller))[0] / before - 1
        print(f"{states} states: {100 * plain.loss:.2f} % projected, {100 * tuned.loss:.2f} % tuned")
        assert tuned.loss <= plain.loss * (1 + 1e-9)
        assert abs(again - tuned.loss) < 1e-6
        assert tuned.loss < 0.7 * plain.loss or plain.loss < 1e-3


@pytest.mark.draws(false_alarm=0.1)  # 3 of 42 laws lose half a decibel of what else is promised, the control's gain
@pytest.mark.parametrize("rate_hz", [None, 1000.0])
def test_mean_square_is_judged_by_h2(rate_hz, rng):
    G = random_stable(rng, 6, 1, 1, rate_hz)
    G = StateSpace(G.A, G.B, G.C, np.zeros((1, 1)), rate_hz)
    K = random_stable(rng, 5, 1, 1, rate_hz)
    K = StateSpace(K.A, K.B * 0.05 / hinf_norm(K)[0], K.C / hinf_norm(G)[0], np.zeros((1, 1)), rate_hz)
    B, D = np.hstack([G.B, 0 * G.B, G.B]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    P = StateSpace(G.A, B, np.vstack([G.C, 0 * G.C, G.C]), D, rate_hz)
    small = ClosedLoopWeighted(states=3, norm="mean-square").reduce(K, G, P)
    before, after = h2_norm(lft(P, K)), h2_norm(lft(P, small.controller))
    assert abs(small.cost_before / before - 1) < 1e-9
    assert abs(small.cost_after / after - 1) < 1e-9
    assert after < 1.001 * before
    heard = StateSpace(P.A, P.B[:, 1:], P.C[1:], P.D[1:, 1:], rate_hz)  # from a sensor's noise to the command
    rise_db = 20 * np.log10(hinf_norm(lft(heard, small.controller))[0] / hinf_norm(lft(heard, K))[0])
    print(f"{small.status.word}: the control rises by {rise_db:.2f} dB")
    assert small.status.ok == (rise_db < 0.5)
    assert small.status.ok


def test_mean_square_of_a_direct_way_is_refused(rng):
    K, G = random_stable(rng, 2, 1, 1), StateSpace([[-1.0]], [[1.0]], [[1e-3]], [[0.0]])
    K = StateSpace(K.A, K.B / hinf_norm(K)[0], K.C, 0.1 + np.abs(K.D), None)
    with pytest.raises(InputError, match="infinite"):
        ClosedLoopWeighted(states=1, norm="mean-square").reduce(K, G)


@pytest.mark.slow
def test_tangled_modes_are_left_to_projection(loop):
    """A chain of delays cannot be split into modes; its reduction must still be certified."""
    plant, law = loop
    delay = append(*[StateSpace(np.eye(4, k=-1), np.eye(4, 1), np.eye(4)[3:], [[0.0]], law.rate_hz)] * 2)
    late = series(StateSpace(law.A, law.B, 0.05 * law.C, law.D, law.rate_hz), delay)
    assert feedback(plant, late).is_stable()
    small = ClosedLoopWeighted(states=law.states, loss=1e-6).reduce(late, plant)
    print(small.status)
    assert small.controller.states == law.states
    assert small.details["certificate"]["stable"] == feedback(plant, small.controller).is_stable()


def test_hankel_norm_keeps_every_state_that_it_is_asked_to_keep():
    """A mode of 1e-15 is round-off to a balanced form; with as many states as there are none is left out."""
    G = StateSpace(np.diag([-1.0, -2.0, -3.0]), [[1.0], [1.0], [1e-9]], [[1.0, 0.5, 1e-9]], [[0.0]])
    for states in (3, 5):
        result = HankelNorm(states=states).reduce(G)
        assert result.controller.states == 3
        np.testing.assert_array_equal(result.controller.A, G.A)
    assert HankelNorm(states=2).reduce(G).controller.states == 2


@pytest.mark.parametrize(("rate_hz", "norm"), [(None, "peak"), (1000.0, "peak"), (1000.0, "mean-square")])
def test_a_plant_that_integrates_has_no_response_at_rest_and_its_law_is_reduced(rate_hz, norm):
    """The grid of the loop had a line at rest, where nothing was a number, and the search ended with a LinAlgError."""
    plant = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    law = StateSpace(np.diag([-50.0, -3000.0]), [[1.0], [1.0]], [[-50.0, -30.0]], [[0.0]])
    if rate_hz is not None:
        plant = StateSpace([[1.0]], [[1e-3]], [[1.0]], [[0.0]], rate_hz)
        law = StateSpace(np.diag([0.95, 0.05]), [[1.0], [1.0]], [[-0.05, -0.01]], [[0.0]], rate_hz)
    result = ClosedLoopWeighted(1, steps=10, norm=norm).reduce(law, plant)
    assert result.status.word in ("ok", "loss"), result.status
    assert result.controller is not None
    assert result.controller.states == 1
    assert feedback(plant, result.controller).is_stable()


@pytest.mark.parametrize("method", METHODS[:3], ids=lambda m: m.__name__)
@pytest.mark.parametrize("rate_hz", [None, 100.0])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (3, 4), (5, 3)])
@pytest.mark.parametrize("unstable", [False, True])
def test_a_reduction_has_no_units_of_states(method, rate_hz, nu, ny, unstable, rng):
    G = random_stable(rng, 6, nu, ny, rate_hz)
    if unstable:  # turned round the boundary of stability, half of the poles are beyond it
        G = StateSpace(G.A * 1.5 if rate_hz else G.A + 0.8 * np.eye(6), G.B, G.C, G.D, rate_hz)
    d = 10.0 ** rng.uniform(-7, 7, 6)
    other = StateSpace(G.A * d / d[:, None], G.B / d[:, None], G.C * d, G.D, rate_hz)
    reduction = method(states=4)
    one, two = reduction.reduce(G), reduction.reduce(other)
    f_hz = np.array([0.1, 0.5, 2.0])
    first, second = (r.controller.frequency_response(f_hz) for r in (one, two))
    assert one.status.word == two.status.word
    assert np.abs(first - second).max() < 1e-6 * np.abs(first).max()
    if one.bound is not None:
        assert two.bound == pytest.approx(one.bound, rel=1e-6)


@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (3, 4), (5, 3)])
def test_an_optimal_approximation_has_no_axes_of_states(nu, ny, rng):
    G = of_hankel_values(rng, np.array([3.0, 1.0, 0.3, 0.1, 0.02]), nu, ny)
    turn = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    turned = StateSpace(turn.T @ G.A @ turn, turn.T @ G.B, G.C @ turn, G.D)
    one, two = (HankelNorm(states=3).reduce(each).controller for each in (G, turned))
    print(f"apart by {hinf_norm(difference(one, two))[0]:.1e} of {hinf_norm(one)[0]:.3g}")
    assert hinf_norm(difference(one, two))[0] < 1e-6 * hinf_norm(one)[0]


@pytest.mark.parametrize(("nu", "ny", "size"), [(1, 1, 1.0), (3, 4, 1e-9), (5, 3, 1e6)])
@pytest.mark.parametrize("rate_hz", [None, 100.0])
def test_an_unstable_reduction_of_a_stable_system_is_not_ok(rng, nu, ny, size, rate_hz):
    unstable = 0
    for _ in range(40):
        G = random_stable(rng, 4, nu, ny, rate_hz)
        G = StateSpace(G.A, G.B, size * G.C, size * G.D, rate_hz)
        weights = {"output": random_stable(rng, 3, ny, ny, rate_hz), "input": random_stable(rng, 3, nu, nu, rate_hz)}
        small = FrequencyWeighted(states=1).reduce(G, weights=weights)
        assert small.status.ok == small.controller.is_stable() == np.isfinite(small.details["weighted_error"])
        if not small.status.ok:
            unstable += 1
            assert small.status.word == "unstable"
            assert "guard=True" in small.status.sentence
            guarded = FrequencyWeighted(states=1, guard=True).reduce(G, weights=weights)
            assert guarded.status.ok
            assert guarded.controller.is_stable()
    print(f"{unstable} of 40 unstable without a guard")
