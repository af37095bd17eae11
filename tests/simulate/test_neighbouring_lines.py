"""A line heard with its neighbours: less noise where a response is smooth, itself where it bends, an honest figure."""

import numpy as np
import pytest
from drawn_loops import RATE_HZ, LinearBench, gain_for, modal

import ultraquiet as uq
from ultraquiet.simulate.sensitivity.neighbours import with_neighbours

SHAPES = [(1, 1), (4, 3), (3, 5)]  # of matrices: sensors by directions
LINES, NOISE = 4000, 0.01


def noisy(S, rng, size=NOISE):
    """Return a response with noise whose columns each have the given size, and deviations that say so."""
    noise = rng.standard_normal((2, *S.shape)) * size / np.sqrt(2 * S.shape[0])
    return S + noise[0] + 1j * noise[1], np.stack([np.full(S.shape[2], 0.8 * size), np.full(S.shape[2], 0.6 * size)])


def largest(matrices):
    return np.linalg.norm(np.moveaxis(matrices, 2, 0), 2, axis=(1, 2))


def resonant(shape, f_hz, rng, damping):
    """Return 1 + a mode in each entry, `(*shape, lines)`: as narrow as its damping makes it."""
    w0 = rng.uniform(40.0, 200.0, shape)[..., None]
    return 1 + 0.5 * rng.standard_normal(shape)[..., None] * w0**2 * damping / (
        w0**2 - f_hz**2 + 2j * damping * w0 * f_hz
    )


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("stride", [1, 4])
def test_a_parabola_keeps_its_middle_and_its_noise_falls(shape, stride, rng):
    at = np.arange(LINES) / LINES
    a, b, c = rng.standard_normal((3, *shape, 1)) + 1j * rng.standard_normal((3, *shape, 1))
    S = a + b * at + c * at**2
    read, deviations = noisy(S, rng)
    places = np.arange(20 * stride, LINES - 20 * stride, 7)
    found, left = with_neighbours(read, deviations, places, stride)
    error, deviation = largest(found - S[:, :, places]), np.linalg.norm(left, axis=0)
    print(f"deviation {np.median(deviation) / NOISE:.3f} of a line's, error over it {np.median(error / deviation):.2f}")
    assert np.median(deviation) < 0.27 * NOISE  # 33 lines: sqrt(0.068)
    assert np.quantile(error / deviation, 0.99) < 3.0
    exact, none = with_neighbours(S, deviations, places, stride)
    np.testing.assert_allclose(exact, S[:, :, places], rtol=0, atol=1e-12)
    assert (np.linalg.norm(none, axis=0) <= deviation + 1e-15).all()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("damping", [0.2, 0.02, 0.002, 0.0002])
def test_the_deviation_holds_however_sharp_the_response_is(shape, damping, rng):
    """What bends by more than noise is kept, what is left of it beyond is told by the deviation."""
    f_hz = np.arange(16 * 20, 16 * 250) / 16
    S = resonant(shape, f_hz, rng, damping)
    read, deviations = noisy(S, rng)
    places = np.arange(f_hz.size)
    found, left = with_neighbours(read, deviations, places, 1)
    ratio = largest(found - S) / np.linalg.norm(left, axis=0)
    alone = largest(read - S) / NOISE
    print(
        f"error over deviation: {np.sqrt(np.mean(ratio**2)):.2f} RMS, of lines alone {np.sqrt(np.mean(alone**2)):.2f}"
    )
    assert np.sqrt(np.mean(ratio**2)) < 1.15 * np.sqrt(np.mean(alone**2))
    assert np.quantile(ratio, 0.999) < 4.0


def test_a_needle_of_one_line_stays_as_it_was_read(rng):
    S = np.ones((2, 2, LINES), dtype=complex)
    S[0, 0, LINES // 2] = 1.2
    read, deviations = noisy(S, rng)
    found, left = with_neighbours(read, deviations, np.array([LINES // 2, LINES // 2 + 1]), 1)
    assert np.array_equal(found[:, :, 0], read[:, :, LINES // 2])
    assert np.linalg.norm(left[:, 0]) == pytest.approx(NOISE)
    assert abs(found[0, 0, 1] - 1) < 4 * NOISE  # and pulls no neighbour


def test_lines_without_noise_and_at_the_ends_are_themselves(rng):
    S = rng.standard_normal((3, 3, 50)) + 1j * rng.standard_normal((3, 3, 50))
    found, left = with_neighbours(S, np.full((2, 50), 1e-12), np.arange(50), 4)
    np.testing.assert_array_equal(found, S)
    assert (left == 1e-12).all()
    none, _ = with_neighbours(S, np.full((2, 50), 1e-12), np.zeros(0, dtype=int), 4)
    assert none.shape == (3, 3, 0)


@pytest.mark.parametrize("unit", [1.0, 1e-6])
@pytest.mark.parametrize(("sensors", "actuators"), SHAPES)
def test_the_peak_of_a_loop_is_not_what_noise_makes_of_many_lines(sensors, actuators, unit, rng):
    """The largest of a thousand lines, each within half a decibel, reads half a decibel too much."""
    A, B, C = modal(rng, sensors, actuators)
    K = rng.standard_normal((actuators, sensors))
    K *= 0.5 * gain_for(A, B, C, K, 1.0)
    bench = LinearBench(A, B, unit * C, 0.002 * unit, rng, (25.0, 10.0 * unit))
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, sensors)), np.zeros((actuators, 0)), K / unit, RATE_HZ)
    read = uq.simulate.measure_sensitivity(bench, law)
    true = 20 * np.log10(true_size(A, B, C, K, read.f_hz))
    apart = read.worst_direction_db()[~read.hidden] + true[~read.hidden]
    print(
        f"{read.f_hz.size} lines, {read.hidden.sum()} hidden: peak {read.peak_amplification_db():.3f} dB, true "
        f"{true.max():.3f}; lines are apart from the truth by {np.sqrt(np.mean(apart**2)):.3f} dB RMS"
    )
    assert read.peak_amplification_db() == pytest.approx(true.max(), abs=0.25)


def true_size(A, B, C, K, f_hz):
    """Return the largest singular value of S in the directions that actuators reach, the command one sample late."""
    z = np.exp(2j * np.pi * f_hz / RATE_HZ)[:, None, None]
    G = C @ np.linalg.solve(z * np.eye(len(A)) - A, B.astype(complex)[None])
    reached = G @ np.linalg.pinv(G)
    return np.linalg.norm(np.linalg.solve(np.eye(len(C)) - G @ K / z, reached), 2, axis=(1, 2))
