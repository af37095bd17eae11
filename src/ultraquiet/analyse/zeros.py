"""Poles and zeros, in the words of vibration: frequency and damping."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.zeros import invariant_zeros
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class Roots:
    """Poles or zeros, by rising frequency, conjugates side by side.

    Attributes:
        values: `(n,)` in z, or in rad/s for continuous time.
        frequency_hz: `(n,)` |s| / 2 pi with s = rate ln z; infinite for z = 0.
        zeta: `(n,)` damping, -Re s / |s|; negative beyond the stability boundary, one for z = 0.
        outside: `(n,)` True where the root is not strictly inside the stability region: an unstable pole, or a zero
            that limits what feedback can do (non-minimum phase).
    """

    values: ComplexArray
    frequency_hz: FloatArray
    zeta: FloatArray
    outside: np.ndarray

    def __len__(self) -> int:
        return self.values.size


@takes_systems
def poles(G: StateSpace) -> Roots:
    """Return the poles of a system.

    det(z I - A) = 0.

    Args:
        G: system.

    >>> G = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> round(float(poles(G).frequency_hz[0]), 3)
    1.677
    """
    return roots(G.poles(), G.rate_hz)


@takes_systems
def zeros(G: StateSpace) -> Roots:
    """Return the invariant zeros of a system; its transmission zeros when the realisation is minimal.

    rank [A - z I, B; C, D] falls below its usual value.

    Args:
        G: system, square or not.

    A zero blocks one direction of input at its frequency. One outside the stability region bounds the attenuation that
    any controller can reach near it; those of the paper's plant near 1 and 3 Hz are such.

    >>> G = StateSpace([[0.5, 0.0], [0.0, 0.2]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]], rate_hz=1.0)
    >>> round(float(zeros(G).values.real[0]), 6)
    0.35

    Emami-Naeini and Van Dooren 1982, doi:10.1016/0005-1098(82)90070-X.
    """
    return roots(invariant_zeros(G.A, G.B, G.C, G.D), G.rate_hz)


def roots(values: ComplexArray, rate_hz: float | None) -> Roots:
    """Return roots in z (or rad/s) with frequency and damping."""
    z = np.asarray(values, dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = z if rate_hz is None else rate_hz * np.log(z)
        size = np.abs(s)
        zeta = np.where(np.isinf(size), 1.0, np.where(size > 0, -s.real / np.where(size > 0, size, 1.0), 0.0))
    order = np.lexsort((z.imag, size))
    outside = (z.real >= 0) if rate_hz is None else (np.abs(z) >= 1)
    return Roots(z[order], (size / (2 * np.pi))[order], zeta[order], outside[order])
