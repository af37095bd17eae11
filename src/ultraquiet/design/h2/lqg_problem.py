"""The generalised plant of an LQG problem: noise models before the plant, a filter behind it, weights on its cost."""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive, real_array
from ultraquiet._base.errors import InputError
from ultraquiet.linalg.realize import sections
from ultraquiet.values.interconnect import append, gain, series
from ultraquiet.values.state_space import StateSpace

SYMMETRY = 1e-9  # relative, of a covariance
SINGULAR = 1e-13  # smallest eigenvalue of a sensor noise's covariance, relative to the largest


class LqgParts(NamedTuple):
    """What stands around the plant, every part a system.

    `disturbance` drives the plant's inputs or adds to its outputs, `probe` is white noise at its inputs that only
    recovery asks for, `noise` adds to the measurement; `loop` filters the measurement and belongs to the controller
    (None when it has no such part); `output` and `control` are the weights of the cost.
    """

    disturbance: StateSpace
    at_input: bool
    probe: StateSpace
    noise: StateSpace
    loop: StateSpace | None
    output: StateSpace
    control: StateSpace


def generalised(plant: StateSpace, parts: LqgParts) -> StateSpace:
    """Return the system from (noises, u) to (weighted y, weighted u, measurement), all noises of unit variance.

    Without a filter in the loop the cost is on the plant's output as it is, with one on the filtered measurement: a
    controller knows the state of its own filter, so that one may even be an integrator.
    """
    ny, nu = plant.D.shape
    rate = plant.rate_hz
    sources = append(parts.disturbance, parts.probe, parts.noise, gain(np.eye(nu), rate))
    inner = series(sources, _wired(plant, parts.at_input))
    through = _repeat([0, 2, 1], (ny, ny, nu), rate)
    if parts.loop is not None:
        # the cost looks at the measurement, through the filter that it shares with the controller
        inner = series(inner, append(gain(np.zeros((0, ny)), rate), parts.loop, gain(np.eye(nu), rate)))
        through = _repeat([0, 1, 0], (ny, nu), rate)
    return series(series(inner, through), append(parts.output, parts.control, gain(np.eye(ny), rate)))


def shaped(who: str, name: str, model: FloatArray | StateSpace | float, size: int, rate_hz: float | None) -> StateSpace:
    """Return a noise model as a system driven by white noise of unit variance.

    Args:
        who: the method that asks.
        name: the setting.
        model: a shaping filter as it is, a covariance matrix `(size, size)`, or the variance of every channel.
        size: number of channels it feeds.
        rate_hz: of the plant.

    Raises:
        InputError: a filter of other size, a covariance that is not symmetric or not positive semidefinite.
    """
    if isinstance(model, StateSpace):
        if model.D.shape[0] != size:
            raise InputError(f"{who}: '{name}' has {model.D.shape[0]} outputs where {size} are wanted.")
        return model
    V = float(model) * np.eye(size) if np.ndim(model) == 0 else real_array(who, name, model, 2)
    if V.shape != (size, size):
        raise InputError(f"{who}: '{name}' must be ({size}, {size}), got {V.shape}.")
    values, vectors = np.linalg.eigh((V + V.T) / 2)
    largest = float(np.abs(values).max(initial=0.0))
    if np.abs(V - V.T).max(initial=0.0) > SYMMETRY * largest or values.min(initial=0.0) < -SYMMETRY * largest:
        raise InputError(f"{who}: '{name}' is no covariance, it must be symmetric and positive semidefinite.")
    return gain(vectors * np.sqrt(np.maximum(values, 0.0)), rate_hz)


def regular_noise(who: str, name: str, noise: StateSpace) -> StateSpace:
    """Return sensor noise that reaches every sensor by itself at once.

    Raises:
        InputError: its direct part is singular, so that some combination of the sensors would be free of noise.
    """
    V = noise.D @ noise.D.T
    scale = np.sqrt(np.maximum(np.diag(V), 1e-300))
    values = np.linalg.eigvalsh(V / np.outer(scale, scale))
    if not np.all(np.diag(V) > 0) or values[0] <= SINGULAR * values[-1]:
        raise InputError(
            f"{who}: '{name}' is singular, a combination of the sensors has no noise of its own (smallest eigenvalue "
            f"{values[0]:.1e} of the largest {values[-1]:.1e}); add a little white noise to every sensor."
        )
    return noise


def integrator(who: str, corner_hz: float, leak_hz: float, rate_hz: float) -> StateSpace:
    """Return (s + corner + leak) / (s + leak) at a rate: one above the corner, rising below it down to the leak.

    A leak of 0 Hz is a pure integrator, with its pole exactly at z = 1.
    """
    positive(who, "integral_hz", corner_hz, "Hz")
    between(who, "integral_leak_hz", leak_hz, 0.0, float(np.finfo(float).max), "Hz")
    if not 0 <= leak_hz < corner_hz or corner_hz >= rate_hz / 2:
        raise InputError(
            f"{who}: 'integral_hz' must lie above 'integral_leak_hz' and below Nyquist, {rate_hz / 2:g} Hz, got "
            f"{corner_hz:g} and {leak_hz:g} Hz."
        )
    pole = float(np.exp(-2 * np.pi * leak_hz / rate_hz))
    zero = float(np.exp(-2 * np.pi * (leak_hz + corner_hz) / rate_hz))
    return StateSpace(*sections(np.array([1.0, -zero]), np.array([1.0, -pole])), rate_hz=rate_hz)


def _wired(plant: StateSpace, at_input: bool) -> StateSpace:
    """Return the plant from (disturbance, probe, noise, u) to (y, measurement, u)."""
    ny, nu = plant.D.shape
    n = plant.states
    B, D = (plant.B, plant.D) if at_input else (np.zeros((n, ny)), np.eye(ny))
    silent = np.zeros((ny, ny))
    disturbed = np.hstack([D, plant.D, silent, plant.D])
    seen = np.hstack([D, plant.D, np.eye(ny), plant.D])
    acted = np.hstack([np.zeros((nu, D.shape[1] + nu + ny)), np.eye(nu)])
    return StateSpace(
        plant.A,
        np.hstack([B, plant.B, np.zeros((n, ny)), plant.B]),
        np.vstack([plant.C, plant.C, np.zeros((nu, n))]),
        np.vstack([disturbed, seen, acted]),
        plant.rate_hz,
    )


def _repeat(order: list[int], sizes: tuple[int, ...], rate_hz: float | None) -> StateSpace:
    """Return the static system that hands out groups of signals in an order, some of them twice."""
    starts = np.concatenate([[0], np.cumsum(sizes)])
    one = np.eye(int(starts[-1]))
    return gain(np.vstack([one[starts[k] : starts[k + 1]] for k in order]), rate_hz)
