"""Zeros and poles that bind, in the half-plane: discrete time is taken there by s = 2 rate (z - 1) / (z + 1).

The map keeps harmonic measure, so that one formula serves both times; a sample of delay becomes a zero at s = 2 rate.
"""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.response import frequency_response
from ultraquiet.linalg.zeros import invariant_zeros
from ultraquiet.values.state_space import StateSpace

BOUNDARY = 1e-9  # a root so near the stability boundary, relative to its size, binds no more than its neighbours


def half_plane(roots: ComplexArray, rate_hz: float | None) -> ComplexArray:
    """Return where poles or zeros in z or rad/s lie in the half-plane, rad/s; z = -1 lies at infinity."""
    if rate_hz is None:
        return roots
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(roots == -1, np.inf, 2 * rate_hz * (roots - 1) / (roots + 1))


def speeds(f_hz: FloatArray, rate_hz: float | None) -> FloatArray:
    """Return the frequencies of the half-plane, rad/s, of frequencies in Hz; the Nyquist frequency lies at infinity."""
    f = np.asarray(f_hz, dtype=np.float64)
    if rate_hz is None:
        return 2 * np.pi * f
    return np.where(f >= rate_hz / 2, np.inf, 2 * rate_hz * np.tan(np.pi * np.minimum(f / rate_hz, 0.5 - 1e-16)))


def unstable(roots: ComplexArray, rate_hz: float | None) -> ComplexArray:
    """Return those roots that lie outside the stability region, in the half-plane."""
    s = half_plane(roots, rate_hz)
    s = s[np.isfinite(s)]
    return s[s.real > BOUNDARY * np.abs(s)]


@dataclass(frozen=True, eq=False)
class BindingZero:
    """A zero outside the stability region: `s` in the half-plane, the output direction that it blocks, its name.

    The direction is None for a delay, which blocks every one.
    """

    s: complex
    direction: ComplexArray | None
    name: str


def binding_zeros(plant: StateSpace) -> list[BindingZero]:
    """Return the zeros outside the stability region, one of each conjugate pair; a plant's delay counts as one."""
    values = invariant_zeros(plant.A, plant.B, plant.C, plant.D)
    zeros = []
    if plant.rate_hz is not None and not np.any(plant.D):
        zeros.append(BindingZero(complex(2 * plant.rate_hz), None, "the delay"))
    for z in values[values.imag >= 0]:
        s = unstable(np.array([z]), plant.rate_hz)
        if s.size:
            at = abs(z if plant.rate_hz is None else plant.rate_hz * np.log(z)) / (2 * np.pi)
            zeros.append(BindingZero(complex(s[0]), _blocked(plant, complex(z)), f"a zero at {at:.3g} Hz"))
    return zeros


def _blocked(plant: StateSpace, z: complex) -> ComplexArray:
    """Return the unit vector y with y* G(z) = 0."""
    G = frequency_response(plant.A, plant.B, plant.C, plant.D, np.array([z]))[:, :, 0]
    return np.linalg.svd(G)[0][:, -1].astype(np.complex128)


def owed(s: complex, poles: ComplexArray) -> float:
    """Return ln of the product of |s + conj(p)| / |s - p| over unstable poles: what stabilising them costs at s."""
    return float(np.sum(np.log(np.abs(s + poles.conj()) / np.maximum(np.abs(s - poles), np.finfo(float).tiny))))


def harmonic(s: complex, w: FloatArray) -> FloatArray:
    """Return the harmonic measure, seen from s, of the frequencies -w..w of the half-plane; one at infinity."""
    x, y = s.real, s.imag
    return (np.arctan((w - y) / x) + np.arctan((w + y) / x)) / np.pi
