"""Plants that several tests of designs share."""

import numpy as np

from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import series


def bench_like(rng, modes, rate_hz=3500.0, raw=False):
    """Return a 6 x 6 plant of lightly damped modes with two samples of delay, `2 modes + 12` states.

    `raw` gives the same plant in displacement and velocity coordinates, inputs in millivolts, outputs in megavolts.
    """
    w = 2 * np.pi * np.geomspace(8, 350, modes) * np.exp(rng.uniform(-0.05, 0.05, modes))
    zeta = rng.uniform(0.005, 0.03, modes)
    shapes = rng.standard_normal((modes, 6))
    n = 2 * modes
    A, B, C = np.zeros((n, n)), np.zeros((n, 6)), np.zeros((6, n))
    for k in range(modes):
        pair = slice(2 * k, 2 * k + 2)
        A[pair, pair] = [[0, 1], [-(w[k] ** 2), -2 * zeta[k] * w[k]]]
        B[2 * k + 1] = shapes[k]
        C[:, 2 * k + 1] = shapes[k] + 0.2 * rng.standard_normal(6)
    if raw:
        order = np.concatenate([np.arange(0, n, 2), np.arange(1, n, 2)])
        A, B, C = A[np.ix_(order, order)], B[order] * 1e3, C[:, order] * 1e-6
    G = StateSpace(*discretize.zero_order_hold(A, B, C, np.zeros((6, 6)), 1 / rate_hz), rate_hz=rate_hz)
    return series(StateSpace(*discretize.delay(2, 6), rate_hz=rate_hz), G)


def sensitivity_db(plant, controller, f_hz):
    """Return the largest singular value of (I - G K)^-1 in dB, written without the package's own loop."""
    G, K = (np.moveaxis(s.frequency_response(f_hz), 2, 0) for s in (plant, controller))
    S = np.linalg.inv(np.eye(plant.D.shape[0]) - G @ K)
    return 20 * np.log10(np.linalg.norm(S, 2, axis=(1, 2)))
