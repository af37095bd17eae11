"""Generalised plants: what is to be made small, put into one system with the plant and its weights."""

import numpy as np

from ultraquiet._base.constraints import FloatArray, real_array, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.values.interconnect import append, gain, series
from ultraquiet.values.state_space import StateSpace

WHO = "generalised plant"


def output_shaping(
    plant: StateSpace, on_s: StateSpace, on_ks: StateSpace | None = None, on_t: StateSpace | None = None
) -> StateSpace:
    """Return the system from (w, u) to (W1 S w, W2 K S w, W3 T w, y): a disturbance w at the plant's output.

    y = w + G u, S = (I - G K)^-1, T = G K S. A weight that is None leaves its block out.

    Args:
        plant: G.
        on_s: W1.
        on_ks: W2.
        on_t: W3.

    Raises:
        InputError: a weight that does not fit the plant, or is at another rate.
    """
    ny, nu = plant.D.shape
    _fits(plant, on_s, ny, "on_s")
    zero = np.zeros((ny, plant.states))
    C, D = [plant.C], [np.hstack([np.eye(ny), plant.D])]
    weights = [on_s]
    if on_ks is not None:
        _fits(plant, on_ks, nu, "on_ks")
        C.append(np.zeros((nu, plant.states)))
        D.append(np.hstack([np.zeros((nu, ny)), np.eye(nu)]))
        weights.append(on_ks)
    if on_t is not None:
        _fits(plant, on_t, ny, "on_t")
        C.append(plant.C)
        D.append(np.hstack([np.zeros((ny, ny)), plant.D]))
        weights.append(on_t)
    C.append(plant.C)
    D.append(D[0])
    B = np.hstack([zero.T, plant.B])
    inner = StateSpace(plant.A, B, np.vstack(C), np.vstack(D), plant.rate_hz)
    return series(inner, append(*weights, gain(np.eye(ny), plant.rate_hz)))


def four_block(
    plant: StateSpace, on_output: StateSpace, on_control: StateSpace, disturbance: FloatArray, noise: FloatArray
) -> StateSpace:
    """Return the system from (d, n, u) to (W1 y, W2 u, y), y = G (u + Vd d) + Vn n.

    The loop it makes is [W1; W2 K] (I - G K)^-1 [G Vd, Vn].

    Args:
        plant: G.
        on_output: W1.
        on_control: W2.
        disturbance: Vd `(nu, nu)`, disturbance at the plant's input, in the actuators' units.
        noise: Vn `(ny, ny)`, output units of disturbance and noise at the sensors.

    Raises:
        InputError: a weight or a matrix that does not fit the plant; a weight at another rate.
    """
    ny, nu = plant.D.shape
    _fits(plant, on_output, ny, "on_output")
    _fits(plant, on_control, nu, "on_control")
    Vd, Vn = real_array(WHO, "disturbance", disturbance, 2), real_array(WHO, "noise", noise, 2)
    for name, V, size in (("disturbance", Vd, nu), ("noise", Vn, ny)):
        if V.shape != (size, size):
            raise InputError(f"{WHO}: '{name}' must be ({size}, {size}), got {V.shape}.")
    n = plant.states
    B = np.hstack([plant.B @ Vd, np.zeros((n, ny)), plant.B])
    C = np.vstack([plant.C, np.zeros((nu, n)), plant.C])
    measured = np.hstack([plant.D @ Vd, Vn, plant.D])
    D = np.vstack([measured, np.hstack([np.zeros((nu, nu + ny)), np.eye(nu)]), measured])
    inner = StateSpace(plant.A, B, C, D, plant.rate_hz)
    return series(inner, append(on_output, on_control, gain(np.eye(ny), plant.rate_hz)))


def uncertain(
    plant: StateSpace,
    on_inputs: StateSpace,
    on_outputs: StateSpace | None,
    performance: StateSpace,
    control: StateSpace | None = None,
) -> StateSpace:
    """Return the system from (d1, d2, w, u) to (Wi u, Wo y0, Wp y, Wc u, y) round a plant off by unknown factors.

    y0 = G (u + d1), y = y0 + d2 + w. With d1 = Di Wi u and d2 = Do Wo y0 the plant is (I + Do Wo) G (I + Di Wi), and w
    is a disturbance at its output. A weight that is None leaves its signals out.

    Args:
        plant: G.
        on_inputs: Wi, relative error at the inputs.
        on_outputs: Wo, relative error at the outputs.
        performance: Wp, so that Wp S is to be small.
        control: Wc, so that Wc K S is.
    """
    ny, nu = plant.D.shape
    n, G, rate = plant.states, plant.D, plant.rate_hz
    one, still = np.eye(ny), np.zeros((ny, nu))
    # columns: x, d1, d2, w, u
    command = np.hstack([np.zeros((nu, n + nu + 2 * ny)), np.eye(nu)])
    output = np.hstack([plant.C, G, np.zeros((ny, 2 * ny)), G])
    measured = output + np.hstack([np.zeros((ny, n)), still, one, one, still])
    weighted: list[tuple[FloatArray, StateSpace | None, int, str]] = [
        (command, on_inputs, nu, "on_inputs"),
        (output, on_outputs, ny, "on_outputs"),
        (measured, performance, ny, "performance"),
        (command, control, nu, "control"),
    ]
    rows: list[FloatArray] = []
    weights: list[StateSpace] = []
    for row, weight, size, name in weighted:
        if weight is not None:
            _fits(plant, weight, size, name)
            rows.append(row)
            weights.append(weight)
    out = np.vstack([*rows, measured])
    keep = np.ones(out.shape[1], dtype=bool)
    if on_outputs is None:
        keep[n + nu : n + nu + ny] = False
    out = out[:, keep]
    drive = np.hstack([plant.B, np.zeros((n, 2 * ny)), plant.B])[:, keep[n:]]
    inner = StateSpace(plant.A, drive, out[:, :n], out[:, n:], rate)
    return series(inner, append(*weights, gain(one, rate)))


def _fits(plant: StateSpace, weight: StateSpace, size: int, name: str) -> None:
    same_rate(WHO, "the plant", plant.rate_hz, f"the weight '{name}'", weight.rate_hz)
    if weight.D.shape[1] != size:
        raise InputError(f"{WHO}: '{name}' takes {weight.D.shape[1]} signals where {size} are wanted.")


def full(weight: StateSpace, size: int, name: str) -> StateSpace:
    """Return a weight for all channels: as it is when it has them, else one copy for each."""
    if weight.D.shape[1] == size:
        return weight
    if weight.D.shape == (1, 1):
        return append(*[weight] * size)
    raise InputError(f"{WHO}: '{name}' is {weight.D.shape}, it must be (1, 1) or ({size}, {size}).")
