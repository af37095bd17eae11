"""mu against SLICOT, a published loop, its definition, and its own two sides."""

import re

import numpy as np
import pytest

from slicot_examples import SLICOT, numbers
from ultraquiet._base.errors import InputError
from ultraquiet.analyse import Block, hinf_norm, mu_bounds, mu_peak, mu_upper_bound
from ultraquiet.analyse.scalings import upper
from ultraquiet.analyse.structure import structure
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import feedback, gain

ROUNDING = 1e-9
# Complex structures, by name: sizes as users write them.
STRUCTURES = {
    "numbers": [1] * 6,
    "full blocks": [2, 2, 2],
    "not square": [(3, 2), (1, 2), 2],
    "mixed sizes": [3, 1, 1, 1],
    "repeated": [Block(2, kind="repeated"), 1, 2, 1],
}


def drawn(rng, count=40, outputs=6, inputs=6):
    return rng.standard_normal((outputs, inputs, count)) + 1j * rng.standard_normal((outputs, inputs, count))


def verge(M, perturbation):
    """Smallest singular value of I - M Delta per line, from the definition."""
    loop = np.eye(M.shape[0])[:, :, None] - np.einsum("zwf,wvf->zvf", M, perturbation)
    return np.linalg.svd(np.moveaxis(loop, 2, 0), compute_uv=False)[:, -1]


def has_structure(bounds):
    """Whether Delta is zero off its blocks, and a multiple of one (a real one) where it should be."""
    row = column = 0
    left = bounds.perturbation.copy()
    for block in bounds.blocks:
        part = left[row : row + block.inputs, column : column + block.outputs]
        if block.kind != "full":
            number = part[0, 0]
            assert np.abs(part - number * np.eye(block.inputs)[:, :, None]).max() <= 1e-12 * np.abs(number).max()
            assert block.kind == "repeated" or np.abs(number.imag).max() == 0
        part[:] = 0
        row, column = row + block.inputs, column + block.outputs
    return not left.any()


def test_slicot_ab13md():
    """Two real numbers, a full 2 x 2 block and two complex numbers."""
    text = (SLICOT / "AB13MD.dat").read_text().split("\n", 4)[4]
    entries = [
        complex(float(re_.replace("D", "E")), float(im.replace("D", "E")))
        for re_, im in re.findall(r"\(([^,]+),([^)]+)\)", text)
    ]
    real = Block(1, kind="real")
    found = mu_bounds(np.reshape(entries, (6, 6)), [real, real, 2, 1, 1])
    expected = numbers((SLICOT / "AB13MD.res").read_text())[-1]
    print(f"AB13MD: {found.upper[0]:.10g}, printed {expected:.10g}, lower bound {found.lower[0]:.6g}")
    assert abs(found.upper[0] / expected - 1) < 5e-10
    assert 0 <= found.lower[0] <= found.upper[0]


def sampled_loop():
    """The 3 x 3 loop of RobustAndOptimalControl.jl @e9e38fd, test_diskmargin.jl (MIT), 100 Hz."""
    A = np.zeros((5, 5))
    A[0, 0] = A[1, 1] = A[2, 2] = A[3, 3] = 1.0
    A[0, 2], A[1, 2], A[1, 3], A[3, 4], A[4, 4] = 9.84, 0.01, 2.14634e-6, -1.73983959887, 0.56597684805
    B = np.zeros((5, 3))
    B[0, 1:] = 4.901416e-5, 0.00019883877999999998
    B[2, 2], B[3, 1], B[4, 1] = 4.0414389999999996e-5, -0.02004649371, -0.00490141631
    C = np.zeros((3, 5))
    C[0, 1], C[1, 0], C[2, 0], C[2, 2] = -0.83516488404, 186.74725411661, -7.44299057498, 7035.08410814126
    D = np.zeros((3, 3))
    D[1:, 0] = 34875.36444283988, 48304.01940122544
    return StateSpace(A, B, C, D, rate_hz=100.0)


def test_sampled_loop_of_a_published_test():
    G = sampled_loop()
    w = np.array([0.01, 0.1, 1, 10, 100])
    expected = 1e5 * np.array(
        [2.961017564832289, 0.029880921297303, 0.000452684368322, 0.000033712186847, 0.000003488286208]
    )
    opened = mu_bounds(G, f_hz=w / (2 * np.pi))
    print(f"open loop: {opened.upper.tolist()}, furthest {np.abs(opened.upper / expected - 1).max():.1e}")
    np.testing.assert_allclose(opened.upper, expected, rtol=1e-6)
    grid = 10 ** np.linspace(-2, 2, 300)
    response = feedback(G, gain(-np.eye(3), 100.0)).frequency_response(grid / (2 * np.pi))
    closed = mu_bounds(response, f_hz=grid / (2 * np.pi))
    peak, f_hz = closed.peak
    print(f"closed loop: first {closed.upper[0]:.4f}, max {peak:.8f} at {f_hz:.4f} Hz, last {closed.upper[-1]:.4f}")
    assert abs(closed.upper[0] - 1) < 1e-3
    assert abs(peak / 2.50314853 - 1) < 1e-6
    assert abs(closed.upper[-1] / 0.397718223553195 - 1) < 0.03
    assert closed.gap.max() < 1e-6


@pytest.mark.parametrize("name", STRUCTURES)
def test_both_bounds_prove_themselves(name, rng):
    """Upper: the norm after scaling; lower: a Delta of the structure on the verge, checked by its definition."""
    M = drawn(rng)
    found = mu_bounds(M, STRUCTURES[name])
    assert np.all(found.lower <= found.upper)
    scaled = np.einsum("zyf,ywf,fwv->fzv", found.D, M, np.linalg.inv(np.moveaxis(found.D_in, 2, 0)))
    np.testing.assert_allclose(np.linalg.norm(scaled, 2, axis=(1, 2)), found.upper, rtol=1e-9)
    size = np.linalg.norm(np.moveaxis(found.perturbation, 2, 0), 2, axis=(1, 2))
    np.testing.assert_allclose(size * found.lower, 1.0, rtol=1e-9)
    assert has_structure(found)
    worst = verge(M, found.perturbation).max()
    print(f"{name}: I - M Delta within {worst:.1e} of singular, gap up to {found.gap.max():.1e}")
    assert worst < ROUNDING


@pytest.mark.parametrize("blocks", [[6], [1, 5], [2, 4], [1, 2, 3], [2, 2, 2], [(2, 1), (3, 2), (1, 3)]])
def test_bounds_meet_for_three_blocks_and_fewer(blocks, rng):
    """Doyle 1982: the scaled norm is mu itself up to three full blocks."""
    found = mu_bounds(drawn(rng), blocks)
    print(f"{blocks}: gap {found.gap.max():.1e}")
    assert found.gap.max() < 1e-6


def test_known_values(rng):
    u, v = rng.standard_normal((2, 6)) + 1j * rng.standard_normal((2, 6))
    rank_one = mu_bounds(np.outer(u, v))
    assert rank_one.upper[0] == pytest.approx(np.abs(u * v).sum(), rel=1e-8)
    assert rank_one.lower[0] == pytest.approx(np.abs(u * v).sum(), rel=1e-8)
    M = drawn(rng, 5, 4, 4)
    whole = mu_bounds(M, [Block(4, kind="repeated")])
    radius = np.abs(np.linalg.eigvals(np.moveaxis(M, 2, 0))).max(axis=1)
    np.testing.assert_allclose(whole.lower, radius, rtol=1e-8)
    np.testing.assert_allclose(whole.upper, radius, rtol=1e-4)
    np.testing.assert_allclose(mu_bounds(M, [4]).upper, np.linalg.norm(np.moveaxis(M, 2, 0), 2, axis=(1, 2)))


def test_real_numbers_are_kinder_than_complex_ones(rng):
    """A symmetric rotation has no real eigenvalue: a real number in the loop does no harm, a complex one does."""
    real = Block(1, kind="real")
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert mu_bounds(turn, [real, real]).upper[0] == pytest.approx(1.0, abs=1e-6)
    assert mu_bounds(turn, [Block(2, kind="real")]).upper[0] < 1e-3
    assert mu_bounds(turn, [Block(2, kind="repeated")]).upper[0] == pytest.approx(1.0, rel=1e-6)
    M = drawn(rng)
    blocks = [real, real, 2, 1, 1]
    mixed, every = mu_bounds(M, blocks), mu_bounds(M, [1, 1, 2, 1, 1])
    assert np.all(mixed.upper <= every.upper * (1 + 1e-7))
    found = mixed.lower > 0
    print(f"real eigenvalue found at {found.mean():.0%} of the matrices")
    assert np.all(mixed.lower <= mixed.upper)
    assert verge(M[:, :, found], mixed.perturbation[:, :, found]).max(initial=0.0) < 1e-6
    assert np.abs(mixed.perturbation[[0, 1], [0, 1]][:, found].imag).max(initial=0.0) < 1e-12


def test_mixed_bound_proves_itself(rng):
    """upper^2 D_in' D_in - M' D' D M - j (G M - M' G') is not negative, with G Hermitian on the real blocks only."""
    real = Block(1, kind="real")
    M = drawn(rng)
    found = mu_bounds(M, [real, real, 2, 1, 1])
    G, D, D_in, Mf = (np.moveaxis(x, 2, 0) for x in (found.G, found.D, found.D_in, M))
    star = lambda x: x.conj().swapaxes(1, 2)  # noqa: E731
    moved = D @ Mf
    left = found.upper[:, None, None] ** 2 * star(D_in) @ D_in - star(moved) @ moved - 1j * (G @ Mf - star(G @ Mf))
    root = np.linalg.inv(D_in)
    least = np.linalg.eigvalsh(star(root) @ left @ root)[:, 0] / found.upper**2
    print(f"least eigenvalue {least.min():.1e}")
    assert least.min() > -1e-7
    assert not np.any(G[:, 2:])
    assert not np.any(G[:, :, 2:])


def test_bounds_do_not_mind_units(rng):
    M, d = drawn(rng), 10.0 ** rng.uniform(-8, 8, 6)
    plain, scaled = mu_bounds(M), mu_bounds(d[:, None, None] * M / d[:, None])
    far = np.abs(scaled.upper / plain.upper - 1).max()
    print(f"units of 1e-8 to 1e8 move the bound by {far:.1e}")
    assert far < 1e-6
    np.testing.assert_allclose(mu_bounds(1e200 * M).upper, 1e200 * plain.upper, rtol=1e-7)


def test_paths_that_never_return_do_not_count():
    """A triangular matrix has the mu of its diagonal, which no finite scaling reaches."""
    M = np.array([[1.0, 100.0, 1e4], [0.0, 2.0, 1e3], [0.0, 0.0, 0.5]])
    found = mu_bounds(M)
    assert found.upper[0] == pytest.approx(2.0, rel=1e-6)
    assert found.lower[0] == pytest.approx(2.0, rel=1e-6)
    nothing = mu_bounds(np.zeros((3, 3)))
    assert nothing.upper[0] == nothing.lower[0] == nothing.gap[0] == 0
    assert np.isnan(nothing.perturbation).all()
    assert mu_bounds(np.array([[0.0, 1.0], [0.0, 0.0]])).upper[0] < 1e-8


def test_peak_is_refined_between_the_lines(rng):
    """One full block: mu is the largest singular value, whose peak a Hamiltonian gives exactly."""
    A = np.zeros((4, 4))
    for k, w in enumerate((3.0, 7.0)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-0.2 * w, w], [-w, -0.2 * w]]
    G = StateSpace(A, rng.standard_normal((4, 2)), rng.standard_normal((2, 4)), rng.standard_normal((2, 2)))
    norm, f_hz = hinf_norm(G)
    f = np.geomspace(0.01, 10, 60)
    peak, at = mu_bounds(G, [2], f_hz=f).peak
    print(f"peak {peak:.9g} at {at:.6g} Hz; exact {norm:.9g} at {f_hz:.6g} Hz")
    if 0.01 < f_hz < 10:
        assert peak == pytest.approx(norm, rel=1e-7)
    assert mu_peak(G, [2])[0] == pytest.approx(norm, rel=1e-7)
    apart = mu_bounds(G, f_hz=f)
    assert mu_peak(G, f_hz=f)[0] == pytest.approx(apart.peak[0], rel=1e-6)
    assert apart.peak[0] >= apart.upper.max() * (1 - 1e-12)
    assert apart.levels.shape == (2, 60)
    np.testing.assert_allclose(apart.levels[-1], 1.0)


def test_unstable_systems_stand_nothing():
    G = StateSpace([[1.1]], [[1.0]], [[1.0]], [[0.0]], rate_hz=10.0)
    found = mu_bounds(G)
    assert not found.stable
    assert found.peak[0] == np.inf == mu_peak(G)[0]


def test_what_does_not_fit_is_refused():
    with pytest.raises(InputError, match="the blocks take 3 outputs"):
        mu_bounds(np.ones((2, 2)), [1, 2])
    with pytest.raises(InputError, match="must be square"):
        Block(2, 3, kind="real")
    with pytest.raises(InputError, match="'blocks' must be a whole number"):
        mu_bounds(np.ones((2, 2)), ["a", "b"])
    with pytest.raises(InputError, match="'blocks' must be a list"):
        mu_bounds(np.ones((2, 2)), "full")
    with pytest.raises(InputError, match="finite array"):
        mu_upper_bound(np.full((2, 2, 1), np.nan))
    with pytest.raises(InputError, match="M has 2 outputs and 3 inputs"):
        mu_bounds(np.ones((2, 3)))
    with pytest.raises(InputError, match="has 1 lines"):
        mu_bounds(np.ones((2, 2)), f_hz=[1.0, 2.0])


@pytest.mark.parametrize("blocks", [None, [2, 2, 2], [Block(2, kind="repeated"), Block(2, kind="real"), 2]])
def test_no_matrix_is_too_crooked(blocks, rng):
    """Sizes over sixteen decades and missing paths: bounds at every line, whatever one does to the others."""
    M = drawn(rng, 20) * 10.0 ** rng.uniform(-8, 8, (6, 6, 20)) * (rng.uniform(size=(6, 6, 20)) < 0.4)
    found = mu_bounds(M, blocks)
    assert np.isfinite(found.upper).all()
    assert np.all(found.lower <= found.upper)


def test_single_channels_as_any_blocks(rng, monkeypatch):
    """Directions of rank one, worked with as rows, give the bound that whole matrices give."""
    for n in (2, 5):
        M = rng.standard_normal((4, n, n)) + 1j * rng.standard_normal((4, n, n))
        channels = structure("test", None, (n, n))
        rows = upper.upper_bound(M, channels).value
        with monkeypatch.context() as whole:
            whole.setattr(upper._Basis, "scalar", False)
            np.testing.assert_allclose(rows, upper.upper_bound(M, channels).value, rtol=1e-8)
