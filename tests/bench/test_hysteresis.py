"""The stacks' hysteresis: width, gain, and independence of rate."""

import numpy as np
import pytest

from ultraquiet import signals
from ultraquiet.bench import Hexapod
from ultraquiet.bench.hexapod.hysteresis import typical
from ultraquiet.bench.kernels import slip


def loop(amplitude_v, samples):
    """Two periods of a sine through the plays; returns voltage and answer of the second."""
    plays = typical()
    v = amplitude_v * np.sin(2 * np.pi * np.arange(2 * samples) / samples)
    anchors, w = np.zeros((1, plays.weights.size)), np.empty_like(v)
    for k in range(v.size):
        value = v[k : k + 1].copy()
        slip(plays.thresholds_v, plays.weights, anchors, value)
        w[k] = value[0]
    return v[samples:], w[samples:]


def width(v, w):
    """Largest opening of the loop over its height."""
    at = np.linspace(-0.95, 0.95, 101) * v.max()
    up = np.diff(v, prepend=v[-1]) > 0
    order = np.argsort(v)
    rising, falling = order[up[order]], order[~up[order]]
    gap = np.interp(at, v[falling], w[falling]) - np.interp(at, v[rising], w[rising])
    return gap.max() / np.ptp(w)


@pytest.mark.parametrize(("amplitude_v", "low", "high"), [(25.0, 0.05, 0.08), (82.5, 0.09, 0.12)])
def test_the_loop_is_as_wide_as_stated(amplitude_v, low, high):
    share = width(*loop(amplitude_v, 4000))
    print(f"loop at {amplitude_v:g} V: {100 * share:.1f} % wide")
    assert low <= share <= high


def test_the_gain_is_one_at_15_v_and_grows_with_amplitude():
    gain = {a: np.ptp(loop(a, 4000)[1]) / (2 * a) for a in (1.0, 15.0, 25.0, 75.0)}
    print({a: f"{g:.3f}" for a, g in gain.items()})
    assert gain[15.0] == pytest.approx(1.0, abs=1e-3)
    assert list(gain.values()) == sorted(gain.values())


def test_the_loop_does_not_depend_on_rate():
    slow, fast = loop(25.0, 8000)[1], loop(25.0, 800)[1]
    assert slow[::10] == pytest.approx(fast, abs=1e-9)


def test_a_hysteretic_bench_distorts_and_lags():
    """A pure tone comes back with its third harmonic, which the linear bench lacks."""
    u = signals.on_actuator(signals.Tone(50.0, 15.0).generate(samples=7000), 0)
    third = {}
    for hysteresis in (False, True):
        y = Hexapod(noise=False, quantise=False, hysteresis=hysteresis).run(u).outputs[0, 3500:]
        line = np.abs(np.fft.rfft(y))
        third[hysteresis] = line[150] / line[50]
    print({k: f"{v:.1e}" for k, v in third.items()})
    assert third[False] < 1e-6
    assert third[True] > 1e-3
