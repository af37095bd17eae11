"""The stacks' hysteresis: width, gain, and independence of rate."""

import numpy as np
import pytest

from ultraquiet import signals
from ultraquiet.bench import Hexapod
from ultraquiet.bench.hexapod.physics.hysteresis import typical
from ultraquiet.bench.kernels import slip

RATE = 3500.0


def through(v):
    """Send voltages through the typical plays, from rest."""
    plays = typical()
    anchors, w = np.zeros((1, plays.weights.size)), np.array(v, dtype=float)
    for k in range(w.size):
        slip(plays.thresholds_v, plays.weights, anchors, w[k : k + 1])
    return w


def loop(amplitude_v, samples):
    """Two periods of a sine through the plays; returns voltage and answer of the second."""
    v = amplitude_v * np.sin(2 * np.pi * np.arange(2 * samples) / samples)
    return v[samples:], through(v)[samples:]


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


def periods(amplitude_v, f_hz, count, wave=np.sin):
    """Return `count` periods of a wave at the bench's rate, and their answers, one row a period."""
    samples = round(RATE / f_hz)
    v = amplitude_v * wave(2 * np.pi * np.arange(count * samples) / samples)
    return v.reshape(count, -1), through(v).reshape(count, -1)


@pytest.mark.parametrize("amplitude_v", [3.0, 25.0, 82.5])
@pytest.mark.parametrize("f_hz", [1.0, 50.0])
def test_the_loop_is_closed_after_its_first_rise(amplitude_v, f_hz):
    _, w = periods(amplitude_v, f_hz, 4)
    off = np.abs(w[2:] - w[1]).max()
    print(f"{amplitude_v:g} V at {f_hz:g} Hz: periods 2 to 4 differ by {off:.1e} V")
    assert off < 1e-12
    # The first starts from rest, on the virgin curve.
    assert np.abs(w[0] - w[1]).max() > 1e-3 * amplitude_v


def test_the_loop_at_1_hz_is_the_loop_at_50_hz():
    """The same voltages, passed fifty times as fast, give the same displacements.

    A cosine, so that both are sampled where they turn: of a 50 Hz sine, 70 samples a period miss 25 mV at its peaks.
    """
    slow, fast = periods(25.0, 1.0, 2, np.cos), periods(25.0, 50.0, 2, np.cos)
    assert slow[0][:, ::50] == pytest.approx(fast[0], abs=1e-12)
    off = np.abs(slow[1][:, ::50] - fast[1]).max()
    print(f"answers at 1 and 50 Hz differ by {off:.1e} V")
    assert off < 1e-9


def test_the_bench_itself_lags_alike_at_any_rate():
    """What the whole bench's stacks make of a slow sine, found by taking the linear chain off, is that of `slip`."""
    t = np.arange(7000) / RATE
    u = np.zeros((6, t.size))
    u[0] = 25.0 * np.sin(2 * np.pi * 5.0 * t)
    quiet = {"noise": False, "quantise": False, "saturate": False}
    bench = Hexapod(**quiet, hysteresis=True).run(u).outputs
    by_hand = np.zeros_like(u)
    by_hand[0] = through(np.r_[0.0, u[0, :-1]])  # held over from the sample before
    linear = Hexapod(**quiet).run(np.zeros_like(u), by_hand).outputs
    off = np.abs(bench - linear).max()
    print(f"hysteretic bench against plays before the linear bench: {off:.1e} V")
    assert off < 1e-9


@pytest.mark.parametrize(("low", "high"), [(-8.0, 8.0), (-3.0, 12.0), (-20.0, 30.0)])
def test_minor_loops_between_the_same_voltages_are_congruent(low, high, rng):
    """Whatever came before: loops between two voltages differ by a shift of the answer only."""
    swing = np.concatenate([np.linspace(low, high, 200), np.linspace(high, low, 200)])
    loops = []
    for start in (-80.0, -40.0, 0.0, 40.0, 80.0, *rng.uniform(-80.0, 80.0, 5)):
        history = np.concatenate([np.linspace(0.0, start, 300), np.linspace(start, low, 300)])
        # The second round: the first still follows the history, see the test of closed loops.
        w = through(np.concatenate([history, swing, swing]))[-swing.size :]
        loops.append(w - w[0])
    off = np.ptp(loops, axis=0).max()
    shift = np.ptp(np.abs(loops[0]))
    print(f"{low:g} to {high:g} V: loops from ten histories differ by {off:.1e} V of {shift:.1f} V")
    assert off < 1e-12
    # The loop has an inside, and biases do move it: otherwise congruence would say nothing.
    half = swing.size // 2
    assert np.abs(loops[0][:half] - loops[0][half:][::-1]).max() > 1e-2


def test_biases_shift_minor_loops():
    ends = [through(np.concatenate([np.linspace(0, b, 300), np.linspace(b, 0, 300)]))[-1] for b in (-80.0, 80.0)]
    print(f"at 0 V after -80 and 80 V: {ends[0]:.2f} and {ends[1]:.2f} V")
    assert ends[1] > 1.0 > -1.0 > ends[0]


def test_a_hysteretic_bench_distorts_and_lags():
    """A pure tone comes back with its third harmonic, which the linear bench lacks."""
    u = signals.on_actuator(signals.Tone(50.0, 15.0).generate(samples=7000, rate_hz=3500.0), 0, 6)
    third = {}
    for hysteresis in (False, True):
        y = Hexapod(noise=False, quantise=False, hysteresis=hysteresis).run(u).outputs[0, 3500:]
        line = np.abs(np.fft.rfft(y))
        third[hysteresis] = line[150] / line[50]
    print({k: f"{v:.1e}" for k, v in third.items()})
    assert third[False] < 1e-6
    assert third[True] > 1e-3
