"""Reductions against numbers that nobody here produced: SLICOT's printed results, Varga and Anderson's examples."""

import re

import numpy as np
import pytest

from slicot_examples import SLICOT, numbers, printed
from ultraquiet.analyse import hinf_norm
from ultraquiet.reduce import Balanced, FrequencyWeighted, reduce_observer_based
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import parallel, series

PRINTED = 5e-5  # half a unit of the last of four printed decimals
DRAWS = 200


def example(name, sizes):
    """Return the matrices of a SLICOT example after its line of settings, each of the given shape."""
    values = numbers((SLICOT / f"{name}.dat").read_text().split("\n", 2)[2])
    out = []
    for rows, columns in sizes:
        out.append(np.reshape(values[: rows * columns], (rows, columns)))
        values = values[rows * columns :]
    return out


def plant_of(name):
    A, B, C = example(name, [(7, 7), (7, 2), (3, 7)])
    return StateSpace(A, B, C, np.zeros((3, 2)))


def answer(name, order, nu, ny, titles="ABCD"):
    """Return the reduced system that SLICOT prints."""
    shapes = {"A": (order, order), "B": (order, nu), "C": (ny, order), "D": (ny, nu)}
    text = (SLICOT / f"{name}.res").read_text()
    named = dict(zip("ABCD", ("dynamics", "input/state", "state/output", "input/output"), strict=True))
    out = {}
    for key in "ABCD":
        title = re.search(rf"The reduced (controller |)(state |){named[key]} matrix \w+ is", text)
        out[key] = printed(name, title.group(0), shapes[key]) if title and key in titles else np.zeros(shapes[key])
    return out


def within_rounding(system, printed_system, rng, what):
    """Assert that the response lies among those of the printed matrices with their last digit in doubt."""
    f_hz = np.geomspace(1e-3, 1e2, 40)
    centre = StateSpace(*(printed_system[k] for k in "ABCD")).frequency_response(f_hz)
    spread = np.zeros(f_hz.size)
    for _ in range(DRAWS):
        drawn = [m + PRINTED * rng.choice([-1.0, 1.0], m.shape) * (m != 0) for m in printed_system.values()]
        error = np.linalg.norm(StateSpace(*drawn).frequency_response(f_hz) - centre, axis=(0, 1))
        spread = np.maximum(spread, error)
    off = np.linalg.norm(system.frequency_response(f_hz) - centre, axis=(0, 1))
    print(f"{what}: off by {np.max(off / spread):.2f} of what the printed digits leave open")
    assert np.all(off <= spread)


@pytest.mark.parametrize(
    ("name", "method", "slowest"),
    [
        ("AB09AD", "truncation", 0.0),
        ("AB09BD", "perturbation", 0.0),
        ("AB09MD", "truncation", 0.6),
        ("AB09ND", "perturbation", 0.6),
    ],
)
def test_balanced_examples_of_slicot(name, method, slowest, rng):
    G = plant_of(name)
    result = Balanced(states=5, method=method, slowest_hz=slowest / (2 * np.pi)).reduce(G)
    values = printed(name, "are", (1, result.hankel.size))[0]
    np.testing.assert_allclose(result.hankel, values, atol=PRINTED)
    expected = answer(name, 5, 2, 3)
    within_rounding(result.controller, expected, rng, name)


def test_frequency_weighted_example_of_slicot(rng):
    A, B, C, D, Av, Bv, Cv, Dv = example("AB09ID", [(3, 3), (3, 1), (1, 3), (1, 1), (6, 6), (6, 1), (1, 6), (1, 1)])
    V = StateSpace(Av, Bv, Cv, Dv)
    result = FrequencyWeighted(states=2).reduce(StateSpace(A, B, C, D), weights={"output": V})
    np.testing.assert_allclose(result.hankel, printed("AB09ID", "part are", (1, 2))[0], atol=PRINTED)
    within_rounding(result.controller, answer("AB09ID", 2, 1, 1), rng, "AB09ID")


def test_controller_weighted_by_its_loop_as_slicot(rng):
    A, B, C, D, Ac, Bc, Cc, Dc = example("SB16AD", [(3, 3), (3, 1), (1, 3), (1, 1), (3, 3), (3, 1), (1, 3), (1, 1)])
    G, K = StateSpace(A, B, C, D), StateSpace(Ac, Bc, Cc, Dc)
    result = FrequencyWeighted(states=2, loop="stability").reduce(K, G)
    print(result.status)
    np.testing.assert_allclose(result.hankel, printed("SB16AD", "part are", (1, 2))[0], atol=PRINTED)
    within_rounding(result.controller, answer("SB16AD", 2, 1, 1), rng, "SB16AD")


def observer_example(name):
    A, B, C, D, F, L = example(name, [(8, 8), (8, 1), (1, 8), (1, 1), (1, 8), (8, 1)])
    return StateSpace(A, B, C, D), F, L


def test_weighted_right_coprime_factors_as_slicot(rng):
    """SLICOT's controller has the opposite sign: it is meant for negative feedback."""
    small, hankel = reduce_observer_based(*observer_example("SB16CD"), 2, "right", weighted=True)
    np.testing.assert_allclose(hankel, printed("SB16CD", "are:", (1, 8))[0], atol=PRINTED)
    within_rounding(negative(small), answer("SB16CD", 2, 1, 1), rng, "SB16CD")


def test_left_coprime_factors_as_slicot_but_for_a_sign(rng):
    """SLICOT prints Ar - Br Cr where the observer has Ar + Br Cr; the factors are the same.

    That the sign here is the right one shows where all states are kept: the controller comes back.
    """
    G, F, L = observer_example("SB16BD")
    _, hankel = reduce_observer_based(G, F, L, 4, "left")
    np.testing.assert_allclose(hankel, printed("SB16BD", "are:", (1, 8))[0], atol=PRINTED)
    factors = StateSpace(G.A + L @ G.C, np.hstack([L, G.B + L @ G.D]), F, np.zeros((1, 2)))
    reduced = Balanced(states=4).reduce(factors).controller
    theirs = StateSpace(reduced.A - reduced.B[:, 1:] @ reduced.C, reduced.B[:, :1], reduced.C, G.D)
    within_rounding(theirs, answer("SB16BD", 4, 1, 1), rng, "SB16BD with its sign")


def test_all_states_give_the_controller_back():
    for name, side, weighted in [(n, s, w) for n in ("SB16BD",) for s in ("left", "right") for w in (False, True)]:
        G, F, L = observer_example(name)
        small, _ = reduce_observer_based(G, F, L, 8, side, weighted=weighted)
        full = StateSpace(G.A + G.B @ F + L @ G.C, -L, F, G.D)
        f_hz = np.geomspace(1e-3, 1.0, 50)
        np.testing.assert_allclose(small.frequency_response(f_hz), full.frequency_response(f_hz), rtol=1e-6)


def negative(G):
    return StateSpace(G.A, G.B, -G.C, -G.D, G.rate_hz)


def weighted_error(G, small, V, W):
    return hinf_norm(series(series(W, parallel(G, negative(small))), V))[0]


def test_first_example_of_varga_and_anderson():
    """Automatica 39 (2003) 919: G = (8 s2 + 6 s + 2) / (s3 + 4 s2 + 5 s + 2), W = 1 / (s + 3), V = 1 / (s + 4)."""
    A, B = [[-4.0, -5.0, -2.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[1.0], [0.0], [0.0]]
    G = StateSpace(A, B, [[8.0, 6.0, 2.0]], [[0.0]])
    W, V = (StateSpace([[-p]], [[1.0]], [[1.0]], [[0.0]]) for p in (3.0, 4.0))
    result = FrequencyWeighted(states=1, method="perturbation").reduce(G, weights={"input": W, "output": V})
    K, error = result.controller, weighted_error(G, result.controller, V, W)
    pole, direct = -K.A[0, 0], K.D[0, 0]
    constant = direct * pole + (K.C @ K.B)[0, 0]
    print(f"error {error:.5f}, Gr = ({direct:.4f} s + {constant:.4f}) / (s + {pole:.4f})")
    np.testing.assert_allclose([direct, constant, pole], [2.398, 1.739, 1.739], atol=5e-4)
    assert abs(error - 0.0855) <= PRINTED
    assert abs(result.details["weighted_error"] / error - 1) < 1e-6


@pytest.mark.parametrize(
    ("method", "published"), [("truncation", (2.12, 0.265, 0.112)), ("perturbation", (1.405, 0.25, 0.065))]
)
def test_third_example_of_varga_and_anderson(method, published):
    A, B = np.diag([-1.0, -2.0, -3.0, -4.0]), np.array([[0, 5], [0.5, -1.5], [1, -5], [-0.5, 1 / 6]])
    G = StateSpace(A, B, np.array([[1, 0, 1, 0], [4 / 15, 1, 0, 1]]), np.zeros((2, 2)))
    one = np.eye(2)
    W = StateSpace(-4.5 * one, 3 * one, 1.5 * one, one)
    for states, figure in zip((1, 2, 3), published, strict=True):
        small = FrequencyWeighted(states=states, method=method).reduce(G, weights={"input": W, "output": W}).controller
        error = weighted_error(G, small, W, W)
        print(f"{method} to {states}: error {error:.4f}, published {figure}")
        # the published figures have two or three digits, some cut and not rounded
        assert abs(error / figure - 1) < 0.012
