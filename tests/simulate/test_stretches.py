"""Stretches of a record overlap: what a plant answers to one level fades into what it answers to another."""

import numpy as np
import pytest

from ultraquiet.simulate.commissioning.injection import MeasuredResponse
from ultraquiet.simulate.commissioning.stretches import OVERLAP, blended, stretches

EDGES_HZ, RATE_HZ = (1.0, 5.0, 20.0, 100.0, 1700.0), 3500.0
SECONDS, PER_OCTAVE = (8.0, 2.0, 2.0, 2.0), (40, 40, 60, 120)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_neighbours_share_their_lines_about_an_edge(scale):
    edges, rate, seconds = [scale * f for f in EDGES_HZ], scale * RATE_HZ, [s / scale for s in SECONDS]
    made = stretches(edges, seconds, PER_OCTAVE, rate)
    assert len(made) == 4
    for edge, below, above in zip(edges[1:-1], made, made[1:], strict=False):
        line = 0.5 / seconds[1]
        low, high = edge / OVERLAP + line, edge * OVERLAP - line
        about = [f[(f > low) & (f < high)] for f in (below.f_hz, above.f_hz)]
        assert about[0] == pytest.approx(about[1], rel=1e-12)
        assert about[0].size >= 3
        assert below.f_hz[-1] < 1.02 * edge * OVERLAP + 1 / seconds[1]
    for each in made:
        assert np.abs(each.period).max() == pytest.approx(1.0)
        assert np.all(np.diff(each.lines) > 0)


def test_a_response_that_hangs_on_its_level_is_blended_without_a_step():
    made = stretches(EDGES_HZ, SECONDS, PER_OCTAVE, RATE_HZ)
    gains = (1.0, 1.1, 0.9, 1.2)
    parts = [
        MeasuredResponse(m.f_hz, np.full((2, 3, m.f_hz.size), g, dtype=complex), np.full((2, 3, m.f_hz.size), 1e-4))
        for m, g in zip(made, gains, strict=True)
    ]
    f, G, variance = blended(parts, max(SECONDS))
    assert np.all(np.diff(f) > 0)
    assert G.shape == variance.shape == (2, 3, f.size)
    assert G[0, 0, [0, -1]] == pytest.approx([1.0, 1.2])
    step = np.abs(np.diff(G[1, 2])).max()
    print(f"{f.size} lines; the largest step is {step:.3f}, where levels differ by {0.3:.1f}")
    assert step < 0.11
    assert variance.max() == pytest.approx(1e-4)
    assert variance.min() > 0.49e-4


def test_one_stretch_and_stretches_closer_than_the_overlap():
    (alone,) = stretches((1.0, 400.0), (2.0,), (40,), 1000.0)
    assert alone.f_hz[[0, -1]] == pytest.approx([1.0, 400.0], rel=0.5)
    made = stretches((1.0, 20.0, 22.0, 400.0), (2.0, 2.0, 2.0), (40, 60, 120), 1000.0)
    parts = [MeasuredResponse(m.f_hz, np.ones((1, 1, m.f_hz.size)) + 0j, np.ones((1, 1, m.f_hz.size))) for m in made]
    f, G, _ = blended(parts, 2.0)
    assert np.all(np.diff(f) > 0)
    assert np.abs(G - 1.0).max() < 1e-12
