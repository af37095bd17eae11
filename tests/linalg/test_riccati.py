"""Riccati and Lyapunov equations: known answers, residuals over random draws, refusals."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg import equations

CASES = 30


def stable(rng, n, spread=1.0):
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    return A - (np.linalg.eigvals(A).real.max() + 0.02 + spread * rng.uniform()) * np.eye(n)


def lightly_damped(rng, modes):
    w, zeta = rng.uniform(1, 100, modes), 10 ** rng.uniform(-4, -1, modes)
    A = np.zeros((2 * modes, 2 * modes))
    for k in range(modes):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, w[k]], [-w[k], -2 * zeta[k] * w[k]]]
    return A


def test_slicot_sb02md_double_integrator():
    A, G, Q = np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, 1.0]), np.diag([1.0, 2.0])
    np.testing.assert_allclose(equations.continuous_riccati(A, G, Q).X, [[2, 1], [1, 2]], atol=5e-5)


def test_slicot_sb02od():
    A, G, Q = np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, 1.0]), np.eye(2)
    np.testing.assert_allclose(equations.continuous_riccati(A, G, Q).X, [[1.7321, 1], [1, 1.7321]], atol=5e-5)


def test_random_continuous_equations_are_solved_to_their_condition(rng):
    worst = 0.0
    for _ in range(CASES):
        n = int(rng.integers(1, 60))
        A, B, C = stable(rng, n), rng.standard_normal((n, 3)), rng.standard_normal((2, n))
        found = equations.continuous_riccati(A, B @ B.T, C.T @ C)
        X = solve_continuous_are(A, B, C.T @ C, np.eye(3))
        worst = max(worst, found.residual, np.linalg.norm(found.X - X) / np.linalg.norm(X))
        assert found.margin > 0
    print(f"continuous Riccati: worst residual or difference from SciPy {worst:.1e}")
    assert worst < 1e-8


def test_indefinite_equation_of_h_infinity(rng):
    """A'X + XA - X (B2 B2' - B1 B1' / g^2) X + C'C = 0, g well above its smallest value."""
    for _ in range(CASES):
        A = lightly_damped(rng, 10)
        n = A.shape[0]
        B1, B2, C = rng.standard_normal((n, 2)), rng.standard_normal((n, 2)), rng.standard_normal((2, n))
        g = 1e3 * np.linalg.norm(B1) * np.linalg.norm(C)
        found = equations.continuous_riccati(A, B2 @ B2.T - B1 @ B1.T / g**2, C.T @ C)
        assert found.residual < 1e-8
        assert found.margin > 0
        assert np.linalg.eigvalsh(found.X)[0] > -1e-8 * np.linalg.norm(found.X)


def test_zero_cost_gives_zero_solution(rng):
    A = stable(rng, 6)
    assert not np.any(equations.continuous_riccati(A, np.eye(6), np.zeros((6, 6))).X)


@pytest.mark.parametrize("mixed", [True, False])
@pytest.mark.parametrize("unstable", [1, 2, 3])
def test_without_a_cost_the_unstable_modes_are_turned_over_and_all_others_stay(rng, unstable, mixed):
    """Slow stable modes, one thrice over, beside fast ones."""
    there = np.array([0.08, 0.3, 1.7])[:unstable]
    poles = np.concatenate([there, [-8e-4, -8e-4, -8e-4, -1e-3, -4e-3], -np.geomspace(0.02, 80.0, 22)])
    n = len(poles)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-1, 1, n) if mixed else np.eye(n)
    A = T @ np.diag(poles) @ np.linalg.inv(T)
    B = rng.standard_normal((n, 3)) * 10 ** rng.uniform(-3, 1, (n, 1))
    solved = equations.continuous_riccati(A, B @ B.T, np.zeros((n, n)))
    # In modal coordinates X is P^-1 on the unstable modes, P of the Cauchy form of a diagonal Lyapunov equation.
    V = np.linalg.inv(T).T[:, :unstable]
    P = (V.T @ B @ B.T @ V) / (there[:, None] + there[None, :])
    X = V @ np.linalg.solve(P, V.T)
    error = np.linalg.norm(solved.X - X) / np.linalg.norm(X)
    closed = np.sort(np.linalg.eigvals(A - B @ B.T @ solved.X).real)
    print(f"{unstable} unstable: off by {error:.1e}, margin {solved.margin:.2e}")
    assert error < 1e-9
    assert closed == pytest.approx(np.sort(-np.abs(poles)), rel=1e-2, abs=1e-5)
    assert closed.max() < 0


@pytest.mark.parametrize("scale", [1.0, 1e6, 1e-6])
def test_units_do_not_matter(rng, scale):
    A = lightly_damped(rng, 8)
    n = A.shape[0]
    B, C = rng.standard_normal((n, 2)), rng.standard_normal((2, n))
    T = np.diag(scale ** rng.uniform(-1, 1, n))
    Ti = np.linalg.inv(T)
    X = equations.continuous_riccati(A, B @ B.T, C.T @ C).X
    Xs = equations.continuous_riccati(Ti @ A @ T, Ti @ B @ B.T @ Ti, T @ C.T @ C @ T).X
    np.testing.assert_allclose(Ti @ Xs @ Ti, X, atol=1e-6 * np.linalg.norm(X))


def test_random_discrete_equations(rng):
    worst = 0.0
    for _ in range(CASES):
        n = int(rng.integers(1, 60))
        A = rng.standard_normal((n, n)) / np.sqrt(n)
        A *= rng.uniform(0.3, 0.999) / np.abs(np.linalg.eigvals(A)).max()
        B, C = rng.standard_normal((n, 2)), rng.standard_normal((3, n))
        S = 0.01 * rng.standard_normal((n, 2))
        Q, R = C.T @ C + 0.01 * np.eye(n), np.eye(2)
        found = equations.discrete_riccati(A, B, Q, R, S)
        X = solve_discrete_are(A, B, Q, R, s=S)
        worst = max(worst, found.residual, np.linalg.norm(found.X - X) / np.linalg.norm(X))
        assert found.margin > 0
    print(f"discrete Riccati: worst residual or difference from SciPy {worst:.1e}")
    assert worst < 1e-8


def test_an_unstable_mode_out_of_reach_is_refused():
    A, G = np.diag([1.0, -1.0]), np.diag([0.0, 1.0])
    with pytest.raises(NumericalError, match="Riccati equation"):
        equations.continuous_riccati(A, G, np.eye(2))


def test_an_undamped_mode_out_of_reach_is_refused():
    A = np.array([[0.0, 1.0], [-1.0, 0.0]])
    with pytest.raises(NumericalError, match="Riccati equation"):
        equations.continuous_riccati(A, np.zeros((2, 2)), np.eye(2))


def test_stein_and_lyapunov_fulfil_their_equations(rng):
    for _ in range(CASES):
        n = int(rng.integers(1, 40))
        A = stable(rng, n)
        Q = rng.standard_normal((n, n))
        Q = Q @ Q.T
        X = equations.lyapunov(A, Q)
        assert np.linalg.norm(A @ X + X @ A.T + Q) < 1e-9 * np.linalg.norm(X) * np.linalg.norm(A)
        F = A / (np.abs(np.linalg.eigvals(A)).max() * rng.uniform(1.0001, 2))
        X = equations.stein(F, Q)
        assert np.linalg.norm(F @ X @ F.T + Q - X) < 1e-9 * np.linalg.norm(X)


def test_stein_refuses_the_unit_circle():
    with pytest.raises(NumericalError, match="unit circle"):
        equations.stein(np.array([[1.0]]), np.array([[1.0]]))


def test_matrices_that_overflow_are_refused():
    with pytest.raises(NumericalError, match="overflow"):
        equations.continuous_riccati(-np.eye(1), np.full((1, 1), np.inf), np.eye(1))


def test_an_all_but_undamped_oscillator_with_a_faint_cost():
    """A = [0, 1; -1, 0], B = [0; 1], Q = q I: X -> sqrt(2 q) I, closed-loop damping sqrt(q / 2), as q goes to zero."""
    A, G = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.diag([0.0, 1.0])
    for q in (1e-20, 1e-12, 1e-4):
        X = equations.continuous_riccati(A, G, q * np.eye(2)).X
        # the damping is known to the round-off of A
        np.testing.assert_allclose(X, np.sqrt(2 * q) * np.eye(2), rtol=1e-4, atol=2 * q)


def test_a_double_integrator_beside_fast_poles_is_solved_to_round_off():
    """Terms of the size |A||X| cancel in front of the slow states: what is left is their round-off, no refusal."""
    A = np.diag([-3e2, -1e-3, 0.0, 0.0])
    A[2, 3] = 1e-2
    B, C = np.array([[1.0], [1.0], [0.0], [1e-3]]), 1e2 * np.eye(4)
    for scale in (1.0, 1e-9, 1e9):
        found = equations.continuous_riccati(A, B @ B.T * scale, C.T @ C / scale)
        assert found.margin > 0
        assert found.backward < 1e-14


@pytest.mark.slow
def test_four_hundred_unstable_states(rng):
    A, B, C = rng.standard_normal((400, 400)) / 20, rng.standard_normal((400, 40)), rng.standard_normal((40, 400))
    for found in (
        equations.continuous_riccati(A, B @ B.T, C.T @ C),
        equations.discrete_riccati(2 * A, B, C.T @ C, np.eye(40)),
    ):
        print(f"400 states: left of the terms {found.residual:.1e}, of their moduli {found.backward:.1e}")
        assert found.margin > 0
        assert found.backward < 1e-12


def test_units_of_states_change_nothing(rng):
    A, B, C = rng.standard_normal((60, 60)) / 8, rng.standard_normal((60, 4)), rng.standard_normal((4, 60))
    A -= 0.7 * np.eye(60)  # a fifth of the poles unstable: X is known to eight digits, not to three
    d = 10 ** rng.uniform(-6, 6, 60)
    plain = equations.continuous_riccati(A, B @ B.T, C.T @ C)
    other = equations.continuous_riccati(A * d / d[:, None], (B / d[:, None]) @ (B / d[:, None]).T, (C * d).T @ (C * d))
    np.testing.assert_allclose(other.margin, plain.margin, rtol=1e-7)
    assert other.backward < 1e-14
