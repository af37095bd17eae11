"""Zeros, margins and symmetry against known answers."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.analyse import (
    disk_margin,
    loop_margins,
    mu_upper_bound,
    peak_sensitivity,
    poles,
    reciprocity_error,
    roots,
    singular_values,
    threefold_error,
    zeros,
)
from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain, series


def test_slicot_ab08nd_zeros():
    A = np.diag([1.0, 1, 3, -4, -1, 3])
    B = [[0, -1], [-1, 0], [1, -1], [0, 0], [0, 1], [-1, -1]]
    C = [[1, 0, 0, 1, 0, 0], [0, 1, 0, 1, 0, 1], [0, 0, 1, 0, 0, 1]]
    found = zeros(StateSpace(A, B, C, np.zeros((3, 2))))
    np.testing.assert_allclose(np.sort(found.values.real), [-1, 2], atol=1e-9)
    np.testing.assert_allclose(found.values.imag, 0, atol=1e-9)


def test_delays_bring_no_finite_zeros(rng):
    """Six channels with three samples of delay: the zeros are those of the plant without it."""
    n = 12
    A = rng.standard_normal((n, n)) / np.sqrt(n) * 0.8
    G = StateSpace(A, rng.standard_normal((n, 6)), rng.standard_normal((6, n)), np.zeros((6, 6)), rate_hz=3500.0)
    delay = StateSpace(*discretize.delay(3, 6), rate_hz=3500.0)
    bare, late = zeros(G), zeros(series(delay, G))
    assert len(bare) == len(late) == n - 6
    np.testing.assert_allclose(np.sort(np.abs(late.values)), np.sort(np.abs(bare.values)), rtol=1e-6)


def test_zeros_block_their_direction(rng):
    n = 8
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    G = StateSpace(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), rng.standard_normal((2, 2)))
    for z in zeros(G).values:
        value = G.C @ np.linalg.solve(z * np.eye(n) - G.A, G.B) + G.D
        s = np.linalg.svd(value, compute_uv=False)
        assert s[-1] < 1e-6 * max(1.0, s[0])


def test_poles_are_reported_as_vibration():
    w, zeta, rate = 2 * np.pi * 35.0, 0.02, 3500.0
    s = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    found = roots(np.exp(np.array([s, np.conj(s)]) / rate), rate)
    np.testing.assert_allclose(found.frequency_hz, 35.0)
    np.testing.assert_allclose(found.zeta, zeta)
    assert not found.outside.any()
    assert poles(StateSpace([[1.2]], [[1]], [[1]], [[0]], rate_hz=1.0)).outside.all()


def test_disk_margin_of_the_textbook_loop():
    """L = 25 / (s^3 + 10 s^2 + 10 s + 10): alpha 0.46 (RobustAndOptimalControl.jl, test_diskmargin.jl)."""
    A = np.array([[-10.0, -10, -10], [1, 0, 0], [0, 1, 0]])
    L = StateSpace(A, [[1], [0], [0]], [[0, 0, 25]], [[0]])
    found = loop_margins(L, gain([[-1.0]]))
    print(f"disk margin {found.disk[0]:.4f}, gain {found.gain_up_db[0]:.2f} dB, phase {found.phase_deg[0]:.2f} deg")
    assert abs(found.disk[0] - 0.46) < 0.005
    # Routh: 10 * 10 = 10 + 25 k
    assert abs(found.gain_up_db[0] - 20 * np.log10(90 / 25)) < 1e-2


def test_spinning_satellite_hides_its_danger_one_loop_at_a_time():
    """a = 10, K = I: each loop by itself is 1/s with perfect margins, while the peak of S is far above 6 dB."""
    a = 10.0
    G = StateSpace([[0, a], [-a, 0]], np.eye(2), [[1, a], [-a, 1]], np.zeros((2, 2)))
    K = gain(-np.eye(2))
    found = loop_margins(G, K)
    np.testing.assert_allclose(found.disk, 2.0, rtol=1e-3)
    np.testing.assert_allclose(found.phase_deg, 90.0, atol=0.1)
    assert peak_sensitivity(G, K)[0] > 18


def test_delay_margin_is_a_delay_that_destabilises():
    G = StateSpace([[0.95]], [[0.05]], [[1.0]], [[0.0]], rate_hz=1000.0)
    K = gain([[-10.0]], 1000.0)
    found = loop_margins(G, K)
    samples = found.delay_s[0] * 1000.0
    stable = [series(StateSpace(*discretize.delay(k, 1), rate_hz=1000.0), G) for k in (int(samples), int(samples) + 1)]
    assert np.isfinite(peak_sensitivity(stable[0], K)[0])
    assert np.isinf(peak_sensitivity(stable[1], K)[0])


def test_an_unstable_loop_has_no_margins():
    G = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)
    assert loop_margins(G, gain([[5.0]], 1.0)).disk[0] == 0.0


def test_symmetry_errors(rng):
    ring = rng.standard_normal((6, 2)) + 1j * rng.standard_normal((6, 2))
    values = np.array([[ring[(j - i) % 6, (i % 2)] for j in range(6)] for i in range(6)])[:, :, None]
    assert threefold_error(values)[0] < 1e-12
    spoiled = values.copy()
    spoiled[0, 0] *= 1.1
    assert threefold_error(spoiled)[0] > 1e-3
    assert reciprocity_error(values + np.swapaxes(values, 0, 1))[0] < 1e-12
    with pytest.raises(InputError, match="six struts"):
        threefold_error(np.ones((4, 4, 1), dtype=complex))


def test_singular_values_fall(rng):
    G = StateSpace(0.5 * np.eye(3), rng.standard_normal((3, 2)), rng.standard_normal((4, 3)), np.zeros((4, 2)), 1.0)
    s = singular_values(G, [0.0, 0.1])
    assert s.shape == (2, 2)
    assert np.all(s[0] >= s[1])


def test_disk_margin_of_the_spinning_satellite_all_loops():
    """alpha 0.0998 at one side, 0.0499 at both (RobustAndOptimalControl.jl, test_diskmargin.jl)."""
    a = 10.0
    G = StateSpace([[0, a], [-a, 0]], np.eye(2), [[1, a], [-a, 1]], np.zeros((2, 2)))
    K = gain(-np.eye(2))
    sides = {side: disk_margin(G, K, side) for side in ("output", "input", "both")}
    print(f"spinning satellite: {sides}")
    assert abs(sides["output"] - 0.0998) < 1e-4
    assert abs(sides["input"] - 0.0998) < 1e-4
    assert abs(sides["both"] - 0.0499) < 1e-4


def test_mu_bound_lies_between_its_own_bounds(rng):
    """Above every |eigenvalue| of U M with U diagonal and unitary, below the norm; a scaled matrix keeps it."""
    for _ in range(20):
        n = int(rng.integers(2, 7))
        M = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
        d = np.exp(rng.uniform(-3, 3, n))
        bound, again = (mu_upper_bound(m[:, :, None])[0] for m in (M, d[:, None] * M / d))
        turned = np.exp(2j * np.pi * rng.uniform(size=(300, n)))
        below = max(np.abs(np.linalg.eigvals(u[:, None] * M)).max() for u in turned)
        assert below <= bound * (1 + 1e-6)
        assert bound <= np.linalg.norm(M, 2) * (1 + 1e-6)
        assert abs(again / bound - 1) < 1e-2
