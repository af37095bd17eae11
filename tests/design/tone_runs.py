"""Runs of a bench under tones that move, and what is left of them."""

import numpy as np

from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append

VOLTS = 1.0


def tone(rng, f_hz, volts=VOLTS, rate_hz=3500.0):
    """Return one tone of instantaneous frequency `f_hz` `(n,)` on six actuators, amplitudes and phases drawn."""
    angle = 2 * np.pi * np.cumsum(f_hz) / rate_hz
    size = rng.uniform(0.5, 1.0, 6) * rng.choice([-1.0, 1.0], 6) * volts
    return size[:, None] * np.sin(angle + rng.uniform(0, 2 * np.pi, 6)[:, None])


def seconds(duration_s, rate_hz=3500.0):
    """Return the times of a run."""
    return np.arange(round(duration_s * rate_hz)) / rate_hz


def run(bench, disturbance, law=None):
    """Return the record of a disturbed run."""
    return bench.run(np.zeros_like(disturbance), disturbance=disturbance, controller=law, run_index=0)


def band_rms(record, part_s, band_hz):
    """Return the RMS of all readings over a part of the run and a band, volts."""
    first, last = (round(t * record.rate_hz) for t in part_s)
    y = record.outputs[:6, first:last] * np.hanning(last - first)
    f = np.fft.rfftfreq(y.shape[1], 1 / record.rate_hz)
    inside = (f >= band_hz[0]) & (f <= band_hz[1])
    return np.sqrt(np.sum(np.abs(np.fft.rfft(y)[:, inside]) ** 2))


def reduction_db(opened, closed, part_s, band_hz):
    """Return by how much the band became quieter over a part of the run, dB."""
    return 20 * np.log10(band_rms(opened, part_s, band_hz) / band_rms(closed, part_s, band_hz))


def mild_damping(channels, gain=0.5, corner_hz=100.0, rate_hz=3500.0):
    """Return velocity feedback of each channel on itself, rolled off."""
    pole = np.exp(-2 * np.pi * corner_hz / rate_hz)
    return append(*[StateSpace([[pole]], [[1 - pole]], [[-gain]], [[0.0]], rate_hz)] * channels)
