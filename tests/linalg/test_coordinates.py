"""Modal coordinates, balancing, the bilinear map, sampling and delay."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from ultraquiet.linalg import balance, discretize, modal_response, response


def plant(rng, modes=8, channels=3):
    w, zeta = np.sort(rng.uniform(1, 50, modes)), rng.uniform(0.001, 0.1, modes)
    A = block_diag(*[[[0, w[k]], [-w[k], -2 * zeta[k] * w[k]]] for k in range(modes)])
    n = 2 * modes
    return A, rng.standard_normal((n, channels)), rng.standard_normal((channels, n)), np.zeros((channels, channels))


def mixed(rng, M):
    T = rng.standard_normal(M[0].shape)
    Ti = np.linalg.inv(T)
    return Ti @ M[0] @ T, Ti @ M[1], M[2] @ T, M[3]


def test_modal_form_keeps_the_response_and_evens_the_sizes(rng):
    A, B, C, D = mixed(rng, plant(rng))
    form = balance.modal(A, B, C)
    z = 1j * np.geomspace(0.1, 100, 50)
    before = response.frequency_response(A, B, C, D, z)
    after = response.frequency_response(form.A, form.B, form.C, D, z)
    np.testing.assert_allclose(after, before, atol=1e-7 * np.abs(before).max())
    assert max(form.blocks) == 2
    ratio = np.linalg.norm(form.B, axis=1) / np.linalg.norm(form.C, axis=0)
    assert ratio.max() / ratio.min() < 1e3


def test_delays_and_repeated_poles_stay_together(rng):
    """Nilpotent blocks have no basis of eigenvectors; a modal form that pretends so loses all digits."""
    A, B, C, D = plant(rng, modes=3)
    delay = discretize.delay(3, 3)
    A = block_diag(0.01 * A + 0.9 * np.eye(6), delay[0])
    B, C = np.vstack([B, delay[1]]), np.hstack([C, delay[2]])
    form = balance.modal(A, B, C)
    assert np.linalg.cond(form.T / np.linalg.norm(form.T, axis=0)) < 1e9
    z = np.exp(1j * np.linspace(0, np.pi, 40))
    before = response.frequency_response(A, B, C, D, z)
    np.testing.assert_allclose(response.frequency_response(form.A, form.B, form.C, D, z), before, atol=1e-8)


def test_modal_response_is_that_of_the_triangular_kernel(rng):
    A, B, C, D = mixed(rng, plant(rng))
    z = 1j * np.geomspace(0.1, 100, 200)
    fast, slow = modal_response.residues(A, B, C, D).at(z), response.frequency_response(A, B, C, D, z)
    np.testing.assert_allclose(fast, slow, atol=1e-7 * np.abs(slow).max())


@pytest.mark.parametrize("spread", [6, 9, 20])
def test_a_response_does_not_depend_on_the_units_of_states(spread, rng):
    """Not even on units that row by row and column by column look near to even, and do not when taken together."""
    A, B, C, D = mixed(rng, plant(rng))
    units = np.exp2(rng.integers(-spread, spread + 1, len(A)))
    z = 1j * np.geomspace(0.1, 100, 200)
    expected = response.frequency_response(A, B, C, D, z)
    A, B, C = A * units / units[:, None], B / units[:, None], C * units
    for found in (response.frequency_response(A, B, C, D, z), modal_response.residues(A, B, C, D).at(z)):
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def crowded(rng, ny, nu, rate_hz=5e4):
    """Three poles within 2 % of 0.3 rad/s, five decades below the sampling rate, and two fast ones; units at random."""
    companion = np.poly(-0.3 * (1 + rng.uniform(0, 0.02, 3)))
    slow = np.eye(3) + np.vstack([-companion[1:], np.eye(2, 3)]) / rate_hz
    B = rng.standard_normal((5, nu)) / rate_hz * 10.0 ** rng.uniform(-5, 5, nu)
    return block_diag(slow, 0.5 * np.eye(2)), B, rng.standard_normal((ny, 5)) * 10.0 ** rng.uniform(-5, 5, (ny, 1))


@pytest.mark.parametrize("shape", [(1, 1), (4, 3), (3, 5)])
@pytest.mark.parametrize("draw", range(4))
def test_a_verified_response_is_that_of_dense_solves_where_poles_crowd(shape, draw):
    """Modes by themselves are off by as much as the response itself, at a condition that says nothing of it."""
    A, B, C = crowded(np.random.default_rng(draw), *shape)
    z = np.exp(2j * np.pi * np.geomspace(1e-3, 10, 60) / 5e4)
    found = modal_response.splitting(A, B, C, discrete=True).beside(np.zeros(shape)).at(z)
    expected = np.moveaxis(C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, B.astype(complex)), 0, 2)
    size = np.abs(expected).max(axis=2, keepdims=True)
    assert np.abs((found - expected) / size).max() < 1e-7


@pytest.mark.parametrize("discrete", [True, False])
def test_modes_that_agree_with_direct_solves_are_kept(rng, discrete):
    """Of light modes, of undamped ones and an integrator, and of a system without states."""
    w = np.array([0.01, 0.2, 0.5])
    for damping in (1e-2, 1e-9, 0.0):
        s = w * (-damping + 1j)
        pairs = np.exp(s) if discrete else s
        A = block_diag(*([[p.real, p.imag], [-p.imag, p.real]] for p in pairs), [[float(discrete)]])
        Q = np.linalg.qr(rng.standard_normal((7, 7)))[0]
        A, B, C, D = Q @ A @ Q.T, rng.standard_normal((7, 3)), rng.standard_normal((2, 7)), np.zeros((2, 3))
        assert modal_response.splitting(A, B, C, discrete).beside(D).rest is None
    nothing = modal_response.splitting(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), discrete)
    nothing = nothing.beside(np.ones((2, 3)))
    assert np.array_equal(nothing.at(np.array([1j])), np.ones((2, 3, 1)))


def test_what_is_lost_far_below_a_direct_term_costs_no_direct_solves():
    """What vanishes at 0 Hz is left to rounding there; beside a one, as in a sensitivity, nothing of it is missed."""
    poles, moved = 0.999 * np.exp(1j * np.array([0.01, 0.02, 0.3])), np.ones((6, 1))
    A = block_diag(*([[p.real, p.imag], [-p.imag, p.real]] for p in poles))
    held = np.linalg.solve(np.eye(6) - A, moved)
    blocked = np.linalg.qr(np.hstack([held, np.linalg.solve(np.eye(6) - A, held)]))[0]
    C = np.random.default_rng(1).standard_normal((1, 6))
    C = np.hstack([C - (C @ blocked) @ blocked.T, [[1.0]]])
    # a pole that nothing moves is why anyone looks there
    both = modal_response.splitting(block_diag(A, 1 - 1e-9), np.vstack([moved, [[0.0]]]), C, discrete=True)
    assert both.beside(np.zeros((1, 1))).rest is not None
    assert both.beside(np.ones((1, 1))).rest is None


def test_a_double_pole_that_rounding_makes_a_pair_is_not_split():
    """1 / s^2 + 3 / s with an entry of round-off under the diagonal, which has a pair of poles at +-1e-17j."""
    A = np.array([[8e-17, 1.0], [-5e-35, 7e-17]])
    form = balance.Coordinates(A, np.array([[0.0], [1.0]]), np.array([[1.0, 3.0]]), np.eye(2), np.eye(2), (2,))
    z = 1j * np.geomspace(0.1, 10, 20)
    np.testing.assert_allclose(modal_response.split(form, np.zeros((1, 1))).at(z)[0, 0], z**-2 + 3 / z, rtol=1e-12)


def test_bilinear_map_and_back_is_the_identity(rng):
    M = plant(rng)
    back = discretize.bilinear_to_continuous(*discretize.bilinear_to_discrete(*M))
    for one, other in zip(M, back, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-9 * max(1, np.abs(one).max()))


def test_bilinear_map_keeps_the_response(rng):
    M = plant(rng)
    w = np.geomspace(0.01, 100, 60)
    before = response.frequency_response(*M, 1j * w)
    after = response.frequency_response(*discretize.bilinear_to_discrete(*M), np.exp(2j * np.arctan(w)))
    np.testing.assert_allclose(after, before, atol=1e-8 * np.abs(before).max())


def test_tustin_is_exact_where_asked(rng):
    M, f = plant(rng), 3.3
    sampled = discretize.tustin(*M, rate_hz=50.0, exact_hz=f)
    before = response.frequency_response(*M, np.array([2j * np.pi * f]))
    after = response.frequency_response(*sampled, np.exp(np.array([2j * np.pi * f / 50.0])))
    np.testing.assert_allclose(after, before, atol=1e-9 * np.abs(before).max())


def test_zero_order_hold_is_scipys(rng):
    M = plant(rng)
    theirs = cont2discrete(M, 0.01)
    for one, other in zip(discretize.zero_order_hold(*M, 0.01), theirs[:4], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_delay_delays():
    A, B, C, D = discretize.delay(2, 2)
    u = np.random.default_rng(0).standard_normal((2, 9))
    y = response.simulate(A, B, C, D, u, np.zeros(4))
    np.testing.assert_array_equal(y[:, 2:], u[:, :-2])


def test_balanced_truncation_keeps_glovers_bound(rng):
    for _ in range(10):
        A, B, C, D = plant(rng)
        P, Q = balance.gramians(A, B, C, discrete=False)
        left, right, hankel = balance.balancing(P, Q, 8)
        np.testing.assert_allclose(left @ right, np.eye(8), atol=1e-8)
        small = balance.truncate((A, B, C, D), left, right)
        z = 1j * np.geomspace(0.1, 200, 800)
        error = response.frequency_response(A, B, C, D, z) - response.frequency_response(*small, z)
        worst = np.linalg.norm(np.moveaxis(error, 2, 0), 2, axis=(1, 2)).max()
        assert worst <= 2 * hankel[8:].sum() * (1 + 1e-6)


def test_small_blocks_of_tied_poles_are_written_out(rng):
    """Twins of a pair, a double real pole and a delay beside single modes, for real systems and complex directions."""
    pair = np.array([[0.5, 0.6], [-0.6, 0.5]])
    twins = np.block([[pair, np.eye(2)], [np.zeros((2, 2)), pair]])
    A = block_diag(0.9 * pair, twins, [[0.3, 1.0], [0.0, 0.3]], discretize.delay(3, 1)[0], [[-0.7]])
    n, sizes, z = len(A), (2, 4, 2, 3, 1), np.exp(1j * np.linspace(0, np.pi, 50))
    for real in (1, 0):
        B, C, D = (rng.standard_normal(s) + 1j * (1 - real) * rng.standard_normal(s) for s in ((n, 3), (2, n), (2, 3)))
        B, C, D = (m.real if real else m for m in (B, C, D))
        terms = modal_response.split(balance.Coordinates(A, B, C, np.eye(n), np.eye(n), sizes), D)
        slow = response.frequency_response(A, B, C, D, z)
        assert terms.rest is None
        assert np.isrealobj(terms.terms) == real
        np.testing.assert_allclose(terms.at(z), slow, atol=1e-12 * np.abs(slow).max())
        rows, columns = rng.integers(2, size=50), rng.integers(3, size=50)
        expected = slow[rows, columns, np.arange(50)]
        np.testing.assert_allclose(terms.entries(rows, columns, z), expected, atol=1e-12 * np.abs(slow).max())
    assert terms.at(z[:0]).shape == (2, 3, 0)
    assert terms.entries(rows[:0], columns[:0], z[:0]).shape == (0,)


def test_blocks_that_cannot_be_written_out_are_solved(rng):
    """A real pole tied to a pair, a pair next to the real axis, more states than are written out."""
    tied = np.array([[0.5, 0.6, 1.0], [-0.6, 0.5, 1.0], [0.0, 0.0, 0.5]])
    flat = np.array([[0.5, 1.0], [-1e-9, 0.5]])
    A, z = block_diag(tied, flat, discretize.delay(9, 1)[0], [[-0.7]]), np.exp(1j * np.linspace(0, np.pi, 50))
    n, D = len(A), np.zeros((2, 3))
    form = balance.Coordinates(
        A, rng.standard_normal((n, 3)), rng.standard_normal((2, n)), np.eye(n), np.eye(n), (3, 2, 9, 1)
    )
    terms, slow = modal_response.split(form, D), response.frequency_response(A, form.B, form.C, D, z)
    assert terms.rest is not None
    assert len(terms.rest[0]) == 14
    np.testing.assert_allclose(terms.at(z), slow, atol=1e-12 * np.abs(slow).max())


def test_a_point_on_a_pole_is_beside_it_by_rounding():
    """A mode without damping whose own frequency is a point: large, and no warning."""
    A = np.array([[0.6, 0.8], [-0.8, 0.6]])
    form = balance.Coordinates(A, np.ones((2, 1)), np.ones((1, 2)), np.eye(2), np.eye(2), (2,))
    at = modal_response.split(form, np.zeros((1, 1))).at(np.array([0.6 + 0.8j]))
    assert 1e14 < np.abs(at).max() < 1e17


def test_states_of_a_large_block_are_scaled_and_small_blocks_stay_as_they_are(rng):
    """Eight tied states decades apart beside a mode: the block is as large as its poles, the response the same."""
    d = np.exp2(np.arange(0, 24, 3))
    tied = (0.5 * np.eye(8) + np.diag(np.ones(7), 1)) * d / d[:, None]
    A = block_diag([[0.8, 0.5], [-0.5, 0.8]], tied)
    B, C = np.vstack([rng.standard_normal((2, 3)), np.ones((8, 3)) / d[:, None]]), rng.standard_normal((4, 10))
    C[:, 2:] *= d
    form = balance.Coordinates(A, B, C, np.eye(10), np.eye(10), (2, 8))
    even = balance.even_blocks(form)
    assert np.linalg.norm(even.A) < 5 < np.linalg.norm(A)
    assert np.array_equal(even.A[:2], A[:2])
    assert np.array_equal(even.T @ even.inverse, np.eye(10))
    assert np.array_equal(even.inverse @ A @ even.T, even.A)
    z = np.exp(1j * np.linspace(0.0, np.pi, 9))
    assert np.allclose(*(modal_response.split(each, np.zeros((4, 3))).at(z) for each in (form, even)), rtol=1e-9)
    alone = form._replace(A=A[:2, :2], B=B[:2], C=C[:, :2], T=np.eye(2), inverse=np.eye(2), blocks=(2,))
    assert balance.even_blocks(alone) is alone
