"""A bench whose interlocks end a run where another cuts off: a law is measured on it by weaker sweeps."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InterlockError
from ultraquiet.simulate.open_loop import OpenLoop

RATE_HZ, MODULUS, F_HZ, DEVIATIONS = 200.0, 0.98, 12.0, 5.0
FORCE, SPEED = uq.Channel("force", "N", -3.0, 3.0), uq.Channel("speed", "m/s")
LOOSE = uq.bench.Interlocks(frame_s=600.0)  # a card without a clock: a busy machine trips nothing


class Card:
    """A mode behind converters: what was put out last acts until the next frame."""

    def __init__(self):
        w = 2 * np.pi * F_HZ / RATE_HZ
        self.A = MODULUS * np.array([[np.cos(w), -np.sin(w)], [np.sin(w), np.cos(w)]])
        self.x, self.noise = np.zeros(2), np.random.default_rng(3)

    def put(self, newtons):
        self.x = self.A @ self.x + np.array([0.02 * newtons[0], 0.0])

    def get(self):
        return self.x[:1] + 2e-4 * self.noise.standard_normal(1)


class Counted:
    """A guarded bench that counts the runs which its interlocks ended."""

    def __init__(self):
        card = Card()
        self.bench = uq.bench.Hardware(card.put, card.get, RATE_HZ, [FORCE], [SPEED], LOOSE, wait=lambda: 0)
        self.tripped = 0

    def __getattr__(self, name):
        return getattr(self.bench, name)

    def run(self, *given, **more):
        try:
            return self.bench.run(*given, **more)
        except InterlockError as error:
            self.tripped += error.of_level
            raise


def law(gain):
    return uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[gain]], RATE_HZ)


def sizes(gain, f_hz):
    """|S|, the command acting at once on what is read in its frame, one sample after it was made of a reading."""
    z = np.exp(2j * np.pi * f_hz / RATE_HZ)
    A = Card().A
    G = np.array([0.02 * np.linalg.solve(np.eye(2) - A / each, [1.0, 0.0])[0] for each in z])
    return 1 / np.abs(1 - gain * G / z)


def test_a_law_that_amplifies_is_measured_by_sweeps_that_trip_nothing():
    bench, gain = Counted(), -60.0
    found = uq.simulate.measure_sensitivity(bench, law(gain), opened=OpenLoop(bench, 8.0))
    truth = sizes(gain, found.f_hz)
    inside = found.f_hz < 0.3 * RATE_HZ  # beyond it the mode is heard little above the noise
    off = np.abs(np.abs(found.S.values[0, 0]) - truth)[inside] / (found.deviation + 0.005 * truth)[inside]
    print(f"{bench.tripped} runs were ended, S up to {truth.max():.1f}, off by {off.max():.1f} deviations at most")
    assert bench.tripped > 0
    assert off.max() < DEVIATIONS
    assert np.count_nonzero(found.hidden) < 0.1 * truth.size


def test_a_loop_that_runs_away_trips_them_however_weak_the_sweep():
    bench = Counted()
    with pytest.raises(InterlockError, match="amplitude"):
        uq.simulate.measure_sensitivity(bench, law(20.0), opened=OpenLoop(bench, 8.0))
    assert bench.tripped > 1
