"""Modes of a free response, each with its own growth, however loud another one is beside it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from ultraquiet.simulate.free_response import lasting_hz, ringing

RATE_HZ, SAMPLES = 1000.0, 16384


def ring(rng, modes, noise, rung=0.0):
    """Return a response of two channels, a sum of (Hz, growth, size), and as much noise alone as is in it.

    Noise rings the first mode too, `rung` times as loud as it is by itself.
    """
    pole = np.exp((modes[0][1] + 2j * np.pi * modes[0][0]) / RATE_HZ)

    def noisy():
        white = rng.standard_normal((2, SAMPLES))
        ringing_too = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], white)
        return noise * (rng.standard_normal((2, SAMPLES)) + rung * ringing_too / ringing_too.std())

    t = np.arange(SAMPLES) / RATE_HZ
    clean = sum(
        size * direction(rng) * np.exp(growth * t) * np.cos(2 * np.pi * f_hz * t + rng.uniform(0, 6))
        for f_hz, growth, size in modes
    )
    return clean + noisy(), noisy()


def direction(rng):
    """Return which way a mode of size one moves two channels; of a drawn size it may be too quiet for any method."""
    drawn = rng.standard_normal((2, 1))
    return drawn / np.linalg.norm(drawn)


@pytest.mark.parametrize("lines_apart", [0.65, 0.8, 1.0])
def test_a_quiet_mode_that_grows_is_heard_beside_a_loud_one_that_decays(rng, lines_apart):
    line_hz = RATE_HZ / (4 * (SAMPLES // 160))
    loud, quiet = 3.1 * line_hz, (3.1 + lines_apart) * line_hz
    heard = ringing(*ring(rng, [(loud, -0.05, 300.0), (quiet, 0.02, 1.0)], 0.1, 3.0), RATE_HZ)
    print([(round(mode.f_hz, 3), mode.growth_per_s, mode.growth_std) for mode in heard.modes])
    near = [mode for mode in heard.modes if abs(mode.f_hz - quiet) < 0.1 * line_hz]
    assert len(near) == 1
    assert not near[0].decays
    assert near[0].growth_per_s == pytest.approx(0.02, abs=4 * near[0].growth_std)


def test_one_mode_is_one_however_many_bands_hear_it(rng):
    for f_hz in rng.uniform(3.0, 400.0, 12):
        heard = ringing(*ring(rng, [(f_hz, -0.05, 300.0)], 0.3), RATE_HZ)
        assert len(heard.modes) == 1, heard.modes
        assert heard.modes[0].f_hz == pytest.approx(f_hz, abs=0.01)
        assert heard.modes[0].growth_per_s == pytest.approx(-0.05, abs=4 * heard.modes[0].growth_std)


def test_what_noise_keeps_going_lasts_unless_a_burst_is_heard_above_it(rng):
    """A mode of no growth that noise alone rings, against one that decays in a tenth of a second, and white noise."""
    f_hz, lasting = 40.0, []
    for _ in range(20):
        still, _ = ring(rng, [(f_hz, 0.0, 0.0)], 1.0, 10.0)
        _, noise = ring(rng, [(f_hz, 0.0, 0.0)], 1.0, 10.0)
        heard, dying = ring(rng, [(f_hz, -10.0, 0.0)], 1.0, 10.0)
        white, other = rng.standard_normal((2, 2, SAMPLES))
        burst = 1e3 * np.exp(-np.arange(SAMPLES) / RATE_HZ) * np.sin(2 * np.pi * f_hz * np.arange(SAMPLES) / RATE_HZ)
        pairs = [(still, noise), (heard, dying), (white, other), (still + burst, noise)]
        lasting.append([lasting_hz(*pair, (f_hz,), RATE_HZ) == (f_hz,) for pair in pairs])
    assert np.mean(lasting, axis=0).tolist() == [1.0, 0.0, 0.0, 0.0]
