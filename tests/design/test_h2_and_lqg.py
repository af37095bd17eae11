"""H2 and LQG: promised against achieved, SLICOT's examples, optimality, recovery."""

import numpy as np
import pytest
from named_plants import bench_like

from slicot_examples import printed, slicot
from ultraquiet._base.errors import InputError
from ultraquiet.analyse import h2_norm
from ultraquiet.design import Lqg, synthesize_h2
from ultraquiet.values import StateSpace, SteppedController
from ultraquiet.values.interconnect import feedback, lft

PAPER = {"disturbance_at": "input", "band_hz": None, "control_weight": 1e-2}


def test_slicot_sb10ed_discrete_h2():
    P, ny, nu, _ = slicot("SB10ED", rate_hz=1.0)
    result = synthesize_h2(P, ny, nu)
    K = result.controller
    np.testing.assert_allclose(K.D, printed("SB10ED", "The controller matrix DK is", (2, 2)), atol=6e-5)
    markov = [printed("SB10ED", f"The controller {k} matrix", s) for k, s in (("input", (6, 2)), ("output", (2, 6)))]
    np.testing.assert_allclose(K.C @ K.B, markov[1] @ markov[0], atol=1e-3)
    assert abs(result.gamma / result.achieved - 1) < 1e-9


def test_slicot_sb10hd_continuous_h2():
    P, ny, nu, _ = slicot("SB10HD")
    result = synthesize_h2(P, ny, nu)
    B = printed("SB10HD", "The controller input matrix BK is", (6, 2))
    C = printed("SB10HD", "The controller output matrix CK is", (2, 6))
    np.testing.assert_allclose(result.controller.C @ result.controller.B, C @ B, atol=5e-2)
    assert abs(result.gamma / result.achieved - 1) < 1e-9


def test_promised_equals_achieved_with_every_direct_term(rng):
    """Random discrete problems with D11, D12, D21 and D22 all full: the current-innovation term is exact."""
    worst = 0.0
    for _ in range(10):
        n = int(rng.integers(2, 10))
        A = rng.standard_normal((n, n)) / np.sqrt(n)
        D = rng.standard_normal((6, 6))
        D[-2:, -2:] *= 0.1
        P = StateSpace(A, rng.standard_normal((n, 6)), rng.standard_normal((6, n)), D, rate_hz=1.0)
        result = synthesize_h2(P, 2, 2)
        assert result.status.ok, result.status
        worst = max(worst, abs(result.gamma / result.achieved - 1))
    print(f"H2, promised against achieved: {worst:.1e}")
    assert worst < 1e-6


def test_no_neighbour_of_the_h2_controller_is_better(rng):
    P, ny, nu, _ = slicot("SB10ED", rate_hz=1.0)
    best = synthesize_h2(P, ny, nu)
    K = best.controller
    for _ in range(40):
        near = StateSpace(
            *(m + 1e-3 * rng.standard_normal(m.shape) * (np.abs(m).max() + 0.1) for m in (K.A, K.B, K.C, K.D)),
            rate_hz=1.0,
        )
        assert h2_norm(lft(P, near)) >= best.achieved * (1 - 1e-9)


@pytest.mark.gate("settings0", "settings3")
@pytest.mark.parametrize(
    "settings",
    [{}, PAPER, PAPER | {"band_hz": (10.0, 100.0)}, PAPER | {"estimator": "predicted"}, PAPER | {"recovery": 1e3}],
)
def test_lqg_on_a_bench(rng, settings):
    plant = bench_like(rng, 9)
    result = Lqg(**settings, disk_margin=0.0).design(plant)
    print(f"LQG {settings}: {result.status}, promised {result.gamma:.6g}, achieved {result.achieved:.6g}")
    assert result.status.ok
    assert np.abs(result.closed_loop_poles).max() < 1
    # promised in modal coordinates, achieved in those of the plant as given
    assert abs(result.gamma / result.achieved - 1) < 1e-4
    assert max(result.residuals.values()) < 1e-8
    if settings.get("estimator") == "predicted":
        assert not np.any(result.controller.D)


def test_lqg_law_runs_sample_by_sample_as_designed(rng):
    """u[k] = C x[k] + D y[k] in the loop gives the poles that the design states."""
    plant = bench_like(rng, 3)
    result = Lqg(**PAPER).design(plant)
    law = SteppedController(result.controller)
    closed = feedback(plant, result.controller)
    x = rng.standard_normal(plant.states)
    states = np.concatenate([x, np.zeros(result.controller.states)])
    run, stated = [], []
    for _ in range(20_000):
        u = law.step(plant.C @ x)
        x = plant.A @ x + plant.B @ u
        states = closed.A @ states
        run.append(x)
        stated.append(states[: plant.states])
    # the slowest pole may take longer than any run to fade: that it does as stated is asked, not how far it has got
    sizes = np.linalg.norm(stated, axis=1)
    off = np.linalg.norm(np.subtract(run, stated), axis=1).max() / sizes.max()
    rho = np.abs(result.closed_loop_poles).max()
    print(f"off by {off:.1e} of the largest, slowest pole {rho:.6f}, {sizes[-1] / sizes[0]:.1e} of the first left")
    assert off < 1e-12  # 5e-16 at most in 52 draws
    assert rho < 1
    np.testing.assert_allclose(np.abs(closed.poles()).max(), rho, rtol=1e-9)


def test_current_estimator_is_never_worse(rng):
    plant = bench_like(rng, 5)
    current, predicted = (Lqg(**PAPER, estimator=e).design(plant).achieved for e in ("current", "predicted"))
    assert current <= predicted * (1 + 1e-9)


def test_recovery_works_without_delay_and_is_reported_to_fail_with_it(rng):
    """A minimum-phase lag is recovered; two samples of delay keep the error up however large the factor."""
    lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    errors = [Lqg(**PAPER, recovery=q).design(lag).details["recovery"]["relative_error"].max() for q in (1.0, 1e4)]
    late = bench_like(rng, 4)
    stuck = Lqg(**PAPER, recovery=1e4).design(late).details["recovery"]["relative_error"].max()
    print(f"recovery error of a lag {errors[0]:.3f} -> {errors[1]:.4f}; with two samples of delay {stuck:.2f}")
    assert errors[1] < 0.05 < errors[0]
    assert stuck > 0.5


def test_recovery_factors_below_one_are_refused():
    with pytest.raises(InputError, match="recovery"):
        Lqg(recovery=0.5)


def test_continuous_plants_are_refused():
    with pytest.raises(InputError, match="continuous"):
        Lqg().design(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))


@pytest.mark.parametrize("rate_hz", [None, 10.0])
@pytest.mark.parametrize(("nu", "ny"), [(1, 1), (3, 4), (5, 3)])
def test_the_best_law_has_no_units_of_controls_and_measurements(rng, rate_hz, nu, ny):
    n, q = 4, nu + ny
    A = rng.standard_normal((n, n))
    A = 0.9 * A / np.abs(np.linalg.eigvals(A)).max() if rate_hz else A - 3 * np.eye(n)
    D = np.zeros((q + ny, q + nu))
    D[:nu, q:], D[q:, :ny] = rng.standard_normal((nu, nu)), rng.standard_normal((ny, ny))
    P = StateSpace(A, rng.standard_normal((n, q + nu)), rng.standard_normal((q + ny, n)), D, rate_hz)
    u, y = np.ones(q + nu), np.ones(q + ny)
    u[q:], y[q:] = 10.0 ** rng.uniform(-9, 9, nu), 10.0 ** rng.uniform(-9, 9, ny)
    other = StateSpace(A, P.B * u, P.C * y[:, None], D * u * y[:, None], rate_hz)
    one, two = (synthesize_h2(plant, ny, nu) for plant in (P, other))
    assert one.status.ok, one.status
    assert two.status.ok, two.status
    assert two.achieved == pytest.approx(one.achieved, rel=1e-6)
    f = np.array([0.01, 0.3, 2.0])
    law, same = (r.controller.frequency_response(f) for r in (one, two))
    off = same * u[q:, None, None] * y[None, q:, None] - law
    assert np.abs(off).max() < 1e-6 * np.abs(law).max()


def test_a_disturbance_that_is_measured_and_matched_costs_nothing(rng):
    for nu in (1, 2, 3) * 4:
        A = rng.standard_normal((4, 4))
        A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
        B, W, C = rng.standard_normal((4, nu)), rng.standard_normal((nu, nu)), rng.standard_normal((5, 4))
        D = np.block([[np.zeros((5, 2 * nu))], [np.eye(nu), np.zeros((nu, nu))]])
        P = StateSpace(A, np.hstack([B @ W, B]), np.vstack([C, np.zeros((nu, 4))]), D, 10.0)
        result = synthesize_h2(P, nu, nu)
        assert result.status.ok, result.status
        assert 0 <= result.gamma < 1e-5
        assert result.achieved < 1e-9


def test_a_control_that_does_nothing_is_refused():
    P = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), [[1, 0, 0], [0, 1, 0]], 10.0)
    result = synthesize_h2(P, 1, 1)
    assert result.status.word == "refused"
    assert "costs nothing and moves nothing" in result.status.sentence


def test_what_is_no_system_is_refused_by_name():
    with pytest.raises(InputError, match="synthesize_h2: 'P' must be a StateSpace"):
        synthesize_h2(None, 1, 1)  # pyright: ignore[reportArgumentType]
