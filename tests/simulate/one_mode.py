"""A bench of one mode, newtons in, in front of which an actuator may stick and behind which a sensor may be off."""

import math

import numpy as np

from ultraquiet.bench import Wrapped
from ultraquiet.values import Channel, StateSpace

RATE_HZ = 500.0
RADIUS, ANGLE = 0.98, 0.4
POLE = complex(RADIUS * np.exp(1j * ANGLE))


def one_mode(sensor="gap", of="mm", *, offset=0.0, noise=1e-3, limit_n=10.0, dead_n=0.0, blocks_rest=False, unit=1.0):
    """`dead_n`: force below which it does not move; `unit`: of a reading; `blocks_rest`: its difference is read."""
    x, before, rng = [0j], [0.0], [np.random.default_rng(0)]

    def reset(run_index):
        x[0], before[0], rng[0] = 0j, 0.0, np.random.default_rng(run_index)

    def step(u, d):  # in numbers of Python: arrays of one take ten times as long
        now = x[0].imag
        y = unit * (now - before[0] * blocks_rest + offset + noise * rng[0].standard_normal())
        force = float(u[0] + d[0])
        before[0], x[0] = now, POLE * x[0] + 0.1 * math.copysign(max(abs(force) - dead_n, 0.0), force)
        return [y]

    wires = [Channel("coil", "N", -limit_n, limit_n)], [Channel(sensor, of, -100.0 * unit, 100.0 * unit)]
    return Wrapped(step, reset, RATE_HZ, *wires)


def difference(gain, unit=1.0):
    """A law of the difference of two readings: it damps where its gain is positive."""
    return StateSpace([[0.0]], [[1.0]], [[gain / unit]], [[-gain / unit]], RATE_HZ)
