"""The CAREX and DAREX collections: every equation solved, judged here, or refused with a sentence."""

from pathlib import Path

import numpy as np
import pytest

from slicot_examples import SLICOT, numbers, printed
from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg import equations

DATA = np.load(Path(__file__).parents[1] / "data" / "riccati_collections.npz")
CASES = sorted({key[:-2] for key in DATA.files})
RESIDUAL = 1e-9  # relative to the sizes of the terms
# CAREX 11 at its limit: the closed loop has a pair on the axis, so no solution stabilises but for round-off.
UNDAMPED = "carex_11"


def real(M):
    """Return the real matrix that stands for a complex one, of twice the size."""
    return np.block([[M.real, -M.imag], [M.imag, M.real]])


def case(name):
    """Return A, B, Q, R and S (zero when absent) of a case, real."""
    A, B, Q, R = (np.atleast_2d(DATA[f"{name}_{k}"]) for k in "ABQR")
    S = DATA[f"{name}_S"] if f"{name}_S" in DATA.files else np.zeros(B.shape)
    matrices = (A, B, Q, R, S)
    if any(np.iscomplexobj(M) for M in matrices):
        matrices = tuple(real(M) for M in matrices)
    return tuple(np.asarray(M, dtype=float) for M in matrices)


def continuous_errors(A, B, Q, R, S, X, E=None):
    """Return the relative residual of the continuous equation and the largest real part of the closed loop."""
    E = np.eye(len(A)) if E is None else E
    K = np.linalg.solve(R, B.T @ X @ E + S.T)
    terms = (A.T @ X @ E, E.T @ X @ A, -(E.T @ X @ B + S) @ K, Q)
    poles = np.linalg.eigvals(np.linalg.solve(E, A - B @ K))
    return np.linalg.norm(sum(terms)) / sum(np.linalg.norm(t) for t in terms), poles.real.max()


def discrete_errors(A, B, Q, R, S, X, E=None):
    """Return the relative residual of the discrete equation and the largest modulus of the closed loop."""
    E = np.eye(len(A)) if E is None else E
    K = np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A + S.T)
    terms = (A.T @ X @ A, -E.T @ X @ E, -(A.T @ X @ B + S) @ K, Q)
    poles = np.linalg.eigvals(np.linalg.solve(E, A - B @ K))
    size = sum(np.linalg.norm(t) for t in terms)
    return np.linalg.norm(sum(terms)) / (size or 1.0), np.abs(poles).max() - 1


CONTINUOUS = (equations.continuous_regulator, continuous_errors)
DISCRETE = (equations.discrete_riccati, discrete_errors)


def solved(name):
    """Return residual and distance beyond the stability boundary, None when the case is refused."""
    matrices = case(name)
    solve, errors = CONTINUOUS if name.startswith("carex") else DISCRETE
    try:
        found = solve(*matrices)
    except NumericalError:  # says who it is: that is tested where refusals are certain
        return None
    return errors(*matrices, found.X)


def test_every_case_is_solved_or_refused():
    outcome = {name: solved(name) for name in CASES}
    done = {name: found for name, found in outcome.items() if found is not None}
    refused = sorted(set(outcome) - set(done))
    worst = max(done, key=lambda name: done[name][0])
    print(f"CAREX, DAREX and SciPy's own: {len(done)} solved, {len(refused)} refused {refused}")
    print(f"largest relative residual {done[worst][0]:.1e}, of {worst}")
    for name, (residual, beyond) in done.items():
        assert residual < RESIDUAL, f"{name}: residual {residual:.1e}"
        assert beyond < 0, f"{name}: beyond the boundary by {beyond:.1e}"
    assert set(refused) <= {UNDAMPED}


def test_the_undamped_limit_is_refused_or_right():
    A, B, Q, R, S = case(UNDAMPED)
    try:
        found = equations.continuous_regulator(A, B, Q, R, S)
    except NumericalError:
        return
    np.testing.assert_allclose(found.X, [[2, 1], [1, 1]], atol=1e-6)
    assert found.margin < 1e-6, "it must own up to a loop that is all but undamped"


def test_scipys_equation_without_a_solution_is_refused():
    """No stabilising solution: arXiv:1505.04861, with an indefinite R."""
    A = np.triu(np.ones((3, 3)))
    A[0, 1] = -1
    B = np.array([[1.0, 1, 0], [0, 0, 1]]).T
    Q = np.full_like(A, -2) + np.diag([8, -1, -1.9])
    with pytest.raises(NumericalError, match="Riccati equation"):
        equations.continuous_regulator(A, B, Q, np.diag([-10, 0.1]))


@pytest.mark.parametrize("name", ["SB02MD", "SB02RD"])
def test_slicot_in_both_times(name):
    """A, Q and G as the examples give them; continuous as they say, and the discrete equation of the same data."""
    lines = (SLICOT / f"{name}.dat").read_text().splitlines()
    A, Q, G = (np.array([numbers(line) for line in lines[k : k + 2]]) for k in (2, 4, 6))
    X = equations.continuous_riccati(A, G, Q).X
    np.testing.assert_allclose(X, printed(name, "The solution matrix X is", (2, 2)), atol=5e-5)
    B = np.array([[0.0], [1.0]])
    np.testing.assert_array_equal(B @ B.T, G)
    matrices = (A, B, Q, np.eye(1), np.zeros((2, 1)))
    residual, beyond = discrete_errors(*matrices, equations.discrete_riccati(*matrices).X)
    assert residual < 1e-14
    assert beyond < 0


def test_slicot_sb02od_with_a_factored_cost():
    values = numbers(" ".join((SLICOT / "SB02OD.dat").read_text().splitlines()[2:]))
    A, B = np.reshape(values[:4], (2, 2)), np.reshape(values[4:6], (2, 1))
    C, D = np.reshape(values[6:12], (3, 2)), np.reshape(values[12:15], (3, 1))
    X = equations.continuous_regulator(A, B, C.T @ C, D.T @ D, C.T @ D).X
    np.testing.assert_allclose(X, printed("SB02OD", "The solution matrix X is", (2, 2)), atol=5e-5)


def test_slicot_sg02ad_with_a_descriptor():
    values = numbers(" ".join((SLICOT / "SG02AD.dat").read_text().splitlines()[2:]))
    A, E, B = np.reshape(values[:4], (2, 2)), np.reshape(values[4:8], (2, 2)), np.reshape(values[8:10], (2, 1))
    C, D = np.reshape(values[10:16], (3, 2)), np.reshape(values[16:19], (3, 1))
    X = equations.continuous_regulator(A, B, C.T @ C, D.T @ D, C.T @ D, E).X
    np.testing.assert_allclose(X, printed("SG02AD", "The solution matrix X is", (2, 2)), atol=5e-5)


def test_descriptors_of_any_kind(rng):
    """Random E and S, equations in units spread over six decades: residuals of the equation with E."""
    worst = 0.0
    for _ in range(20):
        n, m = int(rng.integers(1, 15)), int(rng.integers(1, 4))
        A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((2, n))
        A *= rng.uniform(0.5, 1.2) / np.abs(np.linalg.eigvals(A)).max()
        turns = [np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2)]
        # condition of up to a hundred, whose square is lost in X
        E = turns[0] * 10 ** (rng.uniform(-1, 1, n)) @ turns[1] * 10 ** rng.uniform(-3, 3, (n, 1))
        D = rng.standard_normal((2, m))
        Q, S, R = C.T @ C + np.eye(n), 0.1 * C.T @ D, D.T @ D + np.eye(m)
        shift = np.linalg.eigvals(A).real.max() - 0.1  # unstable, but not in many directions at once
        for (solve, errors), F in ((CONTINUOUS, A - shift * np.eye(n)), (DISCRETE, A)):
            X = solve(E @ F, E @ B, Q, R, S, E).X
            residual, beyond = errors(E @ F, E @ B, Q, R, S, X, E)
            worst = max(worst, residual)
            assert beyond < 0
    print(f"Riccati equations with descriptor: worst residual {worst:.1e}")
    assert worst < 1e-9


def test_singular_descriptors_are_refused():
    E = np.array([[1.0, 0.0], [1e-3, 0.0]])
    for solve in (equations.continuous_regulator, equations.discrete_riccati):
        with pytest.raises(NumericalError, match="E is singular"):
            solve(0.5 * np.eye(2), np.eye(2), np.eye(2), np.eye(2), None, E)
