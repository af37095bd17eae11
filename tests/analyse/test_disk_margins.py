"""Disk margins against published values, and against the loop they are about."""

import numpy as np
import pytest
from test_mu import sampled_loop

from ultraquiet._base.errors import InputError, RateError
from ultraquiet.analyse import disk_margin, disk_margins, disk_ranges, loop_margins
from ultraquiet.testing.problems import damped_plant, loop_poles, observer_law
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain

A10 = 10.0
SATELLITE = StateSpace([[0, A10], [-A10, 0]], np.eye(2), [[1, A10], [-A10, 1]], np.zeros((2, 2)))
MINUS = gain(-np.eye(2))


def textbook():
    """L = 25 / (s^3 + 10 s^2 + 10 s + 10), the example of Seiler, Packard and Gahinet 2020."""
    A = np.array([[-10.0, -10, -10], [1, 0, 0], [0, 1, 0]])
    return StateSpace(A, [[1], [0], [0]], [[0, 0, 25]], [[0]])


def test_textbook_loop():
    """RobustAndOptimalControl.jl, test_diskmargin.jl: alpha 0.46, gain 0.63 to 1.59, at 1.94 rad/s."""
    found = disk_margins(textbook(), gain([[-1.0]]))
    low, high = found.gain_range
    print(f"alpha {found.alpha:.6f} at {2 * np.pi * found.f_hz:.4f} rad/s, gain {low:.4f} to {high:.4f}")
    assert abs(found.alpha - 0.46) < 5e-3
    assert abs(low - 0.63) < 5e-3
    assert abs(high - 1.59) < 1e-2
    assert abs(2 * np.pi * found.f_hz - 1.94) < 0.02
    assert found.loop_alpha[0] == pytest.approx(found.alpha, rel=1e-7) == found.alpha_at_most
    # fine grid, from the definition
    s = 1j * np.linspace(1.9, 2.0, 200_001)
    L = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    assert found.alpha == pytest.approx(1 / np.abs(1 / (1 + L) - 0.5).max(), rel=1e-8)


def test_published_sampled_loop():
    """alpha 0.794418 of the first loop, the others closed (same file)."""
    found = disk_margins(sampled_loop(), gain(-np.eye(3), 100.0))
    print(f"alpha {found.loop_alpha[0]:.9f} at {2 * np.pi * found.loop_f_hz[0]:.4f} rad/s, all loops {found.alpha:.6f}")
    assert found.loop_alpha[0] == pytest.approx(0.794418036911981, rel=1e-6)
    assert found.alpha < found.loop_alpha.min()


def test_spinning_satellite():
    """alpha 2 a loop at a time, 0.0998 for all loops of one side, 0.0499 for both sides (same file and paper)."""
    found = {side: disk_margins(SATELLITE, MINUS, side) for side in ("output", "input", "both")}
    print({side: (round(m.alpha, 6), m.loop_alpha.round(6).tolist()) for side, m in found.items()})
    for side in ("output", "input"):
        np.testing.assert_allclose(found[side].loop_alpha, 2.0, rtol=1e-9)
        assert abs(found[side].alpha - 0.0998) < 5e-5
        assert found[side].alpha == pytest.approx(disk_margin(SATELLITE, MINUS, side), rel=1e-9)
        assert found[side].alpha_at_most == pytest.approx(found[side].alpha, rel=1e-6)
    # four numbers: here both bounds of mu meet, so that 0.04984 is exact and the source's 0.0499 rounded upwards
    assert abs(found["both"].alpha - 0.0499) < 1e-4
    assert found["both"].alpha_at_most == pytest.approx(found["both"].alpha, rel=1e-6)
    # S - I / 2 = N / (2 (s + 1)) with |N| = |s - 1 + 2 j a|: the largest value by hand
    w = np.linspace(0, 20, 200_001)
    s = 1j * w
    by_hand = max(np.abs((s - 1 + sign * 2j * A10) / (2 * (s + 1))).max() for sign in (1, -1))
    assert found["output"].alpha == pytest.approx(1 / by_hand, rel=1e-6)


@pytest.mark.parametrize("skew", [-1.0, -0.5, 0.0, 1.0, 2.0])
def test_factors_bring_the_loop_to_the_verge(skew, seed):
    """The loop is closed again with the factors found: it is singular there. Half as much change leaves it stable."""
    plant = damped_plant(seed)
    law = observer_law(plant)
    found = disk_margins(plant, law, "output", skew=skew)
    GK = (found.factors * np.eye(2)) @ np.einsum(
        "ij,jk->ik",
        plant.frequency_response([found.f_hz])[:, :, 0],
        law.frequency_response([found.f_hz])[:, :, 0],
    )
    verge = np.linalg.svd(np.eye(2) - GK, compute_uv=False)[-1]
    print(f"skew {skew:g}: alpha {found.alpha:.4f}, factors {np.abs(found.factors).round(3).tolist()}, {verge:.1e}")
    assert verge < 1e-9
    d = 2 * (found.factors - 1) / ((1 - skew) + (1 + skew) * found.factors)
    np.testing.assert_allclose(np.abs(d), found.alpha_at_most, rtol=1e-6)
    low, high, _ = disk_ranges(0.5 * found.alpha, skew)
    for factors in ((low, high), (high, low), (low, low), (high, high)):
        changed = StateSpace(plant.A, plant.B, np.array(factors)[:, None] * plant.C, plant.D, plant.rate_hz)
        assert np.abs(loop_poles(changed, law)).max() < 1


def test_ranges_are_the_disk():
    """Points of the boundary of each disk: its real ends and the phase at which it leaves the unit circle."""
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 400_001))
    for alpha in (0.3, 1.0, 1.9, 3.0):
        for skew in (-0.5, 0.0, 0.4):
            d = alpha * turn
            factor = (2 + (1 - skew) * d) / (2 - (1 + skew) * d)
            low, high, phase = disk_ranges(alpha, skew)
            on_circle = np.flatnonzero(np.diff(np.sign(np.abs(factor) - 1)))
            assert np.abs(np.angle(factor[on_circle], deg=True)).max() == pytest.approx(float(phase), abs=0.05)
            assert np.abs(factor - low).min() < 1e-4
            assert np.isinf(high) == (alpha * (1 + skew) >= 2)
            assert np.isinf(high) or np.abs(factor - high).min() < 1e-3
    assert [float(v) for v in disk_ranges(0.0)] == [1.0, 1.0, 0.0]
    assert [float(v) for v in disk_ranges(2.0)] == [0.0, np.inf, 90.0]


def test_margins_agree_one_loop_at_a_time(seed):
    plant = damped_plant(seed)
    law = observer_law(plant)
    for side in ("output", "input"):
        classical, disks = loop_margins(plant, law, side), disk_margins(plant, law, side)
        np.testing.assert_allclose(classical.disk, disks.loop_alpha, rtol=1e-6)
        assert disks.alpha <= disks.loop_alpha.min() * (1 + 1e-7)
        low, high, phase = disk_ranges(disks.loop_alpha)
        assert np.all(20 * np.log10(high) <= classical.gain_up_db + 0.01)
        assert np.all(-20 * np.log10(np.maximum(low, 1e-300)) <= classical.gain_down_db + 0.01)
        assert np.all(phase <= classical.phase_deg + 0.1)


def test_an_unstable_loop_has_none():
    G = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)
    found = disk_margins(G, gain([[5.0]], 1.0))
    assert not found.stable
    assert found.alpha == found.alpha_at_most == found.loop_alpha[0] == 0.0
    assert found.gain_range == (1.0, 1.0)
    assert found.phase_deg == 0.0


def test_loops_without_states_or_law():
    """One channel, static: L = 1 stands any phase below 180 degrees; no law at all stands everything."""
    one = disk_margins(gain([[1.0]], 10.0), gain([[-1.0]], 10.0))
    assert np.isinf(one.alpha)
    none = disk_margins(gain([[1.0]], 10.0), gain([[0.0]], 10.0))
    assert none.alpha == pytest.approx(2.0)


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (4, 3), (3, 5)])
def test_margins_of_both_sides_depend_on_no_units(rng, ny, nu):
    """Units decades apart, even those in which G is a millionth of K: factors are ratios."""
    G = StateSpace(0.9 * np.eye(ny), 0.1 * rng.standard_normal((ny, nu)), np.eye(ny), np.zeros((ny, nu)), 1000.0)
    drawn = rng.standard_normal((nu, ny))
    K = gain(-drawn / max(np.sqrt(nu * ny) / 0.3, 20 * np.linalg.norm(G.B @ drawn)), 1000.0)
    plain = disk_margins(G, K, "both")
    assert plain.alpha > 0  # |B K| is kept to 0.05, half of what could carry a pole from 0.9 to the circle
    inputs, outputs = 10.0 ** rng.uniform(-4, 4, nu), 1e-6 * 10.0 ** rng.uniform(-4, 4, ny)
    scaled = StateSpace(G.A, G.B * inputs, outputs[:, None] * G.C, G.D, 1000.0)
    law = gain(K.D / inputs[:, None] / outputs, 1000.0)
    for found in (disk_margins(scaled, law, "both"), disk_margins(law, scaled, "both")):
        assert found.alpha == pytest.approx(plain.alpha, rel=1e-6)
        near = disk_margins(G, K, "both", f_hz=found.f_hz * np.array([1 - 1e-6, 1 + 1e-6]))
        assert near.alpha == pytest.approx(plain.alpha, rel=1e-6)  # a flat peak has no one frequency
    assert disk_margins(scaled, law, "both").loop_alpha == pytest.approx(plain.loop_alpha, rel=1e-6)
    assert disk_margin(scaled, law, "both") == pytest.approx(plain.alpha, rel=1e-6)


def test_what_does_not_fit_is_refused():
    G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=10.0)
    with pytest.raises(InputError, match="'side' must be one of"):
        disk_margin(G, gain([[-0.1]], 10.0), "sensor")
    with pytest.raises(InputError, match="'skew' must lie between"):
        disk_margin(G, gain([[-0.1]], 10.0), skew=99.0)
    with pytest.raises(RateError):
        disk_margin(G, gain([[-0.1]], 20.0), "both")
    for side in ("output", "input", "both"):
        with pytest.raises(InputError):
            disk_margin(G, gain([[-0.1, 0.0]], 10.0), side)
