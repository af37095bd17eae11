"""Plants such as a laboratory meets: structures with lightly damped modes, actuators and sensors of uneven gain."""

import numpy as np
from scipy.linalg import block_diag, expm

from ultraquiet.linalg import discretize
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import series

RATES_HZ = (2000.0, 2000.0, 500.0, 3500.0, 10000.0)  # 2 kHz twice as often as the others


def ordinary(rng, shape=None, modes=None):
    """Return a stable plant of 1 to 6 outputs and 1 to 8 inputs: 2 to 12 modes damped by 0.1 to 5 %.

    Displacement, velocity or acceleration is measured, with hold and up to two samples of delay; gains of channels
    differ by up to a hundred, units by up to a million.
    """
    ny, nu = shape or (int(rng.integers(1, 7)), int(rng.integers(1, 9)))
    rate_hz = float(rng.choice(RATES_HZ))
    modes = modes or int(rng.integers(2, 13))
    w = 2 * np.pi * rate_hz * 10 ** rng.uniform(-2.4, -0.5, modes)
    zeta = 10 ** rng.uniform(-3.0, -1.3, modes)
    A = block_diag(*([[0.0, wi], [-wi, -2 * zi * wi]] for wi, zi in zip(w, zeta, strict=True)))
    shapes_in, shapes_out = rng.standard_normal((modes, nu)), rng.standard_normal((ny, modes))
    B = np.zeros((2 * modes, nu))
    B[1::2] = shapes_in
    measured = rng.integers(3)
    C, D = np.zeros((ny, 2 * modes)), np.zeros((ny, nu))
    if measured == 0:
        C[:, ::2] = shapes_out * w
    else:
        C[:, 1::2] = shapes_out * w
    if measured == 2:  # the derivative of what measures velocity, over the mode's own frequency
        C, D = C / np.repeat(w, 2) @ A, shapes_out @ shapes_in
    gains_in, gains_out = (10 ** rng.uniform(-1, 1, n) * 10 ** rng.uniform(-3, 3) for n in (nu, ny))
    n = 2 * modes
    held = expm(np.block([[A, B], [np.zeros((nu, n + nu))]]) / rate_hz)
    G = StateSpace(
        held[:n, :n], held[:n, n:] * gains_in, C * gains_out[:, None], D * np.outer(gains_out, gains_in), rate_hz
    )
    delay = int(rng.integers(0, 3))
    return series(StateSpace(*discretize.delay(delay, nu), rate_hz=rate_hz), G) if delay else G


def with_units(plant, inputs=1.0, outputs=1.0, states=1.0):
    """Return the same plant in other units of its inputs, outputs and states; a number or one a channel."""
    inputs, outputs, states = (
        np.broadcast_to(np.asarray(v, float), (n,))
        for v, n in ((inputs, plant.D.shape[1]), (outputs, plant.D.shape[0]), (states, plant.states))
    )
    return StateSpace(
        plant.A * states[:, None] / states,
        plant.B * states[:, None] * inputs,
        plant.C / states * outputs[:, None],
        plant.D * outputs[:, None] * inputs,
        plant.rate_hz,
    )


def closed_loop_radius(plant, controller, side, factors):
    """Return the largest modulus of a pole of the loop with a complex factor on every channel of one end."""
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    F = np.diag(np.asarray(factors, complex))
    B, C, D = (B @ F, C, D @ F) if side == "input" else (B, F @ C, F @ D)
    a, b, c, d = controller.A, controller.B, controller.C, controller.D
    E = np.linalg.inv(np.eye(d.shape[0]) - d @ D)
    u = np.hstack([E @ d @ C, E @ c])  # u = d y + c x_K, y = C x + D u
    y = np.hstack([C, np.zeros((C.shape[0], c.shape[1]))]) + D @ u
    top = np.hstack([A, np.zeros((A.shape[0], a.shape[0]))]) + B @ u
    bottom = np.hstack([np.zeros((a.shape[0], A.shape[0])), a]) + b @ y
    return float(np.abs(np.linalg.eigvals(np.vstack([top, bottom]))).max())
