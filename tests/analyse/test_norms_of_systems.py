"""Norms against known answers, dense grids and each other."""

import numpy as np

from ultraquiet.analyse import h2_norm, hinf_norm
from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace


def resonant(rng, modes, channels, zeta_low=1e-4):
    w, zeta = rng.uniform(1, 100, modes), 10 ** rng.uniform(np.log10(zeta_low), -1, modes)
    n = 2 * modes
    A = np.zeros((n, n))
    for k in range(modes):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, w[k]], [-w[k], -2 * zeta[k] * w[k]]]
    D = rng.standard_normal((channels, channels)) * rng.integers(0, 2)
    return StateSpace(A, rng.standard_normal((n, channels)), rng.standard_normal((channels, n)), D)


def test_slicot_ab13dd_needle():
    A = np.zeros((6, 6))
    for k, (w, d) in enumerate([(0.5, 2e-4), (1.0, 2e-5), (2.0, 2e-6)]):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, 1], [-w, -d]]
    G = StateSpace(A, [[1], [0], [1], [0], [1], [0]], [[1, 0, 1, 0, 1, 0]], [[0]])
    norm, f_hz = hinf_norm(G)
    print(f"AB13DD: norm {norm:.10g} at {2 * np.pi * f_hz:.10g} rad/s")
    assert abs(norm / 0.5000000001e6 - 1) < 1e-7
    assert abs(2 * np.pi * f_hz - 1.414213562) < 1e-8


def test_norm_is_the_supremum_of_a_dense_grid(rng):
    worst = 0.0
    for _ in range(15):
        G = resonant(rng, modes=int(rng.integers(1, 12)), channels=3)
        norm, f_hz = hinf_norm(G)
        poles = np.abs(G.poles())
        w = np.concatenate([np.geomspace(0.01, 1e4, 4000), *(p * (1 + np.linspace(-1e-2, 1e-2, 400)) for p in poles)])
        grid = np.linalg.norm(np.moveaxis(G.frequency_response(w / (2 * np.pi)), 2, 0), 2, axis=(1, 2)).max()
        here = np.inf if not np.isfinite(f_hz) else np.linalg.norm(G.frequency_response([f_hz])[:, :, 0], 2)
        assert grid <= norm * (1 + 1e-6)
        if np.isfinite(f_hz):
            worst = max(worst, abs(here / norm - 1))
    print(f"norm against its own response: {worst:.1e}")
    assert worst < 1e-6


def test_bilinear_map_keeps_the_norm(rng):
    for _ in range(15):
        G = resonant(rng, modes=5, channels=2)
        sampled = StateSpace(*discretize.bilinear_to_discrete(G.A, G.B, G.C, G.D), rate_hz=1000.0)
        assert abs(hinf_norm(sampled)[0] / hinf_norm(G)[0] - 1) < 1e-6


def test_unstable_systems_have_no_norm():
    G = StateSpace([[1.1]], [[1.0]], [[1.0]], [[0.0]], rate_hz=10.0)
    assert hinf_norm(G)[0] == np.inf
    assert h2_norm(G) == np.inf


def test_h2_norm_is_the_standard_deviation_of_the_output(rng):
    G = StateSpace([[0.9, 0.2], [-0.2, 0.9]], [[1.0], [0.5]], [[1.0, 0.3]], [[0.2]], rate_hz=100.0)
    y = G.simulate(rng.standard_normal((1, 200_000)))
    assert abs(y.std() / h2_norm(G) - 1) < 0.05


def test_lightly_damped_chains_in_uneven_units(seed):
    """Coupled modes of damping down to 1e-7 in units of 1e+-3: the peak as a fan of direct solutions finds it."""
    draw = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(6):
        m = int(draw.integers(2, 8))
        n, w, zeta = 2 * m, 10 * (1 + 1e-2 * draw.standard_normal(m)), 10 ** draw.uniform(-7, -3, m)
        A = np.triu(np.kron(np.triu(draw.standard_normal((m, m)), 1), np.ones((2, 2))))
        for k in range(m):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, w[k]], [-w[k], -2 * zeta[k] * w[k]]]
        B, C, D = (draw.standard_normal(s) for s in ((n, 2), (2, n), (2, 2)))
        poles, t = np.linalg.eigvals(A), 10 ** draw.uniform(-3, 3, n)
        norm, f_hz = hinf_norm(StateSpace(A * t / t[:, None], B / t[:, None], C * t, D))

        def at(x, A=A, B=B, C=C, D=D):
            return np.linalg.norm(C @ np.linalg.solve(1j * x * np.eye(len(A)) - A, B) + D, 2)

        best = at(2 * np.pi * f_hz)
        for p in poles[poles.imag > 0]:
            x, h = p.imag, abs(p.real)
            for _ in range(30):
                top, x = max((at(y), y) for y in np.linspace(x - 3 * h, x + 3 * h, 9))
                best, h = max(best, top), h / 2
        worst = max(worst, abs(norm / best - 1))
    print(f"lightly damped chains: norm off by {worst:.1e}")
    assert worst < 1e-6
