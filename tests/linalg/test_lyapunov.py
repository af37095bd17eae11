"""Lyapunov and Stein equations at their edges, judged by residuals formed here and by exact answers."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.equations import lyapunov, lyapunov_both, stein, stein_factor

HUGE = 1e120


def left_continuous(A, Q, X):
    terms = (A @ X, X @ A.T, Q)
    return np.linalg.norm(sum(terms)) / sum(np.linalg.norm(t) for t in terms)


def left_discrete(A, Q, X):
    terms = (A @ X @ A.T, -X, Q)
    return np.linalg.norm(sum(terms)) / sum(np.linalg.norm(t) for t in terms)


def test_no_states():
    nothing = np.zeros((0, 0))
    assert lyapunov(nothing, nothing).shape == (0, 0)
    assert stein(nothing, nothing).shape == (0, 0)
    assert stein_factor(nothing, np.zeros((0, 2))).shape == (0, 0)


@pytest.mark.parametrize("inputs", [1, 3, 9])
def test_a_factor_holds_the_solution_and_its_smallest_values(rng, inputs):
    turn = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    # one state for each input, of sizes whose squares are beyond all digits
    size = 10.0 ** -np.arange(0, 12, 2)
    a = rng.uniform(0.1, 0.9, 6)
    B = turn @ np.diag(size)
    exact = np.sort(size / np.sqrt(1 - a**2))
    R = stein_factor(turn @ np.diag(a) @ turn.T, B)
    np.testing.assert_allclose(np.sort(np.linalg.svd(R, compute_uv=False)), exact, rtol=1e-9, atol=1e-14)
    A, B = 0.9 * np.linalg.qr(rng.standard_normal((6, 6)))[0], rng.standard_normal((6, inputs))
    R = stein_factor(A, B)
    assert R.shape == (6, 6)
    np.testing.assert_allclose(R @ R.T, stein(A, B @ B.T), atol=1e-12 * float(np.sum(B * B)))


@pytest.mark.parametrize("margin", [1.0, 1e-6, 1e-12])
def test_one_state_however_near_the_boundary(margin):
    np.testing.assert_allclose(lyapunov(np.array([[-margin]]), np.array([[3.0]])), [[1.5 / margin]], rtol=1e-12)
    a = 1 - margin if margin < 1 else 0.0
    # of 1 - a^2 no more than the digits of a are left
    np.testing.assert_allclose(stein(np.array([[a]]), np.array([[3.0]])), [[3 / ((1 - a) * (1 + a))]], rtol=1e-3)


@pytest.mark.parametrize("size", [1.0, HUGE, 1 / HUGE])
def test_huge_and_tiny_costs(rng, size):
    A = 0.4 * np.linalg.qr(rng.standard_normal((6, 6)))[0]
    V = rng.standard_normal((6, 6))
    Q = V @ V.T * size
    for solve, M in ((stein, A), (lyapunov, A - np.eye(6))):
        X, scaled = solve(M, V @ V.T), solve(M, Q) / size
        # of a covariance: an entry in which the terms cancel has the digits of its two states, not of its own
        spread = np.sqrt(np.diag(X))
        assert np.all(np.abs(scaled - X) <= 1e-12 * np.outer(spread, spread))


def test_states_in_units_of_their_own(rng):
    """Units spread over forty decades: entry by entry the same solution."""
    n = 8
    A = 0.6 * np.linalg.qr(rng.standard_normal((n, n)))[0]
    V = rng.standard_normal((n, n))
    Q = V @ V.T
    d = 2.0 ** rng.integers(-66, 66, n)
    for solve, M in ((stein, A), (lyapunov, A - np.eye(n))):
        X, other = solve(M, Q), solve(M * d[:, None] / d, Q * np.outer(d, d))
        assert np.abs(other / np.outer(d, d) - X).max() < 1e-10 * np.abs(X).max()


@pytest.mark.parametrize("length", [2, 8, 20])
def test_defective_matrices(length):
    """A Jordan block has no basis of eigenvectors; the continuous one's first entry is known exactly."""
    block = np.eye(length, k=1)
    Q = np.zeros((length, length))
    Q[-1, -1] = 1.0
    A = block - np.eye(length)
    X = lyapunov(A, Q)
    # x_1(t) = t^(n-1) e^-t / (n-1)!, so X_11 = (2n-2)! / ((n-1)!^2 2^(2n-1))
    exact = np.prod([(2 * k - 1) / (2 * k) for k in range(1, length)]) / 2
    np.testing.assert_allclose(X[0, 0], exact, rtol=1e-10)
    assert left_continuous(A, Q, X) < 1e-13
    F = block + 0.3 * np.eye(length)
    assert left_discrete(F, Q, stein(F, Q)) < 1e-13


def test_lightly_damped_modes(rng):
    """Damping of 1e-9: the residual stays that of double precision."""
    worst = 0.0
    for _ in range(20):
        w = rng.uniform(1, 100, 5)
        A = np.zeros((10, 10))
        for k, wk in enumerate(w):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-1e-9 * wk, wk], [-wk, -1e-9 * wk]]
        turn = np.linalg.qr(rng.standard_normal((10, 10)))[0]
        A = turn @ A @ turn.T
        V = rng.standard_normal((10, 3))
        worst = max(worst, left_continuous(A, V @ V.T, lyapunov(A, V @ V.T)))
    print(f"Lyapunov equation of modes damped by 1e-9: worst residual {worst:.1e}")
    assert worst < 1e-12


def test_unstable_and_undamped_equations(rng):
    """The continuous equation has a solution for unstable A too; neither has one on the boundary."""
    A = rng.standard_normal((5, 5)) + 4 * np.eye(5)
    assert left_continuous(A, np.eye(5), lyapunov(A, np.eye(5))) < 1e-12
    with pytest.raises(NumericalError, match="share an eigenvalue"):
        lyapunov(np.zeros((1, 1)), np.eye(1))
    with pytest.raises(NumericalError, match="share an eigenvalue"):
        lyapunov(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2))
    for radius in (1.0, 1.5):
        for solve in (stein, stein_factor):
            with pytest.raises(NumericalError, match="unit circle"):
                solve(np.array([[radius]]), np.eye(1))


def test_matrices_that_overflow_are_refused():
    for solve in (lyapunov, stein, stein_factor):
        with pytest.raises(NumericalError, match="overflow"):
            solve(np.array([[np.inf]]), np.eye(1))


@pytest.mark.parametrize("n", [1, 2, 47, 49, 120])
def test_both_equations_from_one_schur_form(n, rng):
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
    B, C = rng.standard_normal((n, 2)), rng.standard_normal((3, n))
    X, Y = lyapunov_both(A, B @ B.T, C.T @ C)
    P, Q = lyapunov(A, B @ B.T), lyapunov(A.T, C.T @ C)
    assert np.linalg.norm(X - P) <= 1e-9 * np.linalg.norm(P)
    assert np.linalg.norm(Y - Q) <= 1e-9 * np.linalg.norm(Q)
    units = 10 ** rng.uniform(-9, 9, n)
    moved, _ = lyapunov_both(A * units / units[:, None], (B @ B.T) / np.outer(units, units), np.eye(n))
    assert np.linalg.norm(moved * np.outer(units, units) - P) <= 1e-6 * np.linalg.norm(P)


def test_an_eigenvalue_shared_with_its_mirror_is_said():
    with pytest.raises(NumericalError, match="share an eigenvalue"):
        lyapunov_both(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2), np.eye(2))


@pytest.mark.parametrize("A", [np.diag([1.0, -1.0]), np.zeros((1, 1)), np.eye(2, k=1), np.array([[1e9, 5], [0, -1e9]])])
def test_a_pair_that_cancels_is_no_equation_whatever_a_perturbed_one_gives(A):
    """LAPACK moves the pair apart by round-off and solves that: for Q = I the answer looks like any other."""
    for solve in (lyapunov, lambda A, Q: lyapunov_both(A, Q, Q)):
        with pytest.raises(NumericalError, match="share an eigenvalue"):
            solve(A, np.eye(len(A)))


def test_poles_far_apart_in_speed_are_no_pair():
    A = np.diag([-1e-7, -1e12])
    np.testing.assert_allclose(np.diag(lyapunov(A, np.eye(2))), [0.5e7, 0.5e-12], rtol=1e-12)


def test_a_term_that_is_faint_is_not_the_last_where_a_chain_makes_much_of_it(rng):
    """y = x1 + 1e-10 x2, x1 gone after a sample, x2 the end of a chain that multiplies: the terms grow again."""
    length = 8
    A = np.zeros((length + 1, length + 1))
    turn = np.linalg.qr(rng.standard_normal((length, length)))[0]  # no other units make the chain a tame one
    A[1:, 1:] = turn @ (30.0 * np.eye(length, k=1)) @ turn.T
    C = np.concatenate([[1.0], 1e-10 * turn[:, 0]])[None]
    X, row = np.zeros(A.shape), C
    for _ in range(400):
        X, row = X + row.T @ row, row @ A
    found, factor = stein(A.T, C.T @ C), stein_factor(A.T, C.T)
    print(f"{np.trace(X):.6g}, of which {np.trace(found):.6g} was found")
    assert np.trace(X) > 4  # of which x1 alone makes one
    for Y in (found, factor @ factor.T):
        np.testing.assert_allclose(Y, X, atol=1e-4 * X.max())


def test_states_that_count_for_little_keep_their_digits_beside_those_that_count_for_much(rng):
    """No scaling brings parts together that do not meet; what an output reads of the lesser may be all that counts."""
    fast, slow = (r * np.linalg.qr(rng.standard_normal((3, 3)))[0] for r in (0.2, 0.9))
    A, B = block_diag(fast, slow), np.vstack([rng.standard_normal((3, 2)), 1e-12 * rng.standard_normal((3, 2))])
    solved, R = stein(A, B @ B.T), stein_factor(A, B)
    for part, r in ((slice(0, 3), 0.2), (slice(3, 6), 0.9)):
        exact = np.sum(B[part] ** 2) / (1 - r**2)  # trace of the sum of A^k B B' A'^k, A orthogonal but for r
        for X in (solved, R @ R.T):
            np.testing.assert_allclose(np.trace(X[part, part]), exact, rtol=1e-12)
