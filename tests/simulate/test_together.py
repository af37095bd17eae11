"""Growth of one mode from many records, where noise drives it as much as it blurs it: as well known as is said."""

import numpy as np
import pytest
from scipy.signal import lfilter

from ultraquiet.simulate.frames import Frames
from ultraquiet.simulate.growth.together import growths

RATE_HZ, SAMPLES = 1000.0, 4096


def bands(rng, growth_per_s, f_hz, loud, records):
    """Bands of a mode that begins so many times as loud as what noise has heaped up at the end, on two channels."""
    frames = Frames(SAMPLES, RATE_HZ)
    line = round(f_hz / frames.line_hz(1))
    shape = rng.standard_normal(2) + 1j * rng.standard_normal(2)
    pole = np.exp((growth_per_s + 2j * np.pi * f_hz) / RATE_HZ)

    def one(loudness):
        drive = (rng.standard_normal((2, SAMPLES)).T @ [1, 1j]) / np.sqrt(2 * SAMPLES)
        drive[0] += loudness * np.exp(2j * np.pi * rng.random())
        mode = shape[:, None] * lfilter([1.0], [1.0, -pole], drive)
        return frames.band(2 * mode.real + 0.05 * rng.standard_normal((2, SAMPLES)), line)

    response, noise = (np.array([one(loudness) for _ in range(records)]) for loudness in (loud, 0.0))
    return frames, line, response, noise, [frames.count] * records


@pytest.mark.parametrize(("loud", "records"), [(1.0, 24), (3.0, 8)])
def test_growth_is_unbiased_and_its_deviation_true(rng, loud, records):
    """40 draws: the mean of 40 errors in deviations beyond 0.7, or their RMS beyond 1.5, is rarer than 1 in 10^5."""
    errors = []
    for _ in range(40):
        growth, f_hz = rng.uniform(-0.1, 0.1), rng.uniform(20.0, 200.0)
        (mode,) = growths(*bands(rng, growth, f_hz, loud, records))
        assert mode.f_hz == pytest.approx(f_hz, abs=0.05)
        errors.append((mode.growth_per_s - growth) / mode.growth_std)
    print(f"errors in deviations: mean {np.mean(errors):.2f}, RMS {np.sqrt(np.mean(np.square(errors))):.2f}")
    assert abs(np.mean(errors)) < 0.7
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


def test_noise_that_nothing_rings_holds_no_mode(rng):
    frames = Frames(SAMPLES, RATE_HZ)
    response, noise = (np.array([frames.band(rng.standard_normal((2, SAMPLES)), 30) for _ in range(8)]) for _ in "ab")
    assert growths(frames, 30, response, noise, [frames.count] * 8) == ()


def test_records_without_a_frame_that_counts_tell_nothing(rng):
    frames, line, response, noise, _ = bands(rng, 0.0, 50.0, 3.0, 2)
    assert growths(frames, line, response, noise, [0, 0]) is None
