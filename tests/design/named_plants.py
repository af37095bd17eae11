"""Plants that several tests of designs share."""

import numpy as np

from ultraquiet.design import band_pass, four_block, high_pass, output_shaping
from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain, series


def bbmx():
    """Return the two-state problem of Benner, Byers, Mehrmann and Xu: its optimum is sqrt(0.65)."""
    return StateSpace(
        -np.eye(2),
        [[0, 0, 1], [0, 1, 1]],
        [[1, 0], [0, 1], [1, 1]],
        [[0.5, 0, 0], [0, 0.5, 1], [0, 1, 0]],
    )


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


def array_like(rng, modes, raw=False):
    """Return a 6 x 6 plant of `modes` modes between 5 and 1500 Hz seen by six 12 Hz geophones, `2 modes + 12` states.

    Sampled at 3.5 kHz. Modal coordinates, or with `raw` the same plant as [q; q'], inputs x 1e3, outputs x 1e-6.
    """
    w = 2 * np.pi * np.geomspace(5, 1500, modes) * np.exp(rng.uniform(-0.02, 0.02, modes))
    damping = 2 * rng.uniform(0.005, 0.03, modes) * w
    shapes = rng.standard_normal((modes, 6))
    seen = (shapes + 0.2 * rng.standard_normal((modes, 6))).T
    structure = _oscillators(w, damping, shapes, np.zeros_like(seen), seen, raw)
    corner, six = np.full(6, 2 * np.pi * 12.0), np.eye(6)
    # s^2 / (s^2 + 2 zeta w s + w^2) of each velocity
    geophones = _oscillators(corner, 1.12 * corner, six, -np.diag(corner**2), -np.diag(1.12 * corner), raw)
    inputs, outputs = (1e3, 1e-6) if raw else (1.0, 1.0)
    first = StateSpace(structure[0], inputs * structure[1], structure[2], np.zeros((6, 6)))
    both = series(first, StateSpace(geophones[0], geophones[1], outputs * geophones[2], outputs * six))
    return StateSpace(*discretize.zero_order_hold(both.A, both.B, both.C, both.D, 1 / 3500.0), rate_hz=3500.0)


def _oscillators(w, damping, drive, on_q, on_rate, raw):
    """Return A, B, C of q'' + damping q' + w^2 q = drive u, y = on_q q + on_rate q'.

    States [q; q'] when raw, else pairs of w q and q'.
    """
    n = w.size
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(w**2), -np.diag(damping)]])
    B, C = np.vstack([np.zeros_like(drive), drive]), np.hstack([on_q, on_rate])
    if raw:
        return A, B, C
    d, order = np.concatenate([w, np.ones(n)]), np.arange(2 * n).reshape(2, n).T.ravel()
    A, B, C = A * d[:, None] / d, B * d[:, None], C / d
    return A[np.ix_(order, order)], B[order], C[:, order]


def array_problem(form, plant, raw=False):
    """Return the S/KS or four-block problem of an `array_like` plant, 18 weight states, the same for both."""
    rate, six = plant.rate_hz, np.eye(6)
    u_unit, y_unit = (
        (1e3, 1e-6) if raw else (1.0, 1.0)
    )  # y = y_unit y', u' = u_unit u: from this plant to the modal one
    on_y = band_pass((9, 108), 10.0, 0.5, 2, rate, 6)
    on_u = high_pass(400.0, 1e-2, 1e-1, 1, rate, 6)
    if form == "S/KS":
        return output_shaping(plant, on_y, series(gain(u_unit * y_unit * six, rate), on_u))
    scaled = series(gain(six / y_unit, rate), on_y), series(gain(six * u_unit, rate), on_u)
    return four_block(plant, *scaled, six / u_unit, 0.1 * y_unit * six)


def closed_poles(P, K, ny, nu):
    """Return the poles of the loop of P and K, D22 = 0, written without the package's own loop."""
    B2, C2 = P.B[:, -nu:], P.C[-ny:]
    assert not np.any(P.D[-ny:, -nu:])
    return np.linalg.eigvals(np.block([[P.A + B2 @ K.D @ C2, B2 @ K.C], [K.B @ C2, K.A]]))
